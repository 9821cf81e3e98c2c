//! The kind of a catalogue file, recognized by its first bytes and never by its name.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use crate::error::CatalogueError;

/// The kinds of catalogue files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Our own format, SMCAT 1.
    Packed,
    /// SQLite: Gaia-2MASS by declination.
    Sqlite,
    /// FITS, plain or packed by gzip or bzip2.
    Fits,
    /// Text: a table with commas, plain or packed by gzip.
    Csv,
}

impl Kind {
    /// Looks at the first bytes.
    ///
    /// # Errors
    /// [`CatalogueError`] when the file cannot be read, is empty, or is none of these.
    pub fn of(file: &Path) -> Result<Self, CatalogueError> {
        let broken = CatalogueError::file(file);
        let mut head = Vec::new();
        File::open(file).map_err(&broken)?.take(512).read_to_end(&mut head).map_err(&broken)?;
        if head.is_empty() {
            return Err(CatalogueError::content(file, "is empty (0 bytes): copy or fetch it again"));
        }
        if head.starts_with(b"BZh") {
            return Ok(Self::Fits);
        }
        if head.starts_with(&[0x1f, 0x8b]) {
            let opened = text(file)?;
            let mut inner = Vec::new();
            opened.take(512).read_to_end(&mut inner).map_err(&broken)?;
            head = inner;
        }
        if head.starts_with(b"SMCAT\0") {
            return Ok(Self::Packed);
        }
        if head.starts_with(b"SQLite format 3\0") {
            return Ok(Self::Sqlite);
        }
        if head.starts_with(b"SIMPLE  =") {
            return Ok(Self::Fits);
        }
        let markup = head.trim_ascii_start().starts_with(b"<");
        if !markup && head.iter().all(|byte| *byte >= b' ' || b"\t\r\n".contains(byte)) {
            return Ok(Self::Csv);
        }
        let looks = if markup { "is markup (HTML or XML)" } else { "is none of the kinds of catalogues" };
        Err(CatalogueError::content(
            file,
            format!("{looks}; expected Starmesh's format, a Gaia-2MASS SQLite file, a FITS binary table, or CSV"),
        ))
    }
}

/// A text file, unpacked when it is packed by gzip.
pub(crate) fn text(file: &Path) -> Result<Box<dyn BufRead>, CatalogueError> {
    let broken = CatalogueError::file(file);
    let mut plain = BufReader::new(File::open(file).map_err(&broken)?);
    let is_packed = plain.fill_buf().map_err(&broken)?.starts_with(&[0x1f, 0x8b]);
    Ok(if is_packed { Box::new(BufReader::new(flate2::bufread::MultiGzDecoder::new(plain))) } else { Box::new(plain) })
}
