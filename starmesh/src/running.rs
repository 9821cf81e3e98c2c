//! What of Starmesh runs on this machine for this account: each `starmesh demo` and `starmesh up` writes a small file, so
//! that `status`, `order` and `tail` meet it without `--connect`.
//!
//! The files are in a folder that only this account may read and write: in a folder of others anybody could lead an
//! order to a bus of theirs.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use contract::Address;
use serde::{Deserialize, Serialize};

use crate::process::Process;

/// One program that runs, and the way to its bus.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Running {
    /// `demo` or `up`.
    pub command: String,
    /// Its telescope.
    pub telescope: Address,
    /// The address on its bus that this machine reaches.
    pub bus: String,
    /// Where its configuration is.
    pub folder: PathBuf,
    #[serde(flatten)]
    process: Process,
}

/// The file of this process, which goes with it.
#[derive(Debug)]
pub struct RunningFile(Option<PathBuf>);

impl Drop for RunningFile {
    fn drop(&mut self) {
        // One that cannot be removed names a process that is not there.
        let _ = self.0.as_ref().map(std::fs::remove_file);
    }
}

/// Writes the file of this process; one that cannot be written is complained about, and nothing else fails.
pub fn announce(command: &str, telescope: &Address, bus: &str, folder: &Path) -> RunningFile {
    let written = place().context("no folder for it").and_then(|place| write(&place, command, telescope, bus, folder));
    match written {
        Ok(path) => RunningFile(Some(path)),
        Err(error) => {
            node::lines::complain(format_args!(
                "starmesh: {error:#}; commands such as `starmesh status` need --connect {bus}"
            ));
            RunningFile(None)
        }
    }
}

/// What runs now; files of programs that have ended are removed.
pub fn all() -> Vec<Running> {
    place().map(|place| read(&place)).unwrap_or_default()
}

/// The folder of the files.
pub fn place() -> Option<PathBuf> {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|folder| folder.is_dir());
    place_in(runtime, std::env::temp_dir())
}

#[cfg(unix)]
fn place_in(runtime: Option<PathBuf>, temporary: PathBuf) -> Option<PathBuf> {
    let user = rustix::process::getuid().as_raw();
    let of_system = PathBuf::from(format!("/run/user/{user}"));
    let runtime = runtime.or_else(|| Some(of_system).filter(|folder| is_private(folder)));
    Some(runtime.map_or_else(|| temporary.join(format!("starmesh-{user}")), |runtime| runtime.join("starmesh")))
}

/// A temporary folder is that of the account where a system has no numbers of users.
#[cfg(not(unix))]
fn place_in(runtime: Option<PathBuf>, temporary: PathBuf) -> Option<PathBuf> {
    Some(runtime.unwrap_or(temporary).join("starmesh"))
}

/// Does the folder belong to this account, and may nobody else read or write it?
#[cfg(unix)]
fn is_private(folder: &Path) -> bool {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
    let own = rustix::process::getuid().as_raw();
    std::fs::symlink_metadata(folder)
        .is_ok_and(|about| about.is_dir() && about.uid() == own && about.permissions().mode() & 0o077 == 0)
}

#[cfg(not(unix))]
fn is_private(folder: &Path) -> bool {
    folder.is_dir()
}

fn write(place: &Path, command: &str, telescope: &Address, bus: &str, folder: &Path) -> anyhow::Result<PathBuf> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(place).with_context(|| format!("cannot make the folder {}", place.display()))?;
    anyhow::ensure!(
        is_private(place),
        "{} is not a folder of this account alone (mode 0700); remove it or correct its owner and mode",
        place.display()
    );
    let process = Process::of(std::process::id()).context("this process is not in the list of processes")?;
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let running =
        Running { command: command.to_owned(), telescope: telescope.clone(), bus: bus.to_owned(), folder, process };
    let path = place.join(format!("{command}-{}.json", std::process::id()));
    let part = path.with_extension("part");
    std::fs::write(&part, serde_json::to_vec(&running)?)
        .and_then(|()| std::fs::rename(&part, &path))
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn read(place: &Path) -> Vec<Running> {
    if !is_private(place) {
        return Vec::new();
    }
    let entries = std::fs::read_dir(place).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|word| word == "json")).collect();
    files.sort();
    let mut found = Vec::new();
    for path in files {
        let running = std::fs::read(&path).ok().and_then(|text| serde_json::from_slice::<Running>(&text).ok());
        match running {
            Some(running) if running.process.is_alive() => found.push(running),
            // It ended without a chance to remove it, or the file is none of ours.
            Some(_) | None => drop(std::fs::remove_file(&path)),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn callisto() -> Address {
        Address::new("paranal", "callisto").unwrap()
    }

    #[test]
    fn a_program_that_runs_is_found_and_one_that_has_ended_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("starmesh");
        let path = write(&place, "demo", &callisto(), "tcp/127.0.0.1:4711", folder.path()).unwrap();
        let file = RunningFile(Some(path.clone()));
        let found = read(&place);
        assert_eq!((found.len(), found[0].bus.as_str()), (1, "tcp/127.0.0.1:4711"), "{found:?}");
        assert_eq!((&found[0].telescope, found[0].command.as_str()), (&callisto(), "demo"));
        // The number of its process is another one's now; another file is half written.
        let text = std::fs::read_to_string(&path).unwrap();
        let mut stale: serde_json::Value = serde_json::from_str(&text).unwrap();
        stale["started_s"] = serde_json::json!(7);
        for (name, text) in [("up-1.json", stale.to_string()), ("up-2.json", text[..20].to_owned())] {
            std::fs::write(place.join(name), text).unwrap();
        }
        assert_eq!(read(&place), found);
        assert!(!place.join("up-1.json").exists() && !place.join("up-2.json").exists());
        drop(file);
        assert!(read(&place).is_empty() && !path.exists());
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_others_may_write_leads_to_no_bus() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("starmesh");
        write(&place, "up", &callisto(), "tcp/127.0.0.1:4711", folder.path()).unwrap();
        assert!(is_private(&place), "made with mode 0700");
        std::fs::set_permissions(&place, std::fs::Permissions::from_mode(0o777)).unwrap();
        assert!(read(&place).is_empty());
        let refused = write(&place, "up", &callisto(), "tcp/127.0.0.1:4711", folder.path()).unwrap_err().to_string();
        assert!(refused.contains("0700"), "{refused}");
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link).unwrap();
        assert!(!is_private(&link));
    }

    #[cfg(unix)]
    #[test]
    fn the_folder_is_in_the_runtime_directory_or_is_named_after_the_account() {
        let [runtime, temporary] = ["/nonexistent/run", "/nonexistent/tmp"].map(PathBuf::from);
        assert_eq!(place_in(Some(runtime.clone()), temporary.clone()), Some(runtime.join("starmesh")));
        let place = place_in(None, temporary.clone()).unwrap();
        let user = rustix::process::getuid().as_raw();
        assert!(place.starts_with("/run/user") || place == temporary.join(format!("starmesh-{user}")), "{place:?}");
    }
}
