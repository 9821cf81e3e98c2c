//! The parts of a file: a header each, and the bytes that belong to it (FITS Standard 4.0, sections 3.3 and 7).

use std::ops::Range;
use std::path::Path;

use crate::card;
use crate::error::Fault;
use crate::header::{Header, KeywordError};
use crate::unpack::Source;

/// FITS comes in blocks of so many bytes.
pub(crate) const BLOCK: usize = 2880;
/// Bytes of a header that are looked at: some 150,000 cards.
const MOST_HEADER: usize = 4096 * BLOCK;
/// The standard's limit for NAXIS.
const MOST_AXES: i64 = 999;

/// The content of a part.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Pixels as they are.
    Image(Shape),
    /// Pixels in compressed tiles, in a table (section 10).
    Tiles(Shape),
    /// A table, or something else that is no image; its EXTNAME, else its XTENSION.
    Other(String),
}

/// Size and type of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shape {
    /// Bits of a pixel; negative for floats.
    pub bitpix: i64,
    /// Lengths of the axes, px; none for a header without data.
    pub axes: Vec<u64>,
}

/// One part of a file.
#[derive(Debug, Clone)]
pub struct Hdu {
    /// Its place in the file, from 1.
    pub number: usize,
    /// Its keywords.
    pub header: Header,
    /// Its content.
    pub content: Content,
    /// Where its data stand in the file, without what fills the last block.
    pub data: Range<usize>,
}

/// Reads the header of the part that begins at byte `start`; `None` where the file has ended.
///
/// # Errors
/// [`Fault::Header`] when mandatory keywords are missing or make no sense, [`Fault::CutShort`] when the header goes on
/// beyond the end of the file.
pub(crate) fn read(file: &Path, source: &mut Source, start: usize, number: usize) -> Result<Option<Hdu>, Fault> {
    source.fill((start + BLOCK) as u64)?;
    // After the last part there may be any bytes (section 3.5).
    if number > 1 && !source.bytes().get(start..).unwrap_or_default().starts_with(b"XTENSION") {
        return Ok(None);
    }
    let broken = |problem: String| Fault::Header { hdu: number, problem };
    let mut length = 0;
    let found = loop {
        let rest = source.bytes().get(start..).unwrap_or_default();
        if length >= MOST_HEADER {
            break None;
        }
        let block = rest.get(length..).unwrap_or_default();
        let block = block.get(..BLOCK).unwrap_or(block);
        let is_end = |card: &[u8]| matches!(card::read(card), card::Card::End);
        if block.chunks_exact(card::LENGTH).any(is_end) {
            break Header::read(file, rest.get(..length + block.len()).unwrap_or_default());
        }
        if block.len() < BLOCK {
            break None;
        }
        length += BLOCK;
        source.fill((start + length + BLOCK) as u64)?;
    };
    let Some((header, length)) = found else {
        let (rest, found) = (source.bytes().len() - start, source.bytes().len() as u64);
        let end = rest.div_ceil(BLOCK).max(1) * BLOCK;
        let cut = Fault::CutShort { hdu: number, expected: (start + end) as u64, found };
        return Err(if rest.is_multiple_of(BLOCK) { broken("expected a card END".to_owned()) } else { cut });
    };
    let shape = shape(&header, "").map_err(&broken)?;
    let length_of_data = data_length(&header, &shape).map_err(&broken)?;
    let first = start + length.div_ceil(BLOCK) * BLOCK;
    let data = first..first.saturating_add(usize::try_from(length_of_data).unwrap_or(usize::MAX));
    let content = content(&header, number, shape).map_err(&broken)?;
    Ok(Some(Hdu { number, header, content, data }))
}

impl Hdu {
    /// Where the next part begins.
    pub(crate) fn next(&self) -> usize {
        self.data.start.saturating_add(self.data.len().div_ceil(BLOCK).saturating_mul(BLOCK))
    }

