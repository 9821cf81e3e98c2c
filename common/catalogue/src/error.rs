//! The faults of a catalogue file, and what to do then.

use std::path::PathBuf;

/// A catalogue that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CatalogueError {
    /// The operating system does not give or take it.
    #[error("{} cannot be read or written", file.display())]
    File {
        /// Which file.
        file: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// Our own format, damaged.
    #[error("{} cannot be used; build it again with `starmesh catalogue build`", file.display())]
    Packed {
        /// Which file.
        file: PathBuf,
        /// The fault.
        source: imaging::catalogue::CatalogueError,
    },
    /// SQLite does not read it.
    #[error("{} cannot be read as SQLite", file.display())]
    Sqlite {
        /// Which file.
        file: PathBuf,
        /// The error of SQLite.
        source: rusqlite::Error,
    },
    /// FITS that cannot be read; it names the file itself.
    #[error(transparent)]
    Fits(#[from] fits::FitsError),
    /// Text that is no table.
    #[error("{} cannot be read as a table in text", file.display())]
    Csv {
        /// Which file.
        file: PathBuf,
        /// Where and what.
        source: csv::Error,
    },
    /// Another kind of file than a catalogue, or columns are missing.
    #[error("{} {problem}", file.display())]
    Content {
        /// Which file.
        file: PathBuf,
        /// The finding, what was expected, and what to do; the text continues after the file's name.
        problem: String,
    },
}

impl CatalogueError {
    pub(crate) fn content(file: &std::path::Path, problem: impl Into<String>) -> Self {
        Self::Content { file: file.to_owned(), problem: problem.into() }
    }

    pub(crate) fn file(file: &std::path::Path) -> impl Fn(std::io::Error) -> Self + use<> {
        let file = file.to_owned();
        move |source| Self::File { file: file.clone(), source }
    }
}
