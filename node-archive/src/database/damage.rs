//! A database that is damaged is put aside whole, and a new one begins: a night's frames matter more than its old rows.

use std::io;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, ErrorCode};

use super::whole_file::{COMPANIONS, free_name, with_ending};
use super::{DatabaseError, migrations};

/// Does SQLite report that the file is not a database, or no longer one?
pub(super) fn is_damage(error: &rusqlite::Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase))
}

/// Opens the database; one that is damaged is put aside, and a new one begins. Returns the text for the alert.
pub(super) fn open(path: &Path) -> Result<(Connection, Option<String>), DatabaseError> {
    match migrations::open(path) {
        Err(DatabaseError::Sqlite { source, .. }) if is_damage(&source) => {
            begin_anew(path, &source).map(|(connection, text)| (connection, Some(text)))
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
    let (renewed, text) = begin_anew(path, error)?;
    *connection = renewed;
    Ok(text)
}

/// Renames a database with SQLite's own files; absent where there is none.
fn put_aside(path: &Path) -> io::Result<Option<PathBuf>> {
    let (aside, was_there) = (free_name(path, "bad")?, path.exists());
    for ending in COMPANIONS.into_iter().chain([""]) {
        let file = with_ending(path, ending);
        if file.exists() {
            std::fs::rename(file, with_ending(&aside, ending))?;
        }
    }
    Ok(was_there.then_some(aside))
}

fn begin_anew(path: &Path, error: &rusqlite::Error) -> Result<(Connection, String), DatabaseError> {
    let aside = put_aside(path).map_err(|source| DatabaseError::Io { file: path.to_owned(), source })?;
    let text = format!(
        "the archive's database {} is damaged ({error}); it was renamed to {}, and a new one has begun. Rows of frames come back from their \
         FITS files; telemetry and log of before are in the renamed file (sqlite3 FILE .recover) and in the daily copies (starmesh archive restore)",
        path.display(),
        aside.unwrap_or_default().display()
    );
    Ok((migrations::open(path)?, text))
}
