//! The processes that `starmesh up` started, in a file next to the configuration, so that the next `starmesh up` and other
//! commands know which of them still run.
//!
//! Next to it is an empty file that the running `starmesh up` has locked. It stays where it is: the system releases the
//! lock with the process, however that ends, and of two that start at once one has it.

use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use contract::Role;
use node::FileLock;
use serde::{Deserialize, Serialize};

use crate::process::Process;

/// A device node without an enclosure ends within this time.
const END: Duration = Duration::from_secs(15);
/// An `up` that has the lock is named in the file within this time.
const NAMED: Duration = Duration::from_secs(5);

/// A node that was started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Started {
    role: Role,
    id: String,
    #[serde(flatten)]
    process: Process,
}

impl fmt::Display for Started {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the {} node {} as process {}", self.role, self.id, self.process.pid)
    }
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Processes {
    up: Option<Process>,
    nodes: Vec<Started>,
}

/// The file of one configuration.
#[derive(Debug)]
pub struct Left {
    path: PathBuf,
    processes: std::sync::Mutex<Processes>,
    /// Locked as long as this process runs; nothing where the file system has no locks.
    _lock: Option<FileLock>,
}

/// The file of a configuration: one, by whichever link that is named.
pub fn path(config: &Path) -> PathBuf {
    let config = config.canonicalize().unwrap_or_else(|_| config.to_path_buf());
    config.with_file_name(format!(".{}.up", config.file_name().unwrap_or_default().to_string_lossy()))
}

/// The nodes of a file that still run.
pub fn alive(path: &Path) -> Vec<Started> {
    read(path).nodes.into_iter().filter(|node| node.process.is_alive()).collect()
}

/// For people.
pub fn names(nodes: &[Started]) -> String {
    let names: Vec<String> = nodes.iter().map(ToString::to_string).collect();
    if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
}

/// Another process has the lock.
struct AlreadyLocked;

/// Locks the file that says that an `up` runs; `None` where that cannot be done, which is complained about: a dome is not
/// left without its nodes for that.
fn lock(path: &Path) -> Result<Option<FileLock>, AlreadyLocked> {
    let at = path.with_extension("up-lock");
    let opened = OpenOptions::new().write(true).create(true).truncate(false).open(&at);
    let locked = or_read_only(opened, &at).map_err(TryLockError::Error).and_then(FileLock::of);
    match locked {
        Ok(lock) => Ok(Some(lock)),
        Err(TryLockError::WouldBlock) => Err(AlreadyLocked),
        Err(TryLockError::Error(error)) => {
            node::lines::complain(format_args!(
                "starmesh: cannot lock {} ({error}), so that two `starmesh up` of this file could run at once; let this \
                 account write to that folder, and read that file",
                at.display()
            ));
            Ok(None)
        }
    }
}

/// A file of another account, such as root's after `sudo starmesh up`, can be locked by whoever may read it.
fn or_read_only(opened: std::io::Result<File>, at: &Path) -> std::io::Result<File> {
    opened.or_else(|error| match File::open(at) {
        Ok(file) if error.kind() == ErrorKind::PermissionDenied => Ok(file),
        _ => Err(error),
    })
}

fn alive_up(path: &Path) -> Option<Process> {
    read(path).up.filter(|up| up.is_alive())
}

