//! The plain file behind an image in compressed tiles (`.fz`), as `funpack` restores it: the same cards, the same pixels,
//! the same sums (FITS Standard 4.0, section 10.1).

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use crate::card::LENGTH;
use crate::error::{Fault, FitsError};
use crate::hdu::{self, BLOCK, Content};
use crate::header::Header;
use crate::image::check_sum;
use crate::unpack::Source;
use crate::{tiles, tiling};

const CARDS_PER_BLOCK: usize = BLOCK / LENGTH;
/// A header longer than this is none of a frame.
const MOST_BLOCKS: usize = 1000;
/// The name that a table of tiles has unless the image had one of its own.
const NAME_OF_TABLE: &[u8] = b"EXTNAME = 'COMPRESSED_IMAGE'";
/// Keywords of the image, which the table keeps under other names: of the table, of the image.
const RENAMED: [(&str, &str); 11] = [
    ("ZSIMPLE", "SIMPLE"),
    ("ZTENSION", "XTENSION"),
    ("ZBITPIX", "BITPIX"),
    ("ZNAXIS", "NAXIS"),
    ("ZNAXIS*", "NAXIS"),
    ("ZEXTEND", "EXTEND"),
    ("ZBLOCKED", "BLOCKED"),
    ("ZPCOUNT", "PCOUNT"),
    ("ZGCOUNT", "GCOUNT"),
    ("ZHECKSUM", "CHECKSUM"),
    ("ZDATASUM", "DATASUM"),
];
/// Keywords that only a table of tiles has; `*` stands for a number.
const OF_TILES: [&str; 12] = [
    "XTENSION", "TFIELDS", "TTYPE*", "TFORM*", "THEAP", "ZIMAGE", "ZQUANTIZ", "ZDITHER0", "ZTILE*", "ZCMPTYPE",
    "ZNAME*", "ZVAL*",
];
/// Keywords that the table has as every HDU has, for itself.
const OF_EVERY_HDU: [&str; 8] = ["BITPIX", "NAXIS", "NAXIS*", "PCOUNT", "GCOUNT", "CHECKSUM", "DATASUM", "ZBLANK"];

fn fits_pattern(pattern: &str, keyword: &str) -> bool {
    match pattern.strip_suffix('*') {
        Some(begins) => keyword
            .strip_prefix(begins)
            .is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())),
        None => pattern == keyword,
    }
}

/// Whether a keyword is about compressed tiles, so that no image may have it for anything else.
pub fn is_about_tiles(keyword: &str) -> bool {
    OF_TILES.iter().any(|pattern| fits_pattern(pattern, keyword))
        || RENAMED.iter().any(|(of_table, _)| fits_pattern(of_table, keyword))
}

fn is_end(record: &[u8; LENGTH]) -> bool {
    record.starts_with(b"END     ")
}

/// The card of the image that is kept as this card of the table; `None` for a card about the table itself.
fn restored(record: &[u8; LENGTH]) -> Option<[u8; LENGTH]> {
    let keyword = String::from_utf8_lossy(&record[..8]).trim_end().to_owned();
    if let Some((_, of_image)) = RENAMED.iter().find(|(of_table, _)| fits_pattern(of_table, &keyword)) {
        let number = keyword.strip_prefix("ZNAXIS").unwrap_or_default();
        let mut card = *record;
        card[..8].copy_from_slice(format!("{:<8}", format!("{of_image}{number}")).as_bytes());
        return Some(card);
    }
    let is_of_table = OF_TILES.iter().chain(&OF_EVERY_HDU).any(|pattern| fits_pattern(pattern, &keyword));
    (!is_of_table && !record.starts_with(NAME_OF_TABLE)).then_some(*record)
}

/// The header of the plain image, in whole blocks with its END. `table` is that of its tiles as it is in the file,
/// in whole blocks, too. As many blocks as are empty there are empty here, since they keep room.
pub fn header(table: &[u8]) -> Vec<u8> {
    let records = table.as_chunks::<LENGTH>().0;
    let end = records.iter().position(is_end).unwrap_or(records.len());
    let used = records[..end].iter().rposition(|record| !record.trim_ascii().is_empty()).map_or(0, |last| last + 1);
    let empty_blocks = records.len().saturating_sub(used + 1) / CARDS_PER_BLOCK;
    let mut cards: Vec<[u8; LENGTH]> = records[..used].iter().filter_map(restored).collect();
    // The structure comes first, in the order of the standard.
    cards.sort_by_key(|record| match &record[..8] {
        b"SIMPLE  " | b"XTENSION" => 0,
        b"BITPIX  " => 1,
        b"NAXIS   " => 2,
        _ if record.starts_with(b"NAXIS") => 3,
        _ => 4,
    });
    let blocks = (cards.len() + 1).div_ceil(CARDS_PER_BLOCK) + empty_blocks;
    let mut bytes = cards.into_flattened();
    let end = bytes.len().max((blocks - 1) * BLOCK);
    bytes.resize(blocks * BLOCK, b' ');
    bytes[end..end + 3].copy_from_slice(b"END");
    bytes
}

