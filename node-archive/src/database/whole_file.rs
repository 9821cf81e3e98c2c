//! A database as one thing: its file with those that SQLite puts next to it, names for others of it, and a copy.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use rusqlite::Connection;
use rusqlite::backup::Backup;

use super::DatabaseError;

/// SQLite's own files next to the database; both are part of it.
pub(super) const COMPANIONS: [&str; 2] = ["-wal", "-shm"];

/// Copies a database as it is now into a file that appears only when it is whole. Writers go on meanwhile.
pub(super) fn copy(from: &Connection, to: &Path) -> Result<(), DatabaseError> {
    let part = with_ending(to, ".part");
    let io_failed = |source| DatabaseError::Io { file: to.to_owned(), source };
    let copied = || -> rusqlite::Result<()> {
        let mut copy = Connection::open(&part)?;
        // In one step: between two steps a writer would make SQLite begin again.
        Backup::new(from, &mut copy)?.step(-1)?;
        copy.pragma_update(None, "journal_mode", "DELETE")?;
        Ok(())
    };
    remove(&part).map_err(io_failed)?;
    copied().map_err(|source| DatabaseError::Sqlite { what: "copy", file: to.to_owned(), source })?;
    let put = || -> io::Result<()> {
        File::open(&part)?.sync_all()?;
        fs::rename(&part, to)?;
        #[cfg(unix)]
        if let Some(folder) = to.parent() {
            File::open(folder)?.sync_all()?;
        }
        Ok(())
    };
    put().map_err(io_failed)
}

fn remove(file: &Path) -> io::Result<()> {
    match fs::remove_file(file) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// `NAME.WORD-1`, or the next number that is free.
pub(super) fn free_name(path: &Path, word: &str) -> io::Result<PathBuf> {
    free_or(path, word, |_| false)
}

/// The same, or the first name of what is there already and suits.
pub(super) fn free_or(path: &Path, word: &str, suits: impl Fn(&Path) -> bool) -> io::Result<PathBuf> {
    let mut names = (1..).map(|number| with_ending(path, &format!(".{word}-{number}")));
    names.find(|name| !name.exists() || suits(name)).ok_or_else(|| io::Error::from(io::ErrorKind::AlreadyExists))
}

pub(super) fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name: OsString = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}
