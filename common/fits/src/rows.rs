//! The rows of a plain image of 16-bit counts, some at a time: a picture of a frame of any size needs the memory of a few rows.
//! Frames of cameras are such images; all others are read whole ([`crate::read`]).

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::decode::Scaling;
use crate::error::{Fault, FitsError};
use crate::hdu::shape;
use crate::header::Header;
use crate::restore::next_header;

/// A file whose rows are read one after another.
#[derive(Debug)]
pub struct Rows {
    path: PathBuf,
    file: File,
    bytes: Vec<u8>,
    next: usize,
    /// Columns, px.
    pub width_px: usize,
    /// Rows, px.
    pub height_px: usize,
}

impl Rows {
    /// Opens a file; `None` where its first part is no flat image of counts of 0 to 65535 in 16 bits.
    ///
    /// # Errors
    /// The error of the system, or [`Fault::CutShort`].
    pub fn open(path: &Path) -> Result<Option<Self>, FitsError> {
        Self::of(path).map_err(|fault| FitsError { file: path.to_owned(), fault })
    }

    fn of(path: &Path) -> Result<Option<Self>, Fault> {
        let mut file = File::open(path)?;
        let mut head = [0; 9];
        if file.read_exact(&mut head).is_err() || head != *b"SIMPLE  =" {
            return Ok(None);
        }
        let Some(bytes) = next_header(&mut head.as_slice().chain(&mut file))? else { return Ok(None) };
        let Some((header, _)) = Header::read(path, &bytes) else { return Ok(None) };
        let Ok(shape) = shape(&header, "") else { return Ok(None) };
        let counts = Scaling::of(&header).is_ok_and(|scaling| scaling.are_counts(shape.bitpix));
        match shape.axes.as_slice() {
            [width, height] if shape.bitpix == 16 && counts && *width > 0 && *height > 0 => {
                // Before any room is made: a header may announce more than there is.
                let pixels = width.saturating_mul(*height);
                let (expected, found) =
                    ((bytes.len() as u64).saturating_add(pixels.saturating_mul(2)), file.metadata()?.len());
                if expected > found {
                    return Err(Fault::CutShort { hdu: 1, expected, found });
                }
                let (width_px, height_px) = (*width as usize, *height as usize);
                Ok(Some(Self { path: path.to_owned(), file, bytes: Vec::new(), next: 0, width_px, height_px }))
            }
            _ => Ok(None),
        }
    }

    /// Reads the next rows into `counts`, which has nothing else afterwards; fewer at the end.
    ///
    /// # Errors
    /// The error of the system.
    pub fn read(&mut self, most: usize, counts: &mut Vec<u16>) -> Result<(), FitsError> {
        counts.clear();
        let rows = most.min(self.height_px - self.next);
        self.bytes.resize(rows * self.width_px * 2, 0);
        let read = self.file.read_exact(&mut self.bytes);
        read.map_err(|error| FitsError { file: self.path.clone(), fault: error.into() })?;
        self.next += rows;
        // 32768 more than the signed number: its highest bit turned round.
        counts.extend(self.bytes.as_chunks().0.iter().map(|bytes| u16::from_be_bytes(*bytes) ^ 0x8000));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pixels;
    use crate::hdu::BLOCK;

    fn file(cards: &[&str], data: usize) -> tempfile::NamedTempFile {
        let mut bytes: Vec<u8> =
            cards.iter().chain([&"END"]).map(|card| format!("{card:<80}")).collect::<String>().into_bytes();
        bytes.resize(BLOCK, b' ');
        bytes.extend((0..data).map(|i| (i * 7 % 256) as u8));
        bytes.resize(bytes.len().div_ceil(BLOCK) * BLOCK, 0);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    const COUNTS: [&str; 6] =
        ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS1  = 5", "NAXIS2  = 7", "BZERO   = 32768"];

    #[test]
    fn the_rows_are_those_of_the_whole_image() {
        let file = file(&COUNTS, 70);
        let mut rows = Rows::open(file.path()).unwrap().unwrap();
        let (mut all, mut some) = (Vec::new(), Vec::new());
        for expected in [3, 3, 1, 0] {
            rows.read(3, &mut some).unwrap();
            assert_eq!(some.len(), expected * 5);
            all.extend_from_slice(&some);
        }
        assert_eq!(crate::read(file.path()).unwrap().pixels, Pixels::U16(all));
    }

    #[test]
    fn other_images_are_left_to_the_whole_reader_and_a_cut_one_is_an_error() {
        for (at, card) in [
            (1, "BITPIX  = -32"),
            (2, "NAXIS   = 1"),
            (3, "NAXIS1  = 0"),
            (5, "BZERO   = 0"),
            (5, "BSCALE  = 2"),
            (0, "SIMPLE = T"),
        ] {
            let mut cards = COUNTS;
            cards[at] = card;
            assert!(Rows::open(file(&cards, 70).path()).unwrap().is_none(), "{card}");
        }
        assert!(Rows::open("/no/such/file".as_ref()).is_err());
        let mut cards = COUNTS;
        cards[4] = "NAXIS2  = 70000";
        let fault = Rows::open(file(&cards, 70).path()).unwrap_err().to_string();
        assert!(fault.contains("cut short"), "{fault}");
    }
}