/// The blocks of the next header of a file; `None` if it has no end.
pub(crate) fn next_header(file: &mut impl Read) -> std::io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    for _ in 0..MOST_BLOCKS {
        let start = bytes.len();
        bytes.resize(start + BLOCK, 0);
        match file.read_exact(&mut bytes[start..]) {
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        if bytes[start..].as_chunks::<LENGTH>().0.iter().any(is_end) {
            return Ok(Some(bytes));
        }
    }
    Ok(None)
}

/// The header with which a file begins, and that of its tiles where its image is in tiles.
pub struct FirstHeaders {
    /// The file's first header, in whole blocks.
    pub first: Vec<u8>,
    /// The header of the table of tiles, in whole blocks.
    pub table: Option<Vec<u8>>,
}

impl FirstHeaders {
    /// Reads them; `None` where a file has no header with an end.
    ///
    /// # Errors
    /// The error of the system.
    pub fn read(file: &mut impl Read) -> std::io::Result<Option<Self>> {
        let Some(first) = next_header(file)? else { return Ok(None) };
        // Most files are plain: they are recognized without reading all their cards.
        let axes = first.as_chunks::<LENGTH>().0.iter().find_map(|record| record.strip_prefix(b"NAXIS   ="));
        let has_no_pixels = axes.is_some_and(|axes| axes.trim_ascii_start().starts_with(b"0 "));
        let table = if has_no_pixels { next_header(file)? } else { None };
        let is_tiled = |table: &Vec<u8>| {
            Header::read(Path::new(""), table).is_some_and(|(header, _)| {
                header.logical("ZIMAGE") == Ok(true) && header.logical("ZSIMPLE") == Ok(true)
            })
        };
        Ok(Some(Self { first, table: table.filter(is_tiled) }))
    }

    /// The header of the plain image.
    pub fn plain(&self) -> Vec<u8> {
        self.table.as_deref().map_or_else(|| self.first.clone(), header)
    }
}

/// The whole plain file behind a file of one image in tiles; `None` for a file that is none.
///
/// # Errors
/// [`FitsError`] when the file cannot be read, is damaged, or does not decompress.
pub fn plain_file(file: &Path) -> Result<Option<Vec<u8>>, FitsError> {
    plain(file).map_err(|fault| FitsError { file: file.to_owned(), fault })
}

pub(crate) fn plain(file: &Path) -> Result<Option<Vec<u8>>, Fault> {
    let headers = FirstHeaders::read(&mut BufReader::new(File::open(file)?))?;
    let Some((first, table)) = headers.and_then(|headers| Some((headers.first, headers.table?))) else {
        return Ok(None);
    };
    let opened = File::open(file)?;
    let length = opened.metadata()?.len();
    let mut source = Source::new(opened, Some(length))?;
    let number = 2;
    let hdu = hdu::read(file, &mut source, first.len(), number)?;
    let broken = |problem: String| Fault::Header { hdu: number, problem };
    let hdu = hdu.ok_or_else(|| broken("its table of tiles is missing".to_owned()))?;
    let Content::Tiles(shape) = &hdu.content else { return Ok(None) };
    hdu.fill(&mut source)?;
    if length > hdu.next() as u64 {
        return Err(broken("more follows its tiles; unpack it with `funpack`".to_owned()));
    }
    tiling::check(&hdu.header, shape, hdu.data.len() as u64).map_err(&broken)?;
    let bytes = source.into_bytes();
    check_sum(&hdu, &bytes)?;
    let header = header(&table);
    let (of_image, _) = Header::read(file, &header).ok_or_else(|| broken("expected a card END".to_owned()))?;
    let data = hdu::data_length(&of_image, shape).map_err(&broken)?;
    let length =
        usize::try_from(data).ok().and_then(|data| data.checked_next_multiple_of(BLOCK)?.checked_add(header.len()));
    let length = length.filter(|length| *length as u64 <= crate::unpack::MOST_BYTES);
    let length = length.ok_or_else(|| broken("its image is longer than any frame".to_owned()))?;
    let mut restored = tiles::restore(bytes, number, length).map_err(|detail| Fault::Tiles { hdu: number, detail })?;
    // The same cards; those of the table are certain to be as they were, whatever cfitsio says of them.
    restored[..header.len()].copy_from_slice(&header);
    Ok(Some(restored))
}
