//! The folder of images: one archive of a telescope writes in it, and nothing outside it is ever written.
//!
//! The folder itself may be a link to another disk, as the site configured it. Below it no link is followed: names of
//! folders come from schedules and templates, and a person who can put a link there must not choose what is written
//! elsewhere.

use std::fs::{self, File, TryLockError};
use std::io::{self, Seek as _, Write as _};
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use contract::Address;

/// Folder of files that are being written, inside the folder of images.
pub const PART_FOLDER: &str = ".part";
/// An archive that is being restarted leaves its locks within this time, machine time.
const LEAVES_WITHIN: Duration = Duration::from_secs(5);
/// Names that are tried for a folder whose own name is taken by something else.
const MOST_NAMES: u32 = 100;

/// The right to write a telescope's files; it ends when this is dropped, or with the process.
#[derive(Debug)]
pub struct Claim {
    /// `None` where the file system knows no locks.
    _lock: Option<File>,
}

/// Takes the folder of images for this archive; `who` names it to others.
///
/// # Errors
/// Another archive of this telescope writes there, or a lock file cannot be made.
pub async fn claim(images: &Path, telescope: &Address, who: &str) -> anyhow::Result<Claim> {
    prepare(images, telescope).with_context(|| format!("cannot use the folder of images {}", images.display()))?;
    let file = images.join(PART_FOLDER).join(lock_name(telescope));
    lock("the folder of images", images, &file, who).await
}

/// Takes the database for this archive, whose images may be on a disk that is away.
///
/// # Errors
/// As those of [`claim`].
pub async fn claim_database(database: &Path, telescope: &Address, who: &str) -> anyhow::Result<Claim> {
    let mut file = database.as_os_str().to_owned();
    file.push(format!(".{}", lock_name(telescope)));
    lock("the database", database, Path::new(&file), who).await
}

fn lock_name(telescope: &Address) -> String {
    format!("{}-{}.lock", telescope.site, telescope.telescope)
}

/// Takes a database from the archives of the other telescopes that share it.
pub async fn claim_from_others(database: &Path, telescope: &Address, who: &str) -> anyhow::Result<Vec<Claim>> {
    let folder = database.parent().unwrap_or(Path::new("."));
    let begins = format!("{}.", database.file_name().unwrap_or_default().to_string_lossy());
    let (own, mut claims) = (lock_name(telescope), Vec::new());
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read the folder {}", folder.display()))? {
        let file = entry?.path();
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with(&begins) && name.ends_with(".lock") && !name.ends_with(&format!(".{own}")) {
            claims.push(lock("the database", database, &file, who).await?);
        }
    }
    Ok(claims)
}

async fn lock(what: &str, place: &Path, file: &Path, who: &str) -> anyhow::Result<Claim> {
    let cannot = || format!("cannot make the lock file {}", file.display());
    if let Some(folder) = file.parent() {
        fs::create_dir_all(folder).with_context(cannot)?;
    }
    let mut opened = File::options().read(true).write(true).create(true).truncate(false).open(file);
    let lock = opened.as_mut().map_err(|error| io::Error::new(error.kind(), error.to_string())).with_context(cannot)?;
    let began = tokio::time::Instant::now();
    loop {
        match lock.try_lock() {
            Ok(()) => break,
            Err(TryLockError::WouldBlock) if began.elapsed() < LEAVES_WITHIN => {
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
            Err(TryLockError::WouldBlock) => {
                let holder = fs::read_to_string(file).unwrap_or_default();
                let holder = if holder.trim().is_empty() { "another process".to_owned() } else { one_line(&holder) };
                bail!(
                    "{what} {} is in use by {holder}. Two archives of one telescope would store every frame twice. Stop \
                     one of them, or give this one its own [folders] images and [archive] database",
                    place.display()
                );
            }
            Err(TryLockError::Error(error)) => {
                tracing::warn!(file = %file.display(), %error, "this file system has no locks; nothing prevents a second archive");
                return Ok(Claim { _lock: None });
            }
        }
    }
    // Its text is for people only.
    let note = format!("archive node {who}, process {} on host {}\n", std::process::id(), node::host_name());
    let _ = lock.set_len(0).and_then(|()| lock.rewind()).and_then(|()| lock.write_all(note.as_bytes()));
    Ok(Claim { _lock: opened.ok() })
}

fn one_line(text: &str) -> String {
    text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).take(200).collect()
}

/// Where a telescope's files lie while they are written; telescopes that share a folder of images have one each.
pub fn parts(images: &Path, telescope: &Address) -> PathBuf {
    images.join(PART_FOLDER).join(format!("{}-{}", telescope.site, telescope.telescope))
}

/// Makes the folders; a link in the place of one is replaced.
fn prepare(images: &Path, telescope: &Address) -> io::Result<()> {
    if let Some(above) = images.parent() {
        fs::create_dir_all(above)?;
    }
    for folder in [images.to_owned(), images.join(PART_FOLDER), parts(images, telescope)] {
        let is_ours = folder != images;
        if is_ours && fs::symlink_metadata(&folder).is_ok_and(|found| !found.is_dir()) {
            tracing::warn!(path = %folder.display(), "a link or file is in the place of the archive's own folder; it is removed");
            fs::remove_file(&folder)?;
        }
        node::private::make_public_folder(&folder)?;
    }
    Ok(())
}

/// Proves that the folder of images, with the archive's own in it, and these folders of files in it are there: where one is
/// missing, the disk is away, and a file that is not there was not removed.
///
/// # Errors
/// Which folder is missing, and what to do.
pub fn all_here<'a>(images: &Path, folders: impl IntoIterator<Item = &'a Path>) -> anyhow::Result<()> {
    let own = images.join(PART_FOLDER);
    let away =
        if own.is_dir() { folders.into_iter().find(|folder| !folder.is_dir()).map(Path::to_owned) } else { Some(own) };
    let Some(away) = away else { return Ok(()) };
    bail!(
        "the folder {} is not there: its disk may be away. Mount it; if somebody removed the folder or moved it elsewhere, make \
         an empty one of this name, and what was in it counts as removed",
        away.display()
    )
}

