//! Where the guard process stores its copy, its countdown and its locks, so that they are found without the
//! configuration.
//!
//! The files are next to the configuration and in the state folder of the service or user; what can be written is
//! written, and of what can be read the newest counts.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use bus::MachineTime;
use interlock::{Before, Deadlines, nanos};
use node::kernel_boot_id;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::copy::{Copy, MOST_BYTES};
use crate::spool::{sync_folder, write_synced};

/// The places of one device node of one configuration file.
#[derive(Debug, Clone)]
pub struct Places {
    /// Paths without their last ending.
    stems: Vec<PathBuf>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Countdown {
    /// The kernel's boot that the times belong to.
    kernel_boot_id: String,
    written_ns: u64,
    open_until_ns: BTreeMap<String, u64>,
}

impl Places {
    /// The places for a configuration file, whether that can be read or not.
    pub fn of(config: &Path, id: &str) -> Self {
        Self { stems: begins(config, state_folder()).into_iter().map(|begin| begin.with(id)).collect() }
    }

    /// The places in one folder, for tests.
    #[cfg(test)]
    pub fn in_folders(folders: &[&Path]) -> Self {
        Self { stems: folders.iter().map(|folder| folder.join("x")).collect() }
    }

    fn paths(&self, ending: &str) -> impl Iterator<Item = PathBuf> {
        self.stems.iter().map(move |stem| {
            let mut path = stem.as_os_str().to_owned();
            path.push(".");
            path.push(ending);
            PathBuf::from(path)
        })
    }

    /// The file by which a node that cannot start prints the reason only once.
    pub fn last_words(&self) -> Option<PathBuf> {
        self.paths("last-words").next()
    }

    /// Removes that file: the reason no longer holds.
    pub fn forget_last_words(&self) {
        if let Some(file) = self.last_words() {
            // Mostly there is none.
            let _ = fs::remove_file(file);
        }
    }

    /// Notes that alerts of the guard process are on the bus: when it has died, the next one takes them back. Blocks.
    pub fn note_alerts(&self) {
        for path in self.paths("alerts") {
            // Where no file can be written, a person acknowledges what is left.
            let _ = write(&path, b"", true);
        }
    }

    /// Are there alerts of a guard process on the bus that has died? Blocks.
    pub fn has_alerts(&self) -> bool {
        self.paths("alerts").any(|path| path.exists())
    }

    /// There are no such alerts any more. Blocks.
    pub fn forget_alerts(&self) {
        for path in self.paths("alerts") {
            // Mostly there is only one.
            let _ = fs::remove_file(path);
        }
    }

    /// The newest whole copy.
    pub fn copy(&self) -> Option<(u64, Copy)> {
        let found = self.paths("guard").filter_map(|path| read(&path)).filter_map(|bytes| Copy::unsealed(&bytes));
        found.max_by_key(|(number, _)| *number)
    }

    /// Writes the copy wherever it can be written; false where it can be written nowhere. Blocks.
    pub fn keep_copy(&self, number: u64, copy: &Copy) -> bool {
        let Some(bytes) = copy.sealed(number) else { return false };
        let written = self.paths("guard").filter(|path| write(path, &bytes, true)).count();
        written > 0
    }

    /// What was left of the countdown.
    pub fn countdown(&self) -> Before {
        let found = self.paths("countdown").filter_map(|path| read(&path));
        let newest = found
            .filter_map(|bytes| serde_json::from_slice::<Countdown>(&bytes).ok())
            .max_by_key(|countdown| (countdown.kernel_boot_id == kernel_boot_id(), countdown.written_ns));
        match newest {
            None => Before::Nothing,
            Some(countdown) if countdown.kernel_boot_id.is_empty() || countdown.kernel_boot_id != kernel_boot_id() => {
                Before::OtherBoot
            }
            Some(countdown) => {
                let at = |ns| MachineTime::from_boot(Duration::from_nanos(ns));
                Before::Deadlines(countdown.open_until_ns.into_iter().map(|(dome, ns)| (dome, at(ns))).collect())
            }
        }
    }

    /// Writes the countdown; false where it can be written nowhere. It needs no fsync, because it is of no use after
    /// the kernel has gone. Blocks.
    pub fn keep_countdown(&self, now: MachineTime, deadlines: &Deadlines) -> bool {
        let open_until_ns = deadlines.iter().map(|(dome, at)| (dome.clone(), nanos(*at))).collect();
        let countdown = Countdown { kernel_boot_id: kernel_boot_id(), written_ns: nanos(now), open_until_ns };
        let Ok(bytes) = serde_json::to_vec(&countdown) else { return false };
        self.paths("countdown").filter(|path| write(path, &bytes, false)).count() > 0
    }

