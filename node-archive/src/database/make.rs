//! A database that is made whole under another name before it has its own.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use rusqlite::Connection;

use super::migrations;
use super::whole_file::{COMPANIONS, with_ending};

/// Makes a database with all tables, has it filled, and gives it its name only when it is whole and on disk.
///
/// # Errors
/// Filling fails, the disk is full, or a file has that name by then; nothing is left of the new database.
pub(crate) fn make<T>(database: &Path, fill: impl FnOnce(&Connection) -> anyhow::Result<T>) -> anyhow::Result<T> {
    if let Some(folder) = database.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    for companion in COMPANIONS {
        let file = with_ending(database, companion);
        if file.exists() {
            bail!("{} belongs to another database: move it away first", file.display());
        }
    }
    let part = Part(with_ending(database, &format!(".part-{}", std::process::id())));
    // What a killed program of the same process id left, as in a container, is half filled.
    part.remove();
    let connection = migrations::open(&part.0)?;
    // A file that is of no use before it is whole needs no journal.
    connection.execute_batch("PRAGMA journal_mode = DELETE; PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")?;
    let filled = fill(&connection)?;
    connection.close().map_err(|(_, error)| error)?;
    if let Some(fault) = super::backup::fault(&part.0)? {
        bail!("the new database is damaged ({fault}); look at the disk of {}", part.0.display());
    }
    let name = || -> io::Result<()> {
        File::open(&part.0)?.sync_all()?;
        // A link, unlike a new name, replaces nothing that came meanwhile.
        match fs::hard_link(&part.0, database) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Err(error),
            Err(_) if !database.exists() => fs::rename(&part.0, database)?,
            linked => linked?,
        }
        #[cfg(unix)]
        if let Some(folder) = database.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            File::open(folder)?.sync_all()?;
        }
        Ok(())
    };
    name().with_context(|| format!("cannot give the new database the name {}", database.display()))?;
    Ok(filled)
}

/// A database under its temporary name, which is removed in any case.
struct Part(PathBuf);

impl Part {
    fn remove(&self) {
        for ending in COMPANIONS.into_iter().chain(["-journal", ""]) {
            // What cannot be removed is not there, or lies on a disk that takes nothing.
            let _ = fs::remove_file(with_ending(&self.0, ending));
        }
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        self.remove();
    }
}
