//! The cube's file while it is written: under a temporary name, with sums that grow with it.

use std::collections::HashSet;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::CubeError;
use super::columns::MetadataTable;
use super::frame::FrameFile;
use crate::card::{self, Card, Value};
use crate::checksum::{add, encode, sum};
use crate::hdu::BLOCK;
use crate::part::{new_part, sync_folder};

/// Bytes that are copied at a time; whole words.
const PORTION: usize = 256 * 1024;

/// A header whose sums are not known yet.
struct Unfinished {
    cards: Vec<[u8; card::LENGTH]>,
    begins: u64,
    /// The sum of the data written so far, and how many bytes they are.
    data_sum: u32,
    data_bytes: u64,
}

/// A file that is removed unless it is put in place.
pub(super) struct CubeFile {
    target: PathBuf,
    part: PathBuf,
    file: BufWriter<File>,
    hdu: Unfinished,
    /// Bytes of the file so far.
    length: u64,
    /// Data that make no whole word yet.
    rest: Vec<u8>,
    is_in_place: bool,
}

impl CubeFile {
    pub fn create(target: &Path) -> Result<Self, CubeError> {
        let name = target.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let part = new_part(folder, &name);
        let file = OpenOptions::new().write(true).create_new(true).open(&part);
        let file = file.map_err(|source| CubeError::Write { file: part.clone(), source })?;
        let hdu = Unfinished { cards: Vec::new(), begins: 0, data_sum: 0, data_bytes: 0 };
        let file = BufWriter::with_capacity(PORTION, file);
        Ok(Self { target: target.to_owned(), part, file, hdu, length: 0, rest: Vec::new(), is_in_place: false })
    }

    /// Writes the header of the cube: its own structure, then what all frames have in common.
    pub fn begin_pixels(&mut self, first: &FrameFile, table: &MetadataTable, frames: usize) -> Result<(), CubeError> {
        let [width, height] = first.layout.size_px;
        let mut cards = vec![
            logical("SIMPLE", true, "FITS"),
            whole("BITPIX", first.layout.bitpix, "bits of a pixel"),
            whole("NAXIS", 3, "x, y, frame"),
            whole("NAXIS1", width, "[px] columns"),
            whole("NAXIS2", height, "[px] rows"),
            whole("NAXIS3", frames as i64, "frames"),
            logical("EXTEND", true, "the table METADATA follows"),
        ];
        let (mut copied, mut is_copied) = (HashSet::new(), false);
        for card in &first.cards {
            is_copied = match card::read(card) {
                Card::Value(keyword, _) => {
                    let is_of_pixels = matches!(keyword.as_str(), "BSCALE" | "BZERO" | "BLANK");
                    // Of a keyword that stands twice the first one counts.
                    (is_of_pixels || table.is_constant(&keyword)) && copied.insert(keyword)
                }
                // The rest of a long text.
                Card::Continue(_) => is_copied,
                Card::Comment | Card::End => false,
            };
            if is_copied {
                cards.push(*card);
            }
        }
        self.begin(cards).map_err(|source| self.failed(source))
    }

    /// Copies the pixels of a frame.
    pub fn add_pixels(&mut self, mut frame: FrameFile) -> Result<(), CubeError> {
        let (mut left, mut own_sum) = (frame.layout.bytes(), 0);
        let mut buffer = vec![0; PORTION];
        let mut pixels = frame.take_pixels()?;
        while left > 0 {
            let length = left.min(PORTION as u64) as usize;
            let portion = &mut buffer[..length];
            pixels.read_exact(portion).map_err(|error| frame.failed(format!("its pixels end early: {error}")))?;
            self.put(portion).map_err(|source| self.failed(source))?;
            // Zeros fill the last four bytes of a frame's data.
            let filled = length.next_multiple_of(4);
            buffer[length..filled].fill(0);
            own_sum = add(own_sum, sum(&buffer[..filled]));
            left -= length as u64;
        }
        let expected = frame.header.value("DATASUM").and_then(|value| match value {
            Value::Text(text) => text.trim().parse::<u32>().ok(),
            Value::Whole(number) => u32::try_from(*number).ok(),
            _ => None,
        });
        match expected.filter(|expected| !is_same_sum(*expected, own_sum)) {
            None => Ok(()),
            Some(expected) => Err(frame.failed(format!(
                "its pixels add up to {own_sum}, and its DATASUM is {expected}: the file is damaged; leave it out, or restore it"
            ))),
        }
    }

    /// Ends the pixels and writes the header of the table.
    pub fn begin_rows(&mut self, table: &MetadataTable, frames: usize) -> Result<(), CubeError> {
        let mut cards = vec![
            text("XTENSION", "BINTABLE", "a table"),
            whole("BITPIX", 8, "bytes"),
            whole("NAXIS", 2, ""),
            whole("NAXIS1", table.row_bytes() as i64, "bytes of a row"),
            whole("NAXIS2", frames as i64, "rows: one per frame, in the order of the cube"),
            whole("PCOUNT", 0, ""),
            whole("GCOUNT", 1, ""),
            whole("TFIELDS", table.count() as i64, "columns: keywords that are not the same in all frames"),
            text("EXTNAME", "METADATA", ""),
        ];
        cards.extend(table.cards().into_iter().map(|(keyword, value, comment)| card(&keyword, &value, &comment)));
        let begun = self.end_data().and_then(|()| self.begin(cards));
        begun.map_err(|source| self.failed(source))
    }