/// The `up` that has the lock; it may be about to write its name.
async fn named(path: &Path) -> Option<Process> {
    let naming = async {
        loop {
            if let Some(up) = alive_up(path) {
                return up;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(NAMED, naming).await.ok()
}

fn runs_already(up: Option<Process>) -> String {
    let (who, ends) = match up {
        Some(up) => (format!(", as process {} since {}", up.pid, up.since()), format!(", or type kill {}", up.pid)),
        None => (String::new(), String::new()),
    };
    format!(
        "another `starmesh up` runs this file already{who}; one is enough. To end that one press Ctrl-C in its \
         terminal{ends}: it closes the enclosure first, which takes some seconds"
    )
}

/// A file that is not there or not whole names no process.
fn read(path: &Path) -> Processes {
    std::fs::read(path).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
}

impl Left {
    /// Finds the processes that an earlier `up` left, asks them to end, and names them. An error where an earlier `up`
    /// still runs, or where they cannot be asked.
    pub async fn find(config: &Path) -> anyhow::Result<Self> {
        let path = path(config);
        let lock = match lock(&path) {
            Ok(lock) => lock,
            Err(AlreadyLocked) => bail!(runs_already(named(&path).await)),
        };
        // One without a lock: of an older version, or where there are none.
        if let Some(up) = alive_up(&path) {
            bail!(runs_already(Some(up)));
        }
        let nodes = alive(&path);
        let processes = Processes { up: None, nodes: nodes.clone() };
        let left = Self { path, processes: std::sync::Mutex::new(processes), _lock: lock };
        // Before they are waited for: a second `up` finds this one.
        left.change(|processes| processes.up = Process::of(std::process::id()));
        for node in &nodes {
            node::lines::print_line(format_args!("an earlier `starmesh up` left {node}: it is asked to end"));
            let Started { role, id, process } = node;
            let pid = process.pid;
            if let Err(error) = ask_to_end(pid) {
                bail!(refused(&error, &alive(&left.path)));
            }
            let began = Instant::now();
            while process.is_alive() && began.elapsed() < END {
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
            if process.is_alive() {
                node::lines::print_line(format_args!(
                    "process {pid} still closes its enclosure; the new {role} node {id} waits for it and then takes over \
                     (kill -9 {pid} ends it at once, and nobody closes meanwhile)"
                ));
            }
        }
        Ok(left)
    }

    /// A node was started.
    pub fn started(&self, role: Role, id: &str, pid: u32) {
        let Some(process) = Process::of(pid) else { return };
        self.change(|processes| {
            processes.nodes.retain(|node| (node.role, node.id.as_str()) != (role, id));
            processes.nodes.push(Started { role, id: id.to_owned(), process });
        });
    }

    /// The processes that were started and still run.
    pub fn names(&self) -> String {
        let processes = self.processes.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        names(&processes.nodes.iter().filter(|node| node.process.is_alive()).cloned().collect::<Vec<_>>())
    }

    /// Everything has ended as requested.
    pub fn nothing(&self) {
        // A file that cannot be removed names processes that are not there.
        let _ = std::fs::remove_file(&self.path);
    }

    fn change(&self, change: impl FnOnce(&mut Processes)) {
        let mut processes = self.processes.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        change(&mut processes);
        if let Err(error) = write(&self.path, &processes) {
            node::lines::complain(format_args!(
                "starmesh: {error:#}; a later `starmesh up` will not know what this one left. Let this account write to that \
                 folder, or free some room"
            ));
        }
    }
}

fn write(path: &Path, processes: &Processes) -> anyhow::Result<()> {
    let part = path.with_extension("up-part");
    std::fs::write(&part, serde_json::to_vec(processes)?)
        .and_then(|()| std::fs::rename(&part, path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Why nodes of an earlier `up` cannot be followed, and what to do.
fn refused(error: &std::io::Error, nodes: &[Started]) -> String {
    let pids: Vec<String> = nodes.iter().map(|node| node.process.pid.to_string()).collect();
    format!(
        "nodes of an earlier `starmesh up` run on and cannot be asked to end ({error}): {}. They guard the dome. They may be of \
         another account: start `starmesh up` from that one, or end them (sudo kill {}; each closes its dome first), and start \
         again",
        names(nodes),
        pids.join(" ")
    )
}

#[cfg(unix)]
fn ask_to_end(pid: u32) -> std::io::Result<()> {
    use rustix::io::Errno;
    let Some(pid) = i32::try_from(pid).ok().and_then(rustix::process::Pid::from_raw) else { return Ok(()) };
    match rustix::process::kill_process(pid, rustix::process::Signal::TERM) {
        // It has ended just now.
        Ok(()) | Err(Errno::SRCH) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

#[cfg(not(unix))]
fn ask_to_end(pid: u32) -> std::io::Result<()> {
    node::lines::print_line(format_args!("end process {pid} by hand: this system has no signal for it"));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_living_up_is_named_and_a_dead_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("observatory.toml");
        let left = Left::find(&config).await.unwrap();
        let refused = Left::find(&config).await.unwrap_err().to_string();
        let own = Process::of(std::process::id()).unwrap();
        assert!(refused.contains(&format!("as process {} since {}", own.pid, own.since())), "{refused}");
        assert!(refused.contains(&format!("type kill {}", own.pid)), "{refused}");
        left.nothing();
        drop(left);
        assert!(Left::find(&config).await.is_ok());
    }

    #[tokio::test]
    async fn of_two_that_start_at_once_one_is_refused_also_before_the_other_one_has_written_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let (config, other) = (folder.path().join("observatory.toml"), folder.path().join("europa.toml"));
        let own = Process::of(std::process::id()).unwrap();
        // It has the lock, and nothing names it yet.
        let Ok(Some(first)) = lock(&path(&config)) else { panic!("no lock in a temporary folder") };
        let naming = async { write(&path(&config), &Processes { up: Some(own), nodes: Vec::new() }) };
        let (refused, named) = tokio::join!(Left::find(&config), naming);
        named.unwrap();
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains(&format!("as process {} since {}", own.pid, own.since())), "{refused}");
        assert!(Left::find(&other).await.is_ok(), "a file of its own in the same folder");
        // It was killed: the system releases its lock, and its files stay.
        drop(first);
        std::fs::write(path(&config), r#"{"up":{"pid":1,"started_s":7},"nodes":[]}"#).unwrap();
        assert!(Left::find(&config).await.is_ok());
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn a_file_that_is_named_by_a_link_has_the_same_lock() {
        let folder = tempfile::tempdir().unwrap();
        let (config, link) = (folder.path().join("observatory.toml"), folder.path().join("callisto.toml"));
        std::fs::write(&config, "").unwrap();
        std::os::unix::fs::symlink(&config, &link).unwrap();
        let _left = Left::find(&config).await.unwrap();
        let refused = Left::find(&link).await.unwrap_err().to_string();
        assert!(refused.contains("another `starmesh up` runs this file already"), "{refused}");
    }

    #[test]
    fn a_lock_file_of_another_account_is_locked_by_reading_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = path(&folder.path().join("observatory.toml"));
        drop(lock(&path));
        // As the system refuses it; an administrator, who may run this test, is refused nothing.
        let refused = Err(ErrorKind::PermissionDenied.into());
        let file = or_read_only(refused, &path.with_extension("up-lock")).unwrap();
        file.try_lock().unwrap();
        assert!(lock(&path).is_err(), "another one has it");
        let refused = or_read_only(Err(ErrorKind::PermissionDenied.into()), &folder.path().join("none.up-lock"));
        assert_eq!(refused.unwrap_err().kind(), ErrorKind::PermissionDenied, "not that there is no file to read");
        let full = or_read_only(Err(ErrorKind::StorageFull.into()), &path.with_extension("up-lock"));
        assert_eq!(full.unwrap_err().kind(), ErrorKind::StorageFull);
    }

    #[tokio::test]
    async fn a_number_that_another_process_has_now_is_nobody_and_half_a_file_names_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("observatory.toml");
        let other = r#"{"up":{"pid":1,"started_s":7},"nodes":[{"role":"device","id":"main","pid":1,"started_s":7}]}"#;
        std::fs::write(folder.path().join(".observatory.toml.up"), other).unwrap();
        Left::find(&config).await.unwrap().nothing();
        std::fs::write(folder.path().join(".observatory.toml.up"), &other[..40]).unwrap();
        assert!(Left::find(&config).await.is_ok());
    }

    /// A device node that an `up` left which has died.
    #[cfg(unix)]
    async fn left_by_the_dead(config: &Path, command: &str) -> tokio::process::Child {
        use tokio::io::AsyncReadExt as _;
        let left = Left::find(config).await.unwrap();
        let mut shell = tokio::process::Command::new("sh");
        let shell = shell.args(["-c", &format!("{command} echo; exec sleep 300")]).kill_on_drop(true);
        let mut node = shell.stdout(std::process::Stdio::piped()).spawn().unwrap();
        // It runs as it is to.
        node.stdout.take().unwrap().read_u8().await.unwrap();
        left.started(Role::Device, "main", node.id().unwrap());
        left.change(|processes| processes.up = None);
        node
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn a_node_that_an_earlier_up_left_is_found_and_asked_to_end() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("observatory.toml");
        let mut node = left_by_the_dead(&config, "").await;
        let found = names(&alive(&path(&config)));
        assert_eq!(found, format!("the device node main as process {}", node.id().unwrap()));
        let (again, ended) = tokio::join!(Left::find(&config), node.wait());
        assert!(again.is_ok() && !ended.unwrap().success());
        assert!(alive(&path(&config)).is_empty());
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn of_two_that_start_while_nodes_of_an_earlier_up_still_end_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("observatory.toml");
        let _node = left_by_the_dead(&config, "trap '' TERM;").await;
        let refused = tokio::select! {
            biased;
            _ = Left::find(&config) => panic!("the node does not end"),
            second = Left::find(&config) => second.unwrap_err().to_string(),
        };
        assert!(refused.contains("another `starmesh up` runs this file already"), "{refused}");
        assert_eq!(alive(&path(&config)).len(), 1, "a third one knows of the node, too");
    }

    #[test]
    fn nodes_of_another_account_are_named_with_what_to_do() {
        let process = Process::of(std::process::id()).unwrap();
        let node = Started { role: Role::Device, id: "enclosure".to_owned(), process };
        let words = refused(&std::io::ErrorKind::PermissionDenied.into(), &[node]);
        assert!(words.contains(&format!("the device node enclosure as process {}", process.pid)), "{words}");
        assert!(words.contains(&format!("sudo kill {};", process.pid)), "{words}");
    }
}
