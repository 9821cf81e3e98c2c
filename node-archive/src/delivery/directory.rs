//! A destination that is a folder, also of a mounted share.
//!
//! The folder is never made, and is the same one from the first look of a try to its last: a share that is taken away in
//! the middle is noticed, and not filled in its absence. Links below it are not followed.

use std::fs::{self, File};
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, OnceLock};

use anyhow::{Context as _, bail, ensure};

use super::hash::hash_from_disk;
use super::item::{Item, MOST_BYTES, too_large};
use super::manifest::Held;
use crate::folder::{rename_to_free, without_links};

/// Where files are while they are written, inside the telescope's folder of the destination.
pub const PART_FOLDER: &str = ".starmesh-part";

/// Device and number of a file or folder: two names of one thing have the same.
type Identity = (u64, u64);

/// The folder of a destination.
#[derive(Debug, Clone)]
pub struct Directory {
    root: PathBuf,
    mounted_apart_from: Option<PathBuf>,
    seen: Arc<OnceLock<Identity>>,
}

impl Directory {
    /// A folder; where a second one is given, it must be on another file system than `/` and that one.
    pub fn new(root: PathBuf, mounted_apart_from: Option<PathBuf>) -> Self {
        Self { root, mounted_apart_from, seen: Arc::default() }
    }

    /// Proves that the folder is there, and that it is the one of the first look. Blocks, as all of this.
    pub fn check(&self) -> anyhow::Result<()> {
        let folder = self.root.display();
        let found = fs::metadata(&self.root).with_context(|| {
            format!("the folder {folder} cannot be used: make it, or mount the share that it is on")
        })?;
        ensure!(found.is_dir(), "{folder} is no folder: name a folder in `directory`");
        for other in self.mounted_apart_from.iter().flat_map(|images| [Path::new("/"), images]) {
            if on_one_file_system(&self.root, other)? {
                bail!(
                    "the share of {folder} is not mounted: it is on one file system with {}, and must_be_mounted is set. \
                     Mount it",
                    other.display()
                );
            }
        }
        let now = identity(&found);
        ensure!(
            *self.seen.get_or_init(|| now) == now,
            "{folder} is another folder than when this try began: its share or disk was taken away. Mount it again; what \
             lacks is sent then"
        );
        Ok(())
    }

    /// Is it on one file system with this path?
    pub fn is_on_disk_of(&self, other: &Path) -> anyhow::Result<bool> {
        on_one_file_system(&self.root, other)
    }

    fn place(&self, name: &str) -> anyhow::Result<PathBuf> {
        let path = self.root.join(name);
        let is_below = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
        ensure!(is_below, "{name} leads out of {}", self.root.display());
        without_links(&self.root, &path)?;
        Ok(path)
    }

    /// Reads a file that may be there.
    pub fn held(&self, name: &str) -> anyhow::Result<Option<Held>> {
        self.check()?;
        let path = self.place(name)?;
        match fs::symlink_metadata(&path) {
            Ok(found) if found.is_file() => {}
            // Something else has the name: it is in the way of this file alone.
            Ok(_) => return Ok(Some(Held::foreign())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return self.check().map(|()| None);
            }
            Err(error) => return Err(error).with_context(|| format!("cannot look at {}", path.display())),
        }
        let held = hash_from_disk(&path).with_context(|| format!("cannot read {} back", path.display()))?;
        self.check()?;
        Ok(Some(held))
    }

    /// Is a file of this size there? It is not read.
    pub fn has(&self, name: &str, bytes: u64) -> anyhow::Result<bool> {
        self.check()?;
        let found = fs::symlink_metadata(self.place(name)?);
        Ok(found.is_ok_and(|found| found.is_file() && found.len() == bytes))
    }

    /// The content of a small file that may be there.
    pub fn read(&self, name: &str) -> anyhow::Result<Option<Vec<u8>>> {
        self.check()?;
        let path = self.place(name)?;
        let is_large = fs::metadata(&path).is_ok_and(|found| found.len() > MOST_BYTES);
        ensure!(!is_large, "{}", too_large(name));
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
        }
    }

    /// Copies a file under another name, reads it back, and gives it its name where what was read is what was sent and
    /// nothing has the name. Returns what was read.
    pub fn send(&self, item: &Item) -> anyhow::Result<Held> {
        self.check()?;
        let target = self.place(&item.name)?;
        // Each telescope has its own: two of them may deliver to one folder at a time.
        let telescope: PathBuf = Path::new(&item.name).components().take(2).collect();
        let parts = telescope.join(PART_FOLDER);
        let part = self.root.join(&parts).join(item.name.replace('/', "_"));
        let written = self.write(item, &parts, &part);
        let written = written.inspect_err(|_| drop(fs::remove_file(&part)));
        let ours = written.with_context(|| self.cannot_write(&item.name))?;
        let held = hash_from_disk(&part).with_context(|| format!("cannot read {} back", part.display()))?;
        if held.sha256 != item.sha256 {
            let _ = fs::remove_file(&part);
            return Ok(held);
        }
        rename_to_free(&part, &target).with_context(|| self.cannot_write(&item.name))?;
        if let Err(error) = self.check() {
            // It was written where the share is not; no other file is removed.
            if fs::symlink_metadata(&target).is_ok_and(|found| identity(&found) == ours) {
                let _ = fs::remove_file(&target);
            }
            return Err(error);
        }
        // Shares often cannot do this; then the rename is as durable as they make it.
        if let Some(folder) = target.parent() {
            let _ = File::open(folder).and_then(|folder| folder.sync_all());
        }
        let _ = fs::remove_dir(self.root.join(&parts));
        Ok(held)
    }

    fn write(&self, item: &Item, parts: &Path, part: &Path) -> io::Result<Identity> {
        self.make_folders(parts)?;
        self.make_folders(Path::new(&item.name).parent().unwrap_or(Path::new("")))?;
        // What an earlier try left may be longer, or a link.
        match fs::remove_file(part) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut from = File::open(&item.file)?;
        let mut to = File::options().write(true).create_new(true).open(part)?;
        io::copy(&mut from, &mut to)?;
        node::private::make_public_file(part)?;
        to.sync_all()?;
        Ok(identity(&to.metadata()?))
    }

    /// Makes folders below the destination's own, as public as the archive's.
    fn make_folders(&self, below: &Path) -> io::Result<()> {
        let mut place = self.root.clone();
        for part in below.components() {
            place.push(part);
            match fs::symlink_metadata(&place) {
                Ok(found) if found.is_dir() => {}
                Ok(_) => return Err(io::Error::other(format!("{} is no folder", place.display()))),
                Err(error) if error.kind() == io::ErrorKind::NotFound => node::private::make_public_folder(&place)?,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn cannot_write(&self, name: &str) -> String {
        format!(
            "cannot write {name} into {}: free its disk, or let this user write there; nothing there was changed",
            self.root.display()
        )
    }
}

fn identity(found: &fs::Metadata) -> Identity {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        (found.dev(), found.ino())
    }
    #[cfg(not(unix))]
    {
        let _ = found;
        (0, 0)
    }
}

/// Are both on one file system? Where the system does not report it: yes.
fn on_one_file_system(one: &Path, other: &Path) -> anyhow::Result<bool> {
    let device = |path: &Path| fs::metadata(path).map(|found| identity(&found).0);
    let look = || format!("cannot look at {} and {}", one.display(), other.display());
    Ok(device(one).with_context(look)? == device(other).with_context(look)?)
}
