//! The versions of the tables: an older file is brought up to the newest one, and a copy of it stays next to it; a newer
//! file is refused.

use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags};
use rusqlite_migration::{M, Migrations};

use super::{DatabaseError, guiding, happenings, owner, rows, streams, telemetry, views, whole_file};

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

/// Copies the whole database to `NAME.version-N-1`, or to the next name like it that no older copy has. What was copied
/// already and has not changed is not copied again: a start that fails may be tried often.
fn keep_copy(connection: &Connection, path: &Path, found: i64) -> Result<PathBuf, DatabaseError> {
    let now = last_rows(connection).ok();
    let is_copy = |copy: &Path| {
        let opened = Connection::open_with_flags(copy, OpenFlags::SQLITE_OPEN_READ_ONLY);
        opened.and_then(|copy| last_rows(&copy)).is_ok_and(|rows| Some(rows) == now)
    };
    let copy = whole_file::free_or(path, &format!("version-{found}"), is_copy)
        .map_err(|source| DatabaseError::Io { file: path.to_owned(), source })?;
    if !copy.exists() {
        whole_file::copy(connection, &copy)?;
    }
    Ok(copy)
}

/// The newest rows of two tables that each version has: a database that was written to has others.
fn last_rows(connection: &Connection) -> rusqlite::Result<(Option<i64>, Option<i64>)> {
    let sql = "SELECT (SELECT max(rowid) FROM images), (SELECT max(rowid) FROM log)";
    connection.query_row(sql, [], |row| Ok((row.get(0)?, row.get(1)?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_copy_before_a_migration_is_as_the_database_was_and_no_older_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("archive.db");
        let connection = Connection::open(&path).unwrap();
        connection.execute_batch(rows::SCHEMA).unwrap();
        let log = |at: &str| {
            let put = "INSERT INTO log VALUES (?1, 'INFO', '', 'n', 't', 'callisto', 'b', ?2)";
            connection.execute(put, (at, at.len() as i64)).unwrap();
        };
        let lines = |copy: &Path| {
            let count = "SELECT count(*) FROM log";
            Connection::open(copy).unwrap().query_row(count, [], |row| row.get::<_, i64>(0)).unwrap()
        };
        let keep = || keep_copy(&connection, &path, 1).unwrap();
        log("May");
        let first = keep();
        assert_eq!((first.clone(), keep()), (folder.path().join("archive.db.version-1-1"), first.clone()));
        // An older Starmesh went on with it for months.
        log("September");
        let second = keep();
        assert_eq!((second.clone(), keep()), (folder.path().join("archive.db.version-1-2"), second.clone()));
        assert_eq!((lines(&first), lines(&second)), (1, 2));
    }
}
