//! A FITS file of which a copy is made: the cards of its first part, and its bytes in pieces, so that a file of any size
//! needs little memory.

use std::fs::File;
use std::io::{BufRead as _, BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use super::cards::CardList;
use crate::checksum::{add, sum};
use crate::error::Fault;
use crate::hdu::{self, BLOCK};
use crate::header::Header;
use crate::restore;

/// Bytes that are read at a time.
const PIECE: usize = 64 * BLOCK;

/// The bytes of a file, wherever they are.
trait Bytes: Read + Seek {}
impl<T: Read + Seek> Bytes for T {}

/// A file, read up to the data of its first part. Of an image in tiles it is the plain file, in memory.
pub(super) struct SourceFile {
    file: BufReader<Box<dyn Bytes>>,
    /// Whether the file holds its image in tiles.
    pub is_tiled: bool,
    /// The header of its first part, as it is.
    pub header: Vec<u8>,
    /// The cards of that header.
    pub cards: CardList,
    /// Bytes of the data of the first part, with what fills the last block.
    pub data_bytes: u64,
    /// The part that was read last, from 1.
    number: usize,
}

impl SourceFile {
    /// Opens a file and reads its first header.
    pub fn open(path: &Path) -> Result<Self, Fault> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        if length == 0 {
            return Err(Fault::Empty);
        }
        let mut begin = [0; 9];
        let is_fits = file.read_exact(&mut begin).is_ok() && begin == *b"SIMPLE  =";
        if !is_fits {
            let looks = match begin {
                [0x1f, 0x8b, ..] => "is packed by gzip: unpack it with `gunzip`",
                [b'B', b'Z', b'h', ..] => "is packed by bzip2: unpack it with `bunzip2`",
                _ => "does not begin with SIMPLE; give a FITS file",
            };
            return Err(Fault::NotFits { looks: looks.to_owned() });
        }
        let broken = |problem: String| Fault::Header { hdu: 1, problem };
        file.seek(SeekFrom::Start(0))?;
        let plain = restore::plain(path)?;
        let is_tiled = plain.is_some();
        let length = plain.as_ref().map_or(length, |plain| plain.len() as u64);
        let bytes: Box<dyn Bytes> = match plain {
            Some(plain) => Box::new(Cursor::new(plain)),
            None => Box::new(file),
        };
        let mut file = BufReader::with_capacity(PIECE, bytes);
        let (cards, header_bytes) =
            CardList::read(&mut file)?.ok_or_else(|| broken("expected a card END".to_owned()))?;
        let mut header = vec![0; header_bytes];
        file.seek(SeekFrom::Start(0))?;
        file.read_exact(&mut header)?;
        let (keywords, _) = Header::read(path, &header).ok_or_else(|| broken("expected a card END".to_owned()))?;
        let shape = hdu::shape(&keywords, "").map_err(&broken)?;
        let data_bytes = hdu::data_length(&keywords, &shape).map_err(&broken)?;
        if data_bytes == 0 {
            let found =
                "a first part without pixels; `funpack` makes a plain file of one with several images".to_owned();
            return Err(Fault::NoImage { found });
        }
        let data_bytes = data_bytes.div_ceil(BLOCK as u64) * BLOCK as u64;
        let expected = header_bytes as u64 + data_bytes;
        if length < expected {
            return Err(Fault::CutShort { hdu: 1, expected, found: length });
        }
        // Whatever follows is whole blocks, too (FITS Standard 4.0, section 3.1).
        if !length.is_multiple_of(BLOCK as u64) {
            let expected = length.next_multiple_of(BLOCK as u64);
            return Err(Fault::CutShort { hdu: 2, expected, found: length });
        }
        Ok(Self { file, is_tiled, header, cards, data_bytes, number: 1 })
    }

    /// Reads the data of the first part, hands over each piece, and returns their sum. Once.
    pub fn sum_of_data(&mut self, take: impl FnMut(&[u8]) -> std::io::Result<()>) -> Result<u32, Fault> {
        self.sum_of(self.data_bytes, 1, take)
    }

    /// Reads the next part behind the first one and hands over its pieces; after [`Self::sum_of_data`]. `None` behind the
    /// last one.
    pub fn next_hdu(&mut self, mut take: impl FnMut(&[u8]) -> std::io::Result<()>) -> Result<Option<LaterHdu>, Fault> {
        let number = self.number + 1;
        if self.file.fill_buf()?.is_empty() {
            return Ok(None);
        }
        let broken = |problem: String| Fault::Header { hdu: number, problem };
        let bytes = restore::next_header(&mut self.file)?.ok_or_else(|| broken("expected a card END".to_owned()))?;
        if !bytes.starts_with(b"XTENSION") {
            return Err(broken("it does not begin with XTENSION".to_owned()));
        }
        let read = (Header::read(Path::new(""), &bytes), CardList::read(bytes.as_slice())?);
        let (Some((keywords, _)), Some((cards, _))) = read else {
            return Err(broken("expected a card END".to_owned()));
        };
        let shape = hdu::shape(&keywords, "").map_err(&broken)?;
        let data_bytes = hdu::data_length(&keywords, &shape).map_err(&broken)?.next_multiple_of(BLOCK as u64);
        take(&bytes)?;
        let data_sum = self.sum_of(data_bytes, number, take)?;
        self.number = number;
        Ok(Some(LaterHdu { number, cards, header_sum: sum(&bytes), data_sum }))
    }

    fn sum_of(
        &mut self,
        bytes: u64,
        number: usize,
        mut take: impl FnMut(&[u8]) -> std::io::Result<()>,
    ) -> Result<u32, Fault> {
        let (mut piece, mut left, mut total) = (vec![0; PIECE], bytes, 0);
        while left > 0 {
            let count = usize::try_from(left).unwrap_or(PIECE).min(PIECE);
            let part = &mut piece[..count];
            self.file.read_exact(part).map_err(|error| match error.kind() {
                ErrorKind::UnexpectedEof => Fault::CutShort { hdu: number, expected: bytes, found: bytes - left },
                _ => error.into(),
            })?;
            total = add(total, sum(part));
            take(part)?;
            left -= count as u64;
        }
        Ok(total)
    }
}

/// A part behind the first one, as it was read.
pub(super) struct LaterHdu {
    /// The first part of a file is 1.
    pub number: usize,
    pub cards: CardList,
    pub header_sum: u32,
    pub data_sum: u32,
}
