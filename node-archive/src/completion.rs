//! Completes the header of a file in place, so that a kill at any moment leaves the old header or the new one.
//!
//! A new file keeps room in its header, so the pixels stay where they are and are never copied, whatever their number.
//! The new header is first worked out on a copy of the header alone, then written whole to a journal beside the file
//! (`name.fits.header`, with its hash, synced), then over the old one, and the journal is removed. A kill before the
//! journal is whole changes nothing; after that, [`recover`] writes the same bytes again. Where the room is used up, the
//! file is written anew beside the old one and renamed over it.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::fits::{FitsError, FitsFile};
use crate::header::Plan;

/// FITS files are made of blocks of so many bytes.
const BLOCK: usize = 2880;
const CARD: usize = 80;
/// A header longer than this is none; ours have about 100 cards, and a block takes 36.
const MOST_BLOCKS: usize = 1000;
const MAGIC: &[u8; 16] = b"STARMESH-HEADER1";

/// A header could not be completed; the file is as it was, or [`recover`] will finish it.
#[derive(Debug, thiserror::Error)]
pub enum CompletionError {
    /// The file system.
    #[error("cannot {what} {}: {source}", file.display())]
    File {
        /// What was being done.
        what: &'static str,
        /// With which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// cfitsio.
    #[error(transparent)]
    Fits(#[from] FitsError),
    /// The file is no FITS file of ours.
    #[error("{} has no FITS header with an end", .0.display())]
    NoHeader(PathBuf),
}

/// The header of a file, as its cards stand there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    blocks: Vec<u8>,
}

impl Header {
    /// Reads the primary header of a file.
    pub fn read(path: &Path) -> Result<Self, CompletionError> {
        let mut file = File::open(path).map_err(|source| failed("open", path, source))?;
        let mut blocks = Vec::new();
        for _ in 0..MOST_BLOCKS {
            let start = blocks.len();
            blocks.resize(start + BLOCK, 0);
            if file.read_exact(&mut blocks[start..]).is_err() {
                break;
            }
            if blocks[start..].chunks(CARD).any(|card| card.starts_with(b"END     ")) {
                return Ok(Self { blocks });
            }
        }
        Err(CompletionError::NoHeader(path.to_owned()))
    }

    /// The cards before the end, without trailing blanks.
    pub fn cards(&self) -> impl Iterator<Item = String> {
        let cards = self.blocks.chunks(CARD).take_while(|card| !card.starts_with(b"END     "));
        let written = cards.map(|card| card.trim_ascii_end()).filter(|card| !card.is_empty());
        written.map(|card| String::from_utf8_lossy(card).into_owned())
    }

    /// The keywords that have a value.
    pub fn keywords(&self) -> BTreeSet<String> {
        self.cards().filter(|card| card.get(8..10) == Some("= ")).map(|card| card[..8].trim_end().to_owned()).collect()
    }

    /// The value of a keyword as it is written; the inside of the quotes for a text.
    pub fn value(&self, keyword: &str) -> Option<String> {
        let start = format!("{keyword:<8}= ");
        let card = self.cards().find(|card| card.starts_with(&start))?;
        let value = card[10..].trim_start();
        match value.strip_prefix('\'') {
            Some(text) => {
                let marked = text.replace("''", "\u{1}");
                let inside = marked.split('\'').next().unwrap_or_default();
                Some(inside.trim_end().replace('\u{1}', "'"))
            }
            None => Some(value.split('/').next().unwrap_or_default().trim().to_owned()),
        }
    }
}

/// Sets the plan's keywords in a file. Doing it twice changes nothing more.
pub fn complete_file(path: &Path, plan: &Plan) -> Result<(), CompletionError> {
    recover(path)?;
    let result = match prepare(path, plan)? {
        Prepared::InPlace(header) => {
            write_journal(path, &header)?;
            write_over(path, &header)
        }
        Prepared::Longer(header, old_length) => rewrite(path, &header, old_length),
    };
    result?;
    let journal = journal_of(path);
    fs::remove_file(&journal).map_err(|source| failed("remove", &journal, source))
}

/// Finishes what a kill interrupted; does nothing where there is nothing to finish.
pub fn recover(path: &Path) -> Result<(), CompletionError> {
    let journal = journal_of(path);
    let bytes = match fs::read(&journal) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(source) => return Err(failed("read", &journal, source)),
    };
    if let Some(header) = whole(&bytes) {
        write_over(path, header)?;
    }
    fs::remove_file(&journal).map_err(|source| failed("remove", &journal, source))
}

