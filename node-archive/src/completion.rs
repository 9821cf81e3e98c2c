//! Completes the header of a file in place, so that a kill at any moment leaves the old header or the new one.
//!
//! A new file has spare room in its header, so the pixels stay where they are and are never copied, whatever their
//! number. The new header is computed in memory, written whole to a journal next to the file (`name.fits.header`, with
//! its hash, synced), then over the old one, and the journal is removed. A kill before the journal is whole changes
//! nothing; after that, [`Completer::recover`] writes the same bytes again. Where the room is used up, the file is
//! written anew next to the old one and renamed over it.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::folder::{PART_FOLDER, is_taken, sync_folder};
use crate::plan::Plan;
use crate::solution;
use crate::stored_header::Header;

const MAGIC: &[u8; 16] = b"STARMESH-HEADER1";

/// A header could not be completed; the file is as it was, or [`Completer::recover`] will finish it.
#[derive(Debug, thiserror::Error)]
pub enum CompletionError {
    /// The file system.
    #[error("cannot {what} {}: {source}", file.display())]
    File {
        /// The operation that failed.
        what: &'static str,
        /// With which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The file is no FITS file of ours.
    #[error("{} has no FITS header with an end", .0.display())]
    NoHeader(PathBuf),
}

/// Reads the header of a file.
pub fn read_header(path: &Path) -> Result<Header, CompletionError> {
    let header = Header::read(path).map_err(|source| failed("read", path, source))?;
    header.ok_or_else(|| CompletionError::NoHeader(path.to_owned()))
}

/// Completes headers one after the other, with one journal file for all of them.
///
/// The journal moves to the file it is for and back: on some file systems removing a file costs more than all the rest.
#[derive(Debug)]
pub struct Completer {
    spare: PathBuf,
}

impl Completer {
    /// One for the files of a folder of images, on one file system.
    pub fn new(images: &Path) -> Self {
        Self { spare: images.join(PART_FOLDER).join("spare.header") }
    }

    /// Sets the plan's keywords in a file whose header was read after [`Self::recover`]. Twice changes nothing more.
    pub fn complete(&self, path: &Path, mut header: Header, plan: &Plan) -> Result<(), CompletionError> {
        header.retain(|keyword| solution::stays(keyword, plan));
        for card in &plan.cards {
            header.set(card);
        }
        header.renew_history(&plan.own_history, &plan.history);
        header.update_checksum();
        let bytes = header.to_bytes();
        if bytes.len() != header.length() {
            return rewrite(path, &bytes, header.length() as u64);
        }
        self.write_journal(path, &bytes)?;
        write_over(path, &bytes)?;
        self.give_back(path)
    }

    /// Finishes what a kill interrupted; does nothing where there is nothing to finish.
    pub fn recover(&self, path: &Path) -> Result<(), CompletionError> {
        let journal = journal_of(path);
        let bytes = match fs::read(&journal) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(source) => return Err(failed("read", &journal, source)),
        };
        if let Some(header) = whole(&bytes, path) {
            write_over(path, header)?;
        }
        self.give_back(path)
    }

    fn write_journal(&self, path: &Path, header: &[u8]) -> Result<(), CompletionError> {
        let journal = journal_of(path);
        // There is none at first; one that was for another file names that file, and is not taken for this one's.
        let moved = match fs::rename(&self.spare, &journal) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            moved => moved,
        };
        let written = moved.and_then(|()| {
            refuse_link(&journal)?;
            let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(&journal)?;
            file.write_all(&entry(path, header))?;
            file.sync_all()
        });
        written.and_then(|()| sync_folder(&journal)).map_err(|source| failed("write", &journal, source))
    }

    fn give_back(&self, path: &Path) -> Result<(), CompletionError> {
        let journal = journal_of(path);
        let given = fs::rename(&journal, &self.spare).or_else(|_| fs::remove_file(&journal));
        given.map_err(|source| failed("remove", &journal, source))
    }
}

/// The journal next to a file.
pub fn journal_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".header");
    name.into()
}

/// The content of a journal: a mark, the lengths of name and header, both, and the hash of them.
fn entry(path: &Path, header: &[u8]) -> Vec<u8> {
    let name = name_of(path);
    let mut bytes = Vec::with_capacity(header.len() + name.len() + 64);
    bytes.extend_from_slice(MAGIC);
    for length in [name.len(), header.len()] {
        bytes.extend_from_slice(&(length as u64).to_le_bytes());
    }
    bytes.extend_from_slice(&name);
    bytes.extend_from_slice(header);
    let hash = Sha256::digest(&bytes);
    bytes.extend_from_slice(&hash);
    bytes
}

/// The header in a journal, if all of it is there and it is for this file; what follows is of an older, longer one.
fn whole<'a>(journal: &'a [u8], path: &Path) -> Option<&'a [u8]> {
    let length = |at: usize| -> Option<usize> {
        let bytes = journal.get(at..at + 8)?.try_into().ok()?;
        usize::try_from(u64::from_le_bytes(bytes)).ok()
    };
    let name = MAGIC.len() + 16;
    let header = name.checked_add(length(MAGIC.len())?)?;
    let end = header.checked_add(length(MAGIC.len() + 8)?)?;
    let hash = journal.get(end..end.checked_add(32)?)?;
    let is_whole = journal.starts_with(MAGIC) && Sha256::digest(&journal[..end]).as_slice() == hash;
    (is_whole && journal[name..header] == *name_of(path)).then(|| &journal[header..end])
}

/// A link that somebody put in place of a file is not followed: what it leads to is not ours.
fn refuse_link(path: &Path) -> io::Result<()> {
    let is_link = fs::symlink_metadata(path).is_ok_and(|found| found.is_symlink());
    if is_link { Err(io::Error::other("it is a link, and links here are not followed")) } else { Ok(()) }
}

fn name_of(path: &Path) -> Vec<u8> {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned().into_bytes()
}

fn write_over(path: &Path, header: &[u8]) -> Result<(), CompletionError> {
    let opened = refuse_link(path).and_then(|()| OpenOptions::new().write(true).open(path));
    let written = opened.and_then(|mut file| {
        file.write_all(header)?;
        file.sync_data()
    });
    written.map_err(|source| failed("write the header of", path, source))
}

/// Writes the file anew with a longer header, next to the old one, and renames it over the old one.
fn rewrite(path: &Path, header: &[u8], old_length: u64) -> Result<(), CompletionError> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let written = refuse_link(path).and_then(|()| File::open(path)).and_then(|mut old| {
        old.seek(SeekFrom::Start(old_length))?;
        // A file that a kill left, or a link that somebody put there.
        if is_taken(&part) {
            fs::remove_file(&part)?;
        }
        let mut new = OpenOptions::new().write(true).create_new(true).open(&part)?;
        new.write_all(header)?;
        io::copy(&mut old, &mut new)?;
        node::private::keep_permissions(path, &new);
        new.sync_all()
    });
    written.map_err(|source| failed("write", &part, source))?;
    let renamed = fs::rename(&part, path).and_then(|()| sync_folder(path));
    renamed.map_err(|source| failed("replace", path, source))
}

fn failed(what: &'static str, file: &Path, source: io::Error) -> CompletionError {
    CompletionError::File { what, file: file.to_owned(), source }
}

#[cfg(test)]
mod tests;
