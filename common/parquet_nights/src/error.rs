//! What can fail between the database and the files.

use std::path::{Path, PathBuf};

/// A night could not be written, or a database not be filled again.
#[derive(Debug, thiserror::Error)]
pub enum ParquetError {
    /// The file system.
    #[error("cannot {what} {}: {source}", path.display())]
    Io {
        /// The operation that failed.
        what: &'static str,
        /// With which file or folder.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The Parquet library.
    #[error("cannot {what} {}: {source}", path.display())]
    File {
        /// The operation that failed.
        what: &'static str,
        /// With which file.
        path: PathBuf,
        /// Why.
        #[source]
        source: parquet::errors::ParquetError,
    },
    /// SQLite.
    #[error("cannot {what} the table {table} of the database: {source}")]
    Sqlite {
        /// The operation that failed.
        what: &'static str,
        /// The table, by its name in the files.
        table: &'static str,
        /// Why.
        #[source]
        source: rusqlite::Error,
    },
    /// A value of the database is of another type than its column.
    #[error("the table {table} of the database has {found} in the column {column}, where {expected} was expected")]
    Value {
        /// The table, by its name in the files.
        table: &'static str,
        /// The column.
        column: &'static str,
        /// The value.
        found: String,
        /// The type of the column.
        expected: &'static str,
    },
    /// A file is not one of ours.
    #[error("{} is no file of the table {table}: {why}. Move it away, or use the Starmesh that wrote it", path.display())]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// The table whose folder it is in.
        table: &'static str,
        /// The difference.
        why: String,
    },
    /// A file is missing, or not the one that was written.
    #[error("{} has {rows} rows, and {expected} were written; copy it again from where it was written", path.display())]
    Lost {
        /// Which file.
        path: PathBuf,
        /// How many rows it has.
        rows: i64,
        /// How many it had.
        expected: i64,
    },
    /// There is nothing to fill a database from.
    #[error("{} has no night of {site}/{telescope}; {others}", folder.display())]
    Nothing {
        /// The folder that was searched.
        folder: PathBuf,
        /// The site.
        site: String,
        /// The telescope.
        telescope: String,
        /// Which telescopes it has.
        others: String,
    },
}

impl ParquetError {
    pub(crate) fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }

    pub(crate) fn file(what: &'static str, path: &Path) -> impl FnOnce(parquet::errors::ParquetError) -> Self {
        let path = path.to_owned();
        move |source| Self::File { what, path, source }
    }

    pub(crate) fn sqlite(what: &'static str, table: &'static str) -> impl FnOnce(rusqlite::Error) -> Self {
        move |source| Self::Sqlite { what, table, source }
    }
}
