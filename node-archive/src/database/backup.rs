//! Copies of the whole database: one each day, and one that is put back in its place.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, anyhow, bail, ensure};
use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::whole_file::{COMPANIONS, copy, free_name, with_ending};
use super::{DatabaseError, migrations};

/// Copies the database to `NIGHT.db` in a folder, and removes copies older than the newest `count`. Returns the copy;
/// none where that night has one.
pub fn backup(database: &Path, folder: &Path, night: &str, count: usize) -> anyhow::Result<Option<PathBuf>> {
    node::private::make_folder(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let to = folder.join(format!("{night}.db"));
    if to.exists() || is_being_made(&to) {
        return Ok(None);
    }
    let from = Connection::open_with_flags(database, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    copy(&from, &to)?;
    if let Some(fault) = fault(&to)? {
        let bad = with_ending(&to, ".bad");
        fs::rename(&to, &bad)?;
        bail!("the copy {} is damaged, so the database may be: {fault}", bad.display());
    }
    for old in copies(folder)?.into_iter().rev().skip(count.max(1)) {
        fs::remove_file(&old).with_context(|| format!("cannot remove the old copy {}", old.display()))?;
    }
    Ok(Some(to))
}

/// Telescopes that share a database make one copy. One that a kill left half made is made anew after this.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(3600);

fn is_being_made(copy: &Path) -> bool {
    let begun = fs::metadata(with_ending(copy, ".part")).and_then(|part| part.modified());
    begun.is_ok_and(|begun| begun.elapsed().is_ok_and(|age| age < GIVEN_UP_AFTER))
}

/// Copies the database as it is now into a file of any name, while an archive node may run.
pub fn copy_now(database: &Path, to: &Path) -> anyhow::Result<()> {
    ensure!(!to.exists(), "{} is there already; a copy replaces nothing", to.display());
    let from = Connection::open_with_flags(database, OpenFlags::SQLITE_OPEN_READ_ONLY)
        .with_context(|| format!("cannot open the database {}", database.display()))?;
    copy(&from, to)?;
    match fault(to)? {
        None => Ok(()),
        Some(fault) => bail!("{} was made and is damaged, so the database may be: {fault}", to.display()),
    }
}

/// The copies in a folder, the oldest first.
fn copies(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let is_night = |name: &str| name.len() == 8 && name.bytes().all(|byte| byte.is_ascii_digit());
        let is_copy = path.extension().is_some_and(|ending| ending == "db")
            && path.file_stem().and_then(|name| name.to_str()).is_some_and(is_night);
        if is_copy {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// What is wrong with a database; absent where it is sound.
pub(super) fn fault(file: &Path) -> rusqlite::Result<Option<String>> {
    let connection = Connection::open_with_flags(file, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    let verdict: String = connection.query_row("PRAGMA integrity_check(1)", [], |row| row.get(0))?;
    Ok(Some(verdict).filter(|verdict| verdict != "ok"))
}

/// Puts a copy in the place of the database, which is renamed. Only while no archive node uses it.
pub fn restore(copy_file: &Path, database: &Path) -> anyhow::Result<Option<PathBuf>> {
    let name = copy_file.display();
    ensure!(copy_file.is_file(), "{name} is not there; the copies are in the folder that [archive] backups names");
    let damaged = |why: &dyn std::fmt::Display| anyhow!("{name} is damaged and is not put back: {why}");
    match fault(copy_file) {
        Ok(None) => {}
        Ok(Some(why)) => return Err(damaged(&why)),
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt) => return Err(damaged(&error)),
        Err(error) => return Err(error).with_context(|| format!("{name} cannot be read as a database")),
    }
    let from = Connection::open_with_flags(copy_file, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    let found = migrations::version(&from)?;
    ensure!(found > 0, "{name} has no tables of Starmesh's archive");
    if found > migrations::VERSION {
        return Err(DatabaseError::Newer { file: copy_file.to_owned(), found }.into());
    }
    if let Some(folder) = database.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    // First a copy in the same folder, then the names: what fails before leaves everything as it was.
    let ready = with_ending(database, ".restored");
    copy(&from, &ready)?;
    node::private::keep_permissions(database, &fs::File::open(&ready)?);
    let aside = copy_aside(database).with_context(|| format!("cannot keep {} as it is", database.display()))?;
    fs::rename(&ready, database).with_context(|| format!("cannot replace {}", database.display()))?;
    Ok(aside)
}

/// Keeps the database under another name while it also stays under its own. What SQLite had not yet put into it goes
/// with the other name: in the restored file it would be wrong.
fn copy_aside(database: &Path) -> io::Result<Option<PathBuf>> {
    if !database.exists() {
        return Ok(None);
    }
    let aside = free_name(database, "before")?;
    fs::hard_link(database, &aside).or_else(|_| fs::copy(database, &aside).map(drop))?;
    for companion in COMPANIONS {
        let file = with_ending(database, companion);
        if file.exists() {
            fs::rename(file, with_ending(&aside, companion))?;
        }
    }
    Ok(Some(aside))
}

#[cfg(test)]
#[path = "backup_tests.rs"]
mod tests;