    pub fn add_row(&mut self, row: &[u8]) -> Result<(), CubeError> {
        self.put(row).map_err(|source| self.failed(source))
    }

    /// Ends the table, syncs the file and returns its size.
    pub fn finish(&mut self) -> Result<u64, CubeError> {
        let synced = self.end_data().and_then(|()| self.file.flush()).and_then(|()| self.file.get_ref().sync_all());
        synced.map_err(|source| self.failed(source))?;
        Ok(self.length)
    }

    /// Gives the file its name.
    pub fn put_in_place(&mut self) -> Result<(), CubeError> {
        // A link, unlike a new name, never replaces a file that came meanwhile.
        let put = match std::fs::hard_link(&self.part, &self.target) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists || self.target.symlink_metadata().is_ok() => {
                return Err(CubeError::Exists(self.target.clone()));
            }
            Ok(()) => std::fs::remove_file(&self.part),
            // Some file systems have no links.
            Err(_) => std::fs::rename(&self.part, &self.target),
        };
        put.map_err(|source| self.failed(source))?;
        self.is_in_place = true;
        sync_folder(&self.target).map_err(|source| self.failed(source))
    }

    fn begin(&mut self, mut cards: Vec<[u8; card::LENGTH]>) -> io::Result<()> {
        cards.push(text("CHECKSUM", "0000000000000000", "makes this HDU add up to all ones"));
        cards.push(text("DATASUM", "0", "sum of the data"));
        let bytes = header(&cards);
        self.hdu = Unfinished { cards, begins: self.length, data_sum: 0, data_bytes: 0 };
        self.length += bytes.len() as u64;
        self.file.write_all(&bytes)
    }

    fn put(&mut self, data: &[u8]) -> io::Result<()> {
        self.file.write_all(data)?;
        self.length += data.len() as u64;
        self.hdu.data_bytes += data.len() as u64;
        // Sums are of whole words, and a frame may end within one.
        let mut data = data;
        while !self.rest.is_empty() && self.rest.len() < 4 && !data.is_empty() {
            self.rest.push(data[0]);
            data = &data[1..];
        }
        if self.rest.len() == 4 {
            self.hdu.data_sum = add(self.hdu.data_sum, sum(&self.rest));
            self.rest.clear();
        }
        let (words, rest) = data.split_at(data.len() / 4 * 4);
        self.hdu.data_sum = add(self.hdu.data_sum, sum(words));
        self.rest.extend(rest);
        Ok(())
    }

    /// Fills the last block and writes the header again, with its sums.
    fn end_data(&mut self) -> io::Result<()> {
        let length = self.hdu.data_bytes;
        let fill = length.next_multiple_of(BLOCK as u64) - length;
        self.put(&vec![0; fill as usize])?;
        let data_sum = self.hdu.data_sum;
        let cards = &mut self.hdu.cards;
        let at = cards.len() - 2;
        cards[at + 1] = text("DATASUM", &data_sum.to_string(), "sum of the data");
        let total = add(sum(&header(cards)), data_sum);
        cards[at] = text("CHECKSUM", &encode(!total), "makes this HDU add up to all ones");
        let bytes = header(cards);
        self.file.seek(SeekFrom::Start(self.hdu.begins))?;
        self.file.write_all(&bytes)?;
        self.file.seek(SeekFrom::Start(self.length))?;
        Ok(())
    }

    fn failed(&self, source: io::Error) -> CubeError {
        CubeError::Write { file: self.target.clone(), source }
    }
}

impl Drop for CubeFile {
    fn drop(&mut self) {
        if !self.is_in_place {
            let _ = std::fs::remove_file(&self.part);
        }
    }
}

/// In ones' complement, no bit and all bits are both zero.
fn is_same_sum(one: u32, other: u32) -> bool {
    one == other || (one.wrapping_add(1) <= 1 && other.wrapping_add(1) <= 1)
}

fn header(cards: &[[u8; card::LENGTH]]) -> Vec<u8> {
    let mut bytes = cards.as_flattened().to_vec();
    bytes.extend(b"END");
    bytes.resize(bytes.len().next_multiple_of(BLOCK), b' ');
    bytes
}

fn logical(keyword: &str, value: bool, comment: &str) -> [u8; card::LENGTH] {
    card(keyword, &Value::Logical(value), comment)
}

fn whole(keyword: &str, value: i64, comment: &str) -> [u8; card::LENGTH] {
    card(keyword, &Value::Whole(value), comment)
}

fn text(keyword: &str, value: &str, comment: &str) -> [u8; card::LENGTH] {
    card(keyword, &Value::Text(value.to_owned()), comment)
}

/// A card in the fixed format; the comment is cut where the card ends.
fn card(keyword: &str, value: &Value, comment: &str) -> [u8; card::LENGTH] {
    let value = match value {
        Value::Logical(value) => format!("{:>20}", if *value { "T" } else { "F" }),
        Value::Whole(value) => format!("{value:>20}"),
        Value::Number(value) => format!("{value:>20?}"),
        Value::Text(text) => format!("{:<20}", format!("'{:<8}'", text.replace('\'', "''"))),
        Value::Undefined => " ".repeat(20),
    };
    let comment = if comment.is_empty() { String::new() } else { format!(" / {comment}") };
    let mut line = format!("{keyword:<8}= {value}{comment}");
    line.truncate(card::LENGTH);
    let mut card = [b' '; card::LENGTH];
    for (place, byte) in card.iter_mut().zip(line.bytes()) {
        *place = byte;
    }
    card
}