    /// Reads its data; what fills the last block may be left out of the file.
    ///
    /// # Errors
    /// [`Fault::CutShort`] when they go on beyond the end of the file.
    pub(crate) fn fill(&self, source: &mut Source) -> Result<(), Fault> {
        if self.data.is_empty() {
            return Ok(());
        }
        source.fill(self.next() as u64)?;
        let found = source.bytes().len() as u64;
        let expected = self.data.end as u64;
        if expected > found { Err(Fault::CutShort { hdu: self.number, expected, found }) } else { Ok(()) }
    }

    /// In words, for people: `a table CATALOGUE`.
    pub(crate) fn words(&self) -> String {
        match &self.content {
            Content::Image(_) | Content::Tiles(_) => "a header without pixels".to_owned(),
            Content::Other(name) => format!("a table {name}"),
        }
    }
}

fn content(header: &Header, number: usize, shape: Shape) -> Result<Content, String> {
    if header.logical("ZIMAGE") == Ok(true) {
        return Ok(Content::Tiles(self::shape(header, "Z")?));
    }
    let kind = header.text("XTENSION").unwrap_or("IMAGE");
    if number == 1 && header.logical("GROUPS") == Ok(true) {
        return Ok(Content::Other("of random groups".to_owned()));
    }
    if kind == "IMAGE" || kind == "IUEIMAGE" {
        return Ok(Content::Image(shape));
    }
    Ok(Content::Other(header.text("EXTNAME").unwrap_or(kind).to_owned()))
}

/// BITPIX and NAXISn, with a prefix: those with `Z` in front are about the image in the tiles.
pub(crate) fn shape(header: &Header, prefix: &str) -> Result<Shape, String> {
    let bitpix = whole(header, &format!("{prefix}BITPIX"))?;
    if ![8, 16, 32, 64, -32, -64].contains(&bitpix) {
        return Err(format!("{prefix}BITPIX is {bitpix}, expected 8, 16, 32, 64, -32 or -64"));
    }
    let count = whole(header, &format!("{prefix}NAXIS"))?;
    if !(0..=MOST_AXES).contains(&count) {
        return Err(format!("{prefix}NAXIS is {count}, expected 0 to {MOST_AXES}"));
    }
    let axis = |n: i64| {
        let keyword = format!("{prefix}NAXIS{n}");
        let length = whole(header, &keyword)?;
        u64::try_from(length).map_err(|_| format!("{keyword} is {length}, expected a length"))
    };
    Ok(Shape { bitpix, axes: (1..=count).map(axis).collect::<Result<_, String>>()? })
}

/// Bytes of data: |BITPIX| / 8 * GCOUNT * (PCOUNT + product of the axes) (section 4.4.1.2); NAXIS1 = 0 in random
/// groups stands for none (section 6).
pub(crate) fn data_length(header: &Header, shape: &Shape) -> Result<u64, String> {
    let or = |keyword: &str, default: u64| match header.value(keyword) {
        None => Ok(default),
        Some(_) => {
            let value = whole(header, keyword)?;
            u64::try_from(value).map_err(|_| format!("{keyword} is {value}, expected none or more"))
        }
    };
    let groups = header.logical("GROUPS") == Ok(true) && shape.axes.first() == Some(&0);
    let axes = shape.axes.get(usize::from(groups)..).unwrap_or_default();
    if axes.is_empty() {
        return Ok(0);
    }
    let product = axes.iter().try_fold(1_u64, |product, length| product.checked_mul(*length));
    let values = product.and_then(|n| n.checked_add(or("PCOUNT", 0).ok()?));
    let bytes = values.and_then(|n| n.checked_mul(or("GCOUNT", 1).ok()?)?.checked_mul(shape.bitpix.unsigned_abs() / 8));
    or("PCOUNT", 0)?;
    or("GCOUNT", 1)?;
    // Room for the fill of the last block and for the bytes in front.
    bytes.filter(|bytes| *bytes < i64::MAX as u64).ok_or_else(|| "its axes are longer than any file".to_owned())
}

fn whole(header: &Header, keyword: &str) -> Result<i64, String> {
    header.whole(keyword).map_err(|error| match error {
        KeywordError::Missing { keyword, expected, .. } => format!("{keyword} is missing, expected {expected}"),
        KeywordError::Kind { keyword, found, expected, .. } => format!("{keyword} is {found}, expected {expected}"),
    })
}
