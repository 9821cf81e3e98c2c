//! A database that is damaged is put aside whole, and a new one begins: a night's frames matter more than its old rows.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode};

use super::{DatabaseError, prepare};

/// SQLite's own files next to the database; both are part of it.
const BESIDE: [&str; 2] = ["-wal", "-shm"];

/// Does SQLite report that the file is not a database, or no longer one?
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase))
}

/// Opens the database; one that is damaged is put aside, and a new one begins. Returns the text for the alert.
pub(super) fn open(path: &Path) -> Result<(Connection, Option<String>), DatabaseError> {
    match prepare(path) {
        Err(DatabaseError::Sqlite { source, .. }) if is_damage(&source) => {
            let told =
                put_aside(path, &source).map_err(|source| DatabaseError::Io { file: path.to_owned(), source })?;
            Ok((prepare(path)?, Some(told)))
        }
        opened => Ok((opened?, None)),
    }
}

/// Replaces a connection whose file was found damaged; returns the text for the alert.
pub(super) fn renew(
    connection: &mut Connection,
    path: &Path,
    error: &rusqlite::Error,
) -> Result<String, DatabaseError> {
    let failed = |source| DatabaseError::Sqlite { what: "begin anew", file: path.to_owned(), source };
    // The connection is closed before its files get other names: closing removes files by name.
    *connection = Connection::open_in_memory().map_err(failed)?;
    let told = put_aside(path, error).map_err(|source| DatabaseError::Io { file: path.to_owned(), source })?;
    *connection = prepare(path)?;
    Ok(told)
}

fn put_aside(path: &Path, error: &rusqlite::Error) -> io::Result<String> {
    let aside = (1..)
        .map(|number| with_ending(path, &format!(".bad-{number}")))
        .find(|aside| !aside.exists())
        .ok_or_else(|| io::Error::from(io::ErrorKind::AlreadyExists))?;
    if path.exists() {
        std::fs::rename(path, &aside)?;
    }
    for ending in BESIDE {
        let beside = with_ending(path, ending);
        if beside.exists() {
            std::fs::rename(beside, with_ending(&aside, ending))?;
        }
    }
    Ok(format!(
        "the archive's database {} is damaged ({error}); it was renamed to {}, and a new one has begun. Rows of frames come back from their \
         FITS files; telemetry and log of before are in the renamed file only (sqlite3 FILE .recover)",
        path.display(),
        aside.display()
    ))
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name: OsString = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}
