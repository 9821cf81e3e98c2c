//! What of Starmesh runs on this machine for this account: each `starmesh demo` and `starmesh up` writes a small file, so
//! that `status`, `order` and `tail` meet it without `--connect`. The file of an `up` that was killed counts as long as a
//! node of it runs: one of them has its address then (`bus_address`).
//!
//! The files are in a folder that only this account may read and write: in a folder of others anybody could lead an
//! order to a bus of theirs.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use contract::Address;
use serde::{Deserialize, Serialize};

use crate::left;
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
    /// The file of its nodes, which may outlive it (`left.rs`).
    pub nodes: Option<PathBuf>,
    #[serde(flatten)]
    process: Process,
}

impl Running {
    /// The nodes that it left, where it was killed.
    fn left(&self) -> Vec<left::Started> {
        match &self.nodes {
            Some(file) if !self.process.is_alive() => left::alive(file),
            Some(_) | None => Vec::new(),
        }
    }
}

impl fmt::Display for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`starmesh {}` of {} in {}", self.command, self.telescope, self.folder.display())?;
        match self.left().as_slice() {
            [] => Ok(()),
            left => write!(f, " (which has ended and left {}: start it again)", left::names(left)),
        }
    }
}

/// The file of this process, which goes with it and with the nodes that it leaves.
#[derive(Debug)]
pub struct RunningFile {
    path: PathBuf,
    nodes: Option<PathBuf>,
}

impl Drop for RunningFile {
    fn drop(&mut self) {
        if self.nodes.as_deref().is_none_or(|nodes| left::alive(nodes).is_empty()) {
            // One that cannot be removed names a process that is not there.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Writes the file of this process, which may leave the nodes of a file; one that cannot be written is complained about,
/// and nothing else fails.
pub fn announce(
    command: &str,
    telescope: &Address,
    bus: &str,
    folder: &Path,
    nodes: Option<&Path>,
) -> Option<RunningFile> {
    let place = place().context("no folder for it");
    let written = place.and_then(|place| write(&place, command, telescope, bus, folder, nodes));
    let complain = |error: &anyhow::Error| {
        node::lines::complain(format_args!(
            "starmesh: {error:#}; commands such as `starmesh status` need --connect {bus}"
        ));
    };
    written.inspect_err(complain).ok()
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

fn write(
    place: &Path,
    command: &str,
    telescope: &Address,
    bus: &str,
    folder: &Path,
    nodes: Option<&Path>,
) -> anyhow::Result<RunningFile> {
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
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (folder, nodes) = (absolute(folder), nodes.map(absolute));
    for (file, earlier) in files(place) {
        if earlier.nodes.is_some() && earlier.nodes == nodes {
            // It was killed, and its nodes are this process's.
            let _ = std::fs::remove_file(file);
        }
    }
    let running = Running {
        command: command.to_owned(),
        telescope: telescope.clone(),
        bus: bus.to_owned(),
        folder,
        nodes: nodes.clone(),
        process,
    };
    let path = place.join(format!("{command}-{}.json", std::process::id()));
    let part = path.with_extension("part");
    std::fs::write(&part, serde_json::to_vec(&running)?)
        .and_then(|()| std::fs::rename(&part, &path))
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(RunningFile { path, nodes })
}

fn read(place: &Path) -> Vec<Running> {
    files(place).into_iter().map(|(_, running)| running).collect()
}

fn files(place: &Path) -> Vec<(PathBuf, Running)> {
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
            Some(running) if running.process.is_alive() || !running.left().is_empty() => found.push((path, running)),
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
        let file = write(&place, "demo", &callisto(), "tcp/127.0.0.1:4711", folder.path(), None).unwrap();
        let path = file.path.clone();
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

    #[test]
    fn an_up_that_was_killed_is_found_as_long_as_a_node_of_it_runs_and_no_longer_than_until_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let (place, nodes) = (folder.path().join("starmesh"), folder.path().join(".observatory.toml.up"));
        let up = |bus| write(&place, "up", &callisto(), bus, folder.path(), Some(&nodes)).unwrap();
        let own = serde_json::to_value(Process::of(std::process::id()).unwrap()).unwrap();
        let with_nodes = |started_s: &serde_json::Value| {
            let mut node = serde_json::json!({ "role": "device", "id": "enclosure", "started_s": started_s });
            node["pid"] = own["pid"].clone();
            std::fs::write(&nodes, serde_json::json!({ "up": null, "nodes": [node] }).to_string()).unwrap();
        };
        with_nodes(&own["started_s"]);
        let killed = up("tcp/127.0.0.1:4711");
        let mut stale: serde_json::Value = serde_json::from_slice(&std::fs::read(&killed.path).unwrap()).unwrap();
        stale["started_s"] = serde_json::json!(7);
        let of_killed = place.join("up-1.json");
        std::fs::write(&of_killed, stale.to_string()).unwrap();
        std::fs::remove_file(&killed.path).unwrap();
        let found = read(&place);
        assert_eq!((found.len(), found[0].bus.as_str()), (1, "tcp/127.0.0.1:4711"), "{found:?}");
        let (words, left) = (found[0].to_string(), format!("left the device node enclosure as process {}", own["pid"]));
        assert!(words.contains(&left), "{words}");

        let next = up("tcp/127.0.0.1:4712");
        let found = read(&place);
        assert_eq!((found.len(), found[0].bus.as_str()), (1, "tcp/127.0.0.1:4712"), "{found:?}");
        // One that leaves nodes at its end leaves its file for them.
        let path = next.path.clone();
        drop(next);
        assert!(path.exists());
        std::fs::write(&of_killed, stale.to_string()).unwrap();
        with_nodes(&serde_json::json!(7));
        assert_eq!(read(&place).len(), 1, "of this process");
        assert!(!of_killed.exists(), "no node runs any more");
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_others_may_write_leads_to_no_bus() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("starmesh");
        let _file = write(&place, "up", &callisto(), "tcp/127.0.0.1:4711", folder.path(), None).unwrap();
        assert!(is_private(&place), "made with mode 0700");
        std::fs::set_permissions(&place, std::fs::Permissions::from_mode(0o777)).unwrap();
        assert!(read(&place).is_empty());
        let refused = write(&place, "up", &callisto(), "tcp/127.0.0.1:4711", folder.path(), None);
        let refused = refused.unwrap_err().to_string();
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