/// Whether a file is in the folder of images; where it is not, it was removed.
///
/// # Errors
/// Its disk is away ([`all_here`]), or cannot be read.
pub fn is_stored(images: &Path, file: &Path) -> anyhow::Result<bool> {
    let is_there = file.try_exists().with_context(|| format!("cannot look for {}", file.display()))?;
    if !is_there {
        all_here(images, file.parent())?;
    }
    Ok(is_there)
}

/// Whether the folder of images is missing or empty, as the place of a disk is that is not mounted.
pub fn is_bare(images: &Path) -> bool {
    match fs::read_dir(images) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    }
}

/// Removes what a kill left half written by this telescope's archive. Only under a [`Claim`].
pub fn clear_parts(images: &Path, telescope: &Address) -> io::Result<()> {
    for entry in fs::read_dir(parts(images, telescope))? {
        match fs::remove_file(entry?.path()) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            removed => removed?,
        }
    }
    Ok(())
}

/// Makes the folders of a path relative to the folder of images, and returns where the file goes: a part that a link or
/// a file has taken gets another name.
///
/// # Errors
/// The file system refuses, or the path leads out of the folder.
pub fn make_way(images: &Path, relative: &Path) -> io::Result<PathBuf> {
    let name = relative.file_name().ok_or_else(|| io::Error::other("the path has no file name"))?;
    let mut folder = images.to_owned();
    for part in relative.parent().unwrap_or(Path::new("")).components() {
        let Component::Normal(part) = part else {
            return Err(io::Error::other(format!("{} leads out of the folder of images", relative.display())));
        };
        folder = real_folder(&folder, &part.to_string_lossy())?;
    }
    Ok(folder.join(name))
}

/// A folder of this name, or of the next free one like it, that is no link.
fn real_folder(inside: &Path, name: &str) -> io::Result<PathBuf> {
    for number in 1..=MOST_NAMES {
        let folder = if number == 1 { inside.join(name) } else { inside.join(format!("{name}-v{number}")) };
        match fs::symlink_metadata(&folder) {
            Ok(found) if found.is_dir() => return Ok(folder),
            Ok(_) => {
                tracing::warn!(taken = %folder.display(), "a link or a file is in the place of a folder; it is not followed");
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return node::private::make_public_folder(&folder).map(|()| folder);
            }
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::other(format!("no name like {name:?} is free in {}", inside.display())))
}

/// Proves that a path is below the folder of images, and no part of it there a link.
///
/// # Errors
/// It leads out of the folder, or a part is a link, and its name.
pub fn without_links(images: &Path, path: &Path) -> io::Result<()> {
    let outside = || io::Error::other(format!("{} is not in {}", path.display(), images.display()));
    let mut place = images.to_owned();
    for part in path.strip_prefix(images).map_err(|_| outside())?.components() {
        if !matches!(part, Component::Normal(_)) {
            return Err(outside());
        }
        place.push(part);
        if fs::symlink_metadata(&place).is_ok_and(|found| found.is_symlink()) {
            return Err(io::Error::other(format!("{} is a link, and links here are not followed", place.display())));
        }
    }
    Ok(())
}

/// Makes a new name in a folder survive a power loss; Windows does so by itself.
pub fn sync_folder(file: &Path) -> io::Result<()> {
    if cfg!(unix) {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

/// Writes a file of the folder of images whole or not at all, and makes the folders that it needs.
///
/// # Errors
/// The file system refuses, or the disk is away: what is written into its place would lie under it later.
pub fn put(images: &Path, file: &Path, bytes: &[u8]) -> io::Result<()> {
    all_here(images, None).map_err(io::Error::other)?;
    without_links(images, file)?;
    let mut folders: Vec<&Path> = file.ancestors().skip(1).take_while(|folder| *folder != images).collect();
    folders.reverse();
    for folder in folders {
        node::private::make_public_folder(folder)?;
    }
    let mut part = file.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    if is_taken(&part) {
        fs::remove_file(&part)?;
    }
    let mut written = File::create_new(&part)?;
    written.write_all(bytes)?;
    node::private::make_public_file(&part)?;
    written.sync_all()?;
    fs::rename(&part, file)?;
    sync_folder(file)
}

/// Renames a file, and replaces none.
///
/// # Errors
/// The name is taken, or the file system refuses.
pub fn rename_to_free(part: &Path, target: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, part, CWD, target, RenameFlags::NOREPLACE) {
            // Not every network file system knows this flag.
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            done => return done.map_err(io::Error::from),
        }
    }
    match fs::hard_link(part, target) {
        Ok(()) => fs::remove_file(part),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        // Without links there is an instant in which somebody else could take the name.
        Err(_) if fs::symlink_metadata(target).is_err() => fs::rename(part, target),
        Err(error) => Err(error),
    }
}

/// Is there anything of this name, a link that leads nowhere included?
pub fn is_taken(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok()
}

/// A path relative to the folder of images as text that leads back to it and stands in one line of a list; absent for a name
/// that is no such text.
pub fn exact_text(images: &Path, path: &Path) -> Option<String> {
    let text = relative_text(images, path);
    (images.join(&text) == path && !text.chars().any(char::is_control)).then_some(text)
}

/// A path relative to the folder of images, with `/` on every system.
pub fn relative_text(images: &Path, path: &Path) -> String {
    let relative = path.strip_prefix(images).unwrap_or(path);
    relative.iter().map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests;