/// The journal beside a file.
pub fn journal_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".header");
    name.into()
}

enum Prepared {
    /// The new header, as long as the old one.
    InPlace(Vec<u8>),
    /// A longer one, and the old length.
    Longer(Vec<u8>, u64),
}

/// Works out the new header on a copy of the old one; the pixels behind it are a hole in the file, and never read.
fn prepare(path: &Path, plan: &Plan) -> Result<Prepared, CompletionError> {
    let old = Header::read(path)?;
    let length = fs::metadata(path).map_err(|source| failed("measure", path, source))?.len();
    let copy = journal_of(path);
    let copied = File::create(&copy).and_then(|mut file| {
        file.write_all(&old.blocks)?;
        file.set_len(length)
    });
    copied.map_err(|source| failed("write", &copy, source))?;
    let told: BTreeSet<String> = old.cards().collect();
    let mut fits = FitsFile::edit(&copy)?;
    for card in &plan.cards {
        fits.set(card)?;
    }
    for line in plan.history.iter().filter(|line| !told.contains(&format!("HISTORY {line}"))) {
        fits.history(line)?;
    }
    fits.update_checksum()?;
    let start = fits.data_start()?;
    fits.close()?;
    let mut header = vec![0; usize::try_from(start).unwrap_or(0)];
    let read = File::open(&copy).and_then(|mut file| file.read_exact(&mut header));
    read.map_err(|source| failed("read", &copy, source))?;
    let old_length = old.blocks.len();
    Ok(if header.len() == old_length { Prepared::InPlace(header) } else { Prepared::Longer(header, old_length as u64) })
}

fn write_journal(path: &Path, header: &[u8]) -> Result<(), CompletionError> {
    let journal = journal_of(path);
    let mut bytes = Vec::with_capacity(header.len() + 64);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(header.len() as u64).to_le_bytes());
    bytes.extend_from_slice(header);
    bytes.extend_from_slice(Sha256::digest(header).as_slice());
    let written = File::create(&journal).and_then(|mut file| {
        file.write_all(&bytes)?;
        file.sync_all()
    });
    written.and_then(|()| sync_folder(&journal)).map_err(|source| failed("write", &journal, source))
}

/// The header in a journal, if all of it is there.
fn whole(journal: &[u8]) -> Option<&[u8]> {
    let rest = journal.strip_prefix(MAGIC)?;
    let (length, rest) = rest.split_first_chunk::<8>()?;
    let (header, hash) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    (Sha256::digest(header).as_slice() == hash).then_some(header)
}

fn write_over(path: &Path, header: &[u8]) -> Result<(), CompletionError> {
    let written = OpenOptions::new().write(true).open(path).and_then(|mut file| {
        file.write_all(header)?;
        file.sync_data()
    });
    written.map_err(|source| failed("write the header of", path, source))
}

/// Writes the file anew with a longer header, beside the old one, and puts it in its place.
fn rewrite(path: &Path, header: &[u8], old_length: u64) -> Result<(), CompletionError> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let written = File::open(path).and_then(|mut old| {
        old.seek(SeekFrom::Start(old_length))?;
        let mut new = File::create(&part)?;
        new.write_all(header)?;
        io::copy(&mut old, &mut new)?;
        new.sync_all()
    });
    written.map_err(|source| failed("write", &part, source))?;
    let renamed = fs::rename(&part, path).and_then(|()| sync_folder(path));
    renamed.map_err(|source| failed("replace", path, source))
}

/// Makes a new name in a folder survive a power loss; Windows does so by itself.
pub fn sync_folder(file: &Path) -> io::Result<()> {
    if cfg!(unix) {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

fn failed(what: &'static str, file: &Path, source: io::Error) -> CompletionError {
    CompletionError::File { what, file: file.to_owned(), source }
}

#[cfg(test)]
mod tests;