    /// Takes a lock for as long as the file is held. An error where somebody holds it; `None` where no place can be
    /// written, and so nothing can be locked.
    pub fn lock(&self, what: &str) -> Result<Option<File>, Taken> {
        for path in self.paths(what) {
            if let Some(folder) = path.parent() {
                // If it cannot be made, the file below cannot either.
                let _ = fs::create_dir_all(folder);
            }
            let Ok(file) = File::options().create(true).truncate(false).write(true).open(&path) else { continue };
            return match file.try_lock() {
                Ok(()) => Ok(Some(file)),
                Err(fs::TryLockError::WouldBlock) => Err(Taken { path }),
                // A file system without locks.
                Err(fs::TryLockError::Error(_)) => continue,
            };
        }
        Ok(None)
    }
}

/// How the names of the files of all device nodes of a configuration begin in one folder.
struct Begin {
    folder: PathBuf,
    name: String,
}

impl Begin {
    fn with(&self, id: &str) -> PathBuf {
        self.folder.join(format!("{}{id}", self.name))
    }

    /// The copies that are there, of whichever node.
    fn copies(&self) -> io::Result<Vec<PathBuf>> {
        let files = match fs::read_dir(&self.folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            files => files?.map(|file| file.map(|file| file.path())).collect::<io::Result<Vec<_>>>()?,
        };
        let is_copy = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&self.name) && name.ends_with(".guard")
        };
        Ok(files.into_iter().filter(is_copy).collect())
    }
}

/// First next to the configuration, then in the state folder.
fn begins(config: &Path, state: Option<PathBuf>) -> Vec<Begin> {
    let whole = std::path::absolute(config).unwrap_or_else(|_| config.to_owned());
    let folder = whole.parent().map(|folder| folder.canonicalize().unwrap_or_else(|_| folder.to_owned()));
    let folder = folder.unwrap_or_else(|| PathBuf::from("."));
    let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let hash = Sha256::digest(folder.join(&name).to_string_lossy().as_bytes());
    let short: String = hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let beside = Begin { folder, name: format!(".{name}.") };
    [beside].into_iter().chain(state.map(|folder| Begin { folder, name: format!("{short}-") })).collect()
}

/// Removes the copies in the state folder of a site that was deleted with its folder, for whoever makes a site anew at
/// the same path; returns the files that it removed. Where a copy is next to the configuration, the folder was not
/// deleted, and nothing is removed: what was ordered may be lost, and the dome is to stay closed; likewise where the
/// folders cannot be read. Blocks.
pub fn forget_deleted_site(config: &Path) -> Vec<PathBuf> {
    forget_in(&begins(config, state_folder()))
}

fn forget_in(begins: &[Begin]) -> Vec<PathBuf> {
    match begins {
        [beside, state] if beside.copies().is_ok_and(|copies| copies.is_empty()) => {
            let copies = state.copies().unwrap_or_default();
            copies.into_iter().filter(|path| fs::remove_file(path).is_ok()).collect()
        }
        _ => Vec::new(),
    }
}

/// Another process holds a lock.
#[derive(Debug)]
pub struct Taken {
    /// The file.
    pub path: PathBuf,
}

/// systemd's folder for the service, or the user's own.
fn state_folder() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(folders) = set("STATE_DIRECTORY") {
        // Several are separated by colons.
        return std::env::split_paths(&folders).next();
    }
    let base = set("XDG_STATE_HOME").or_else(|| set("LOCALAPPDATA")).map(PathBuf::from);
    let base = base.or_else(|| set("HOME").map(|home| PathBuf::from(home).join(".local").join("state")))?;
    Some(base.join("starmesh"))
}

fn read(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(MOST_BYTES + 1).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 <= MOST_BYTES).then_some(bytes)
}

fn write(path: &Path, bytes: &[u8], synced: bool) -> bool {
    let Some(folder) = path.parent() else { return false };
    let mut part = path.as_os_str().to_owned();
    part.push(format!(".{}.part", std::process::id()));
    let part = PathBuf::from(part);
    let written = fs::create_dir_all(folder)
        .and_then(|()| if synced { write_synced(&part, bytes) } else { fs::write(&part, bytes) })
        .and_then(|()| fs::rename(&part, path));
    if written.is_err() {
        // Half a file on a full disk is in nobody's way but takes room.
        let _ = fs::remove_file(&part);
    } else if synced {
        sync_folder(folder);
    }
    written.is_ok()
}

