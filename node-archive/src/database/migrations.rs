//! The versions of the tables: an older file is brought up to the newest one, and a copy of it stays next to it; a newer
//! file is refused.

use std::path::{Path, PathBuf};

use rusqlite::Connection;
use rusqlite_migration::{M, Migrations};

use super::{DatabaseError, guiding, happenings, owner, rows, streams, telemetry, views};

/// What each version adds. The number of a version stands in the file as `PRAGMA user_version`. A step that sites have
/// run stays as it is; changes come as a step more.
pub(super) const STEPS: [&str; 13] = [
    rows::SCHEMA,
    rows::AUDIT,
    rows::FACTS,
    rows::SOLUTIONS,
    guiding::SCHEMA,
    rows::FOCUS,
    telemetry::SCHEMA,
    rows::SEARCH,
    happenings::SCHEMA,
    owner::SCHEMA,
    streams::SCHEMA,
    happenings::VERDICTS,
    // The views were made here once; they hold no data and are made anew at each start.
    "",
];

/// The version that this Starmesh writes.
pub(super) const VERSION: i64 = STEPS.len() as i64;

/// Opens the file and brings its tables up to date.
pub(super) fn open(path: &Path) -> Result<Connection, DatabaseError> {
    let failed = |what| move |source| DatabaseError::Sqlite { what, file: path.to_owned(), source };
    let mut connection = Connection::open(path).map_err(failed("open"))?;
    let settings = "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA busy_timeout = 5000;
        PRAGMA wal_autocheckpoint = 4000;";
    connection.execute_batch(settings).map_err(failed("set up"))?;
    let found = version(&connection).map_err(failed("read the version of"))?;
    if found > VERSION {
        return Err(DatabaseError::Newer { file: path.to_owned(), found });
    }
    if (1..VERSION).contains(&found) {
        let copy = keep_copy(&connection, path, found)?;
        tracing::warn!(
            file = %path.display(), from = found, to = VERSION, copy = %copy.display(),
            "the database is of an older Starmesh and is brought up to date; the copy is as it was",
        );
    }
    bring_up(&mut connection).map_err(|error| match error {
        rusqlite_migration::Error::RusqliteError { err, .. } => failed("bring up to date")(err),
        other => DatabaseError::Migration { file: path.to_owned(), why: other.to_string() },
    })?;
    Ok(connection)
}

/// Takes the steps that a file lacks, and makes the views of this Starmesh.
pub(super) fn bring_up(connection: &mut Connection) -> rusqlite_migration::Result<()> {
    Migrations::from_iter(STEPS.map(M::up)).to_latest(connection)?;
    let transaction = connection.transaction()?;
    transaction.execute_batch(views::SCHEMA)?;
    Ok(transaction.commit()?)
}

/// The version of a file's tables; 0 where it has none.
pub(super) fn version(connection: &Connection) -> rusqlite::Result<i64> {
    connection.query_row("PRAGMA user_version", [], |row| row.get(0))
}

/// Copies the whole database to `NAME.version-N`, once: a copy that is there already is older than what this would be.
fn keep_copy(connection: &Connection, path: &Path, found: i64) -> Result<PathBuf, DatabaseError> {
    let copy = super::whole_file::with_ending(path, &format!(".version-{found}"));
    if !copy.exists() {
        super::whole_file::copy(connection, &copy)?;
    }
    Ok(copy)
}
