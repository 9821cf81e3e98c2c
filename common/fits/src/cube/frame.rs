//! A frame's file: its header, and where its pixels begin.

use std::fmt;
use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use super::CubeError;
use crate::card;
use crate::hdu::BLOCK;
use crate::header::Header;
use crate::restore::{self, FirstHeaders};

/// What a FITS file begins with.
const BEGIN: &[u8; 9] = b"SIMPLE  =";

/// Type and size of a frame's pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// Bits of a pixel; negative for floats.
    pub bitpix: i64,
    /// Columns and rows.
    pub size_px: [i64; 2],
    /// BSCALE and BZERO.
    scaling: [f64; 2],
    /// The number that stands for no value.
    blank: Option<i64>,
}

impl Layout {
    /// Bytes of the pixels, without what fills the last block.
    pub fn bytes(&self) -> u64 {
        let [width, height] = self.size_px.map(i64::unsigned_abs);
        width * height * self.bitpix.unsigned_abs() / 8
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([width, height], [scale, zero]) = (self.size_px, self.scaling);
        write!(f, "an image of {width} x {height} px with BITPIX {}, BSCALE {scale}, BZERO {zero}", self.bitpix)?;
        self.blank.map_or(Ok(()), |blank| write!(f, ", BLANK {blank}"))
    }
}

/// An open frame, read up to its first pixel.
pub(super) struct FrameFile {
    /// Which file.
    pub file: PathBuf,
    /// Its cards as they are written.
    pub cards: Vec<[u8; card::LENGTH]>,
    /// The same as typed values.
    pub header: Header,
    /// Type and size of its pixels.
    pub layout: Layout,
    /// The rest of its file; none of one with tiles, which are decompressed when they are asked for.
    rest: Option<BufReader<File>>,
    header_bytes: usize,
}

impl FrameFile {
    pub fn open(file: &Path) -> Result<Self, CubeError> {
        let failed = |why: String| CubeError::Frame { file: file.to_owned(), why };
        let mut reader =
            BufReader::with_capacity(16 * BLOCK, File::open(file).map_err(|error| failed(error.to_string()))?);
        let found =
            FirstHeaders::read(&mut reader).map_err(|error| failed(format!("its header ends early: {error}")))?;
        let no_fits = || failed("it is no plain FITS file".to_owned());
        let headers = match found {
            Some(headers) => headers,
            None if starts_as_fits(file) => return Err(failed("its header ends early, without END".to_owned())),
            None => return Err(no_fits()),
        };
        let mut bytes = headers.plain();
        if !bytes.starts_with(BEGIN) {
            return Err(no_fits());
        }
        let (rest, header_bytes) = (headers.table.is_none().then_some(reader), bytes.len());
        let read = Header::read(file, &bytes);
        let (header, length) = read.ok_or_else(|| failed("its header has no end".to_owned()))?;
        bytes.truncate(length - card::LENGTH);
        let layout = layout(&header).map_err(failed)?;
        let cards = bytes.as_chunks().0.to_vec();
        Ok(Self { file: file.to_owned(), cards, header, layout, rest, header_bytes })
    }

    /// Takes the pixels, and all that follows them.
    pub fn take_pixels(&mut self) -> Result<Box<dyn Read>, CubeError> {
        if let Some(rest) = self.rest.take() {
            return Ok(Box::new(rest));
        }
        let restored = restore::plain_file(&self.file).map_err(|error| self.failed(error.fault.to_string()))?;
        let mut plain = Cursor::new(restored.unwrap_or_default());
        plain.set_position(self.header_bytes as u64);
        Ok(Box::new(plain))
    }

    /// The cube's error about this frame.
    pub fn failed(&self, why: String) -> CubeError {
        CubeError::Frame { file: self.file.clone(), why }
    }
}

fn starts_as_fits(file: &Path) -> bool {
    let mut begin = [0; BEGIN.len()];
    File::open(file).and_then(|mut file| file.read_exact(&mut begin)).is_ok() && begin == *BEGIN
}

fn layout(header: &Header) -> Result<Layout, String> {
    let whole = |keyword| header.whole(keyword).map_err(|error| error.to_string());
    let axes = whole("NAXIS")?;
    if axes != 2 {
        return Err(format!("it has {axes} axes; a cube is made of plain images with two"));
    }
    let (bitpix, size_px) = (whole("BITPIX")?, [whole("NAXIS1")?, whole("NAXIS2")?]);
    if ![8, 16, 32, 64, -32, -64].contains(&bitpix) || size_px.iter().any(|length| !(1..=1_000_000).contains(length)) {
        return Err(format!("BITPIX {bitpix} with {} x {} px is no image", size_px[0], size_px[1]));
    }
    let scaling = [header.number("BSCALE").unwrap_or(1.0), header.number("BZERO").unwrap_or(0.0)];
    Ok(Layout { bitpix, size_px, scaling, blank: header.whole("BLANK").ok() })
}