#[cfg(test)]
mod tests {
    use super::super::copy::tests::copy;
    use super::*;

    #[test]
    fn the_newest_whole_copy_counts_wherever_it_stands() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let both = Places::in_folders(&[one.path(), other.path()]);
        assert!(both.copy().is_none());
        assert!(both.keep_copy(1, &copy()));
        let newer = Copy { multicast: false, ..copy() };
        assert!(Places::in_folders(&[other.path()]).keep_copy(2, &newer));
        assert_eq!(both.copy(), Some((2, newer)));
        // Half a write of the newest leaves the other.
        let file = other.path().join("x.guard");
        let whole = fs::read(&file).unwrap();
        fs::write(&file, &whole[..whole.len() / 2]).unwrap();
        assert_eq!(both.copy(), Some((1, copy())));
    }

    #[test]
    fn a_site_made_anew_forgets_the_one_that_was_deleted_with_its_folder_and_no_other() {
        let home = tempfile::tempdir().unwrap();
        let state = home.path().join("state");
        let (config, other) = (home.path().join("site/observatory.toml"), home.path().join("other/observatory.toml"));
        let begins = |config: &Path| begins(config, Some(state.clone()));
        let places = |config: &Path, id: &str| Places { stems: begins(config).iter().map(|b| b.with(id)).collect() };
        let remembers = |config: &Path, id: &str| places(config, id).copy().is_some();
        for path in [&config, &other] {
            fs::create_dir(path.parent().unwrap()).unwrap();
            assert!(places(path, "enclosure").keep_copy(1, &copy()) && places(path, "pc").keep_copy(1, &copy()));
        }
        // It lost all that a person sees in its folder, perhaps with an order that it stays closed.
        assert_eq!(forget_in(&begins(&config)), Vec::<PathBuf>::new());
        assert!(remembers(&config, "enclosure") && remembers(&config, "pc"));
        fs::remove_dir_all(config.parent().unwrap()).unwrap();
        fs::create_dir(config.parent().unwrap()).unwrap();
        assert!(remembers(&config, "enclosure"), "from the state folder");
        assert_eq!(forget_in(&begins(&config)).len(), 2);
        assert!(!remembers(&config, "enclosure") && !remembers(&config, "pc"));
        assert!(remembers(&other, "enclosure"));
    }

    #[test]
    fn a_place_that_cannot_be_written_leaves_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let in_the_way = folder.path().join("file");
        fs::write(&in_the_way, "").unwrap();
        let places = Places::in_folders(&[&in_the_way, folder.path()]);
        assert!(places.keep_copy(1, &copy()));
        assert_eq!(places.copy().unwrap().1, copy());
        assert!(!Places::in_folders(&[&in_the_way]).keep_copy(1, &copy()));
    }

    #[test]
    fn the_countdown_is_that_of_this_start_of_the_kernel() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places::in_folders(&[folder.path()]);
        assert_eq!(places.countdown(), Before::Nothing);
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let deadlines = Deadlines::from([("d".to_owned(), at(77))]);
        assert!(places.keep_countdown(at(70), &deadlines));
        if !kernel_boot_id().is_empty() {
            assert_eq!(places.countdown(), Before::Deadlines(deadlines));
        }
        let other = "{\"kernel_boot_id\":\"another\",\"written_ns\":1,\"open_until_ns\":{\"d\":99}}";
        fs::write(folder.path().join("x.countdown"), other).unwrap();
        assert_eq!(places.countdown(), Before::OtherBoot);
    }

    #[test]
    fn that_there_are_alerts_is_known_to_the_next_guard_process_wherever_it_can_be_noted() {
        let folder = tempfile::tempdir().unwrap();
        let in_the_way = folder.path().join("file");
        fs::write(&in_the_way, "").unwrap();
        let places = Places::in_folders(&[&in_the_way, folder.path()]);
        assert!(!places.has_alerts());
        places.note_alerts();
        assert!(places.clone().has_alerts());
        places.forget_alerts();
        assert!(!places.has_alerts());
    }

    #[test]
    fn a_lock_is_held_by_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places::in_folders(&[folder.path()]);
        let held = places.lock("lock").unwrap();
        assert!(held.is_some());
        assert!(places.lock("lock").is_err());
        // A child that another test starts meanwhile has the file open, too.
        held.unwrap().unlock().unwrap();
        assert!(places.lock("lock").unwrap().is_some());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_leaves_the_copy_and_the_countdown_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places::in_folders(&[folder.path()]);
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let deadlines = |s| Deadlines::from([("d".to_owned(), at(s))]);
        assert!(places.keep_copy(1, &copy()) && places.keep_countdown(at(70), &deadlines(77)));
        let before = places.countdown();
        let full = |ending: &str| folder.path().join(format!("x.{ending}.{}.part", std::process::id()));
        for ending in ["guard", "countdown"] {
            std::os::unix::fs::symlink("/dev/full", full(ending)).unwrap();
        }
        assert!(!places.keep_copy(2, &Copy { multicast: false, ..copy() }));
        assert!(!places.keep_countdown(at(71), &deadlines(99)));
        assert_eq!((places.copy(), places.countdown()), (Some((1, copy())), before));
        assert!(!full("guard").is_symlink() && !full("countdown").is_symlink(), "half a file takes no room");
    }

    #[test]
    fn of_two_countdowns_the_newest_whole_one_of_this_start_of_the_kernel_counts() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let places = Places::in_folders(&[one.path(), other.path()]);
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let deadlines = |s| Deadlines::from([("d".to_owned(), at(s))]);
        let write =
            |folder: &tempfile::TempDir, text: &str| fs::write(folder.path().join("x.countdown"), text).unwrap();
        assert!(places.keep_countdown(at(70), &deadlines(77)));
        assert!(Places::in_folders(&[other.path()]).keep_countdown(at(80), &deadlines(87)));
        if kernel_boot_id().is_empty() {
            return; // a system without such an id: each countdown counts as one of another start
        }
        assert_eq!(places.countdown(), Before::Deadlines(deadlines(87)));
        for spoilt in [
            "",
            "{\"kernel_boot_id\":",
            "{\"kernel_boot_id\":\"another\",\"written_ns\":99000000000000,\"open_until_ns\":{\"d\":99}}",
            "{\"kernel_boot_id\":\"x\",\"written_ns\":-1,\"open_until_ns\":{}}",
        ] {
            write(&other, spoilt);
            assert_eq!(places.countdown(), Before::Deadlines(deadlines(77)), "{spoilt}");
        }
        write(&one, "");
        write(&other, "");
        assert_eq!(places.countdown(), Before::Nothing);
    }

    #[test]
    fn a_copy_that_could_close_no_dome_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places::in_folders(&[folder.path()]);
        let changed = |change: fn(&mut super::super::copy::DomeCopy)| {
            let mut changed = copy();
            change(&mut changed.domes[0]);
            changed
        };
        for (number, spoilt) in [
            changed(|dome| dome.target.server.clear()),
            changed(|dome| dome.permit_valid_s = -1.0),
            changed(|dome| dome.travel_timeout_s = f64::INFINITY),
            changed(|dome| dome.parked_within_s = f64::NAN),
            Copy { domes: Vec::new(), ..copy() },
            Copy { leaving: changed(|dome| dome.target.server.clear()).domes, ..copy() },
        ]
        .into_iter()
        .enumerate()
        {
            assert!(places.keep_copy(number as u64, &spoilt));
            assert_eq!(places.copy(), None, "{spoilt:?}");
        }
        fs::write(folder.path().join("x.guard"), vec![b' '; MOST_BYTES as usize + 1]).unwrap();
        assert_eq!(places.copy(), None, "larger than any copy");
    }

    #[test]
    fn a_lock_is_taken_in_the_first_place_that_can_be_written() {
        let folder = tempfile::tempdir().unwrap();
        let in_the_way = folder.path().join("file");
        fs::write(&in_the_way, "").unwrap();
        let below = folder.path().join("new").join("state");
        let places = Places::in_folders(&[&in_the_way, &below]);
        let held = places.lock("lock").unwrap();
        assert!(held.is_some());
        assert_eq!(places.lock("lock").unwrap_err().path, below.join("x.lock"));
        assert!(places.lock("other").unwrap().is_some(), "another lock is free");
        assert!(Places::in_folders(&[&in_the_way]).lock("lock").unwrap().is_none());
    }
}
