//! The processes that `starmesh up` started, in a file next to the configuration, so that the next `starmesh up` and other
//! commands know which of them still run.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use contract::Role;
use serde::{Deserialize, Serialize};

use crate::process::Process;

/// A device node without an enclosure ends within this time.
const END: Duration = Duration::from_secs(15);

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
}

/// The file of a configuration.
pub fn path(config: &Path) -> PathBuf {
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

/// A file that is not there or not whole names no process.
fn read(path: &Path) -> Processes {
    std::fs::read(path).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
}

impl Left {
    /// Finds the processes that an earlier `up` left, asks them to end, and names them. An error where an earlier `up`
    /// still runs, or where they cannot be asked.
    pub async fn find(config: &Path) -> anyhow::Result<Self> {
        let path = path(config);
        if let Some(up) = read(&path).up.filter(|up| up.is_alive()) {
            bail!(
                "another `starmesh up` runs this file already, as process {0}; one is enough. To end that one press Ctrl-C in its \
                 terminal, or type kill {0}: it closes the enclosure first, which takes some seconds",
                up.pid
            );
        }
        let nodes = alive(&path);
        let left = Self { path, processes: std::sync::Mutex::new(Processes { up: None, nodes: nodes.clone() }) };
        // Before they are waited for: a second `up` finds this one.
        left.change(|processes| processes.up = Process::of(std::process::id()));
        for node in &nodes {
            node::lines::print_line(format_args!("an earlier `starmesh up` left {node}: it is asked to end"));
            let Started { role, id, process } = node;
            let pid = process.pid;
            if let Err(error) = ask_to_end(pid) {
                bail!(refused(&error, &alive(&left.path)));
            }
            let began = std::time::Instant::now();
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
                "starmesh: {error:#}; a later `starmesh up` will not know what this one left"
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
        assert!(refused.contains(&format!("process {}", std::process::id())), "{refused}");
        left.nothing();
        assert!(Left::find(&config).await.is_ok());
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
