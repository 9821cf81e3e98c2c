//! The processes that `starmesh up` started, in a file next to the configuration, so that the next `starmesh up` knows
//! which of them still run.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use contract::Role;
use serde::{Deserialize, Serialize};

use crate::process::Process;

/// A device node without an enclosure ends within this time.
const END: Duration = Duration::from_secs(15);

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Started {
    role: Role,
    id: String,
    #[serde(flatten)]
    process: Process,
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

impl Left {
    /// Finds the processes that an earlier `up` left, asks them to end, and names them. An error where an earlier `up`
    /// still runs.
    pub async fn find(config: &Path) -> anyhow::Result<Self> {
        let name = config.file_name().unwrap_or_default().to_string_lossy();
        let path = config.with_file_name(format!(".{name}.up"));
        // A file that is not whole names no process.
        let before: Processes =
            std::fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        if let Some(up) = before.up.filter(|up| up.is_alive()) {
            bail!(
                "another `starmesh up` runs this file already, as process {0}; one is enough. To end that one press Ctrl-C in its \
                 terminal, or type kill {0}: it closes the enclosure first, which takes some seconds",
                up.pid
            );
        }
        for Started { role, id, process } in before.nodes.into_iter().filter(|node| node.process.is_alive()) {
            let pid = process.pid;
            node::lines::print_line(format_args!(
                "an earlier `starmesh up` left the {role} node {id} as process {pid}: it is asked to end"
            ));
            ask_to_end(pid);
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
        let left = Self { path, processes: std::sync::Mutex::default() };
        left.change(|processes| processes.up = Process::of(std::process::id()));
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
        let alive = processes.nodes.iter().filter(|node| node.process.is_alive());
        let each = alive.map(|node| format!("the {} node {} as process {}", node.role, node.id, node.process.pid));
        let each: Vec<String> = each.collect();
        if each.is_empty() { "nothing".to_owned() } else { each.join(", ") }
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

#[cfg(unix)]
fn ask_to_end(pid: u32) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(rustix::process::Pid::from_raw) {
        // It may have ended just now.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
}

#[cfg(not(unix))]
fn ask_to_end(pid: u32) {
    node::lines::print_line(format_args!("end process {pid} by hand: this system has no signal for it"));
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

    #[cfg(unix)]
    #[tokio::test]
    async fn a_node_that_an_earlier_up_left_is_asked_to_end() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("observatory.toml");
        let left = Left::find(&config).await.unwrap();
        let mut node = tokio::process::Command::new("sleep").arg("60").spawn().unwrap();
        left.started(Role::Device, "main", node.id().unwrap());
        // The earlier one has died.
        let text = std::fs::read_to_string(&left.path).unwrap();
        let mut processes: Processes = serde_json::from_str(&text).unwrap();
        processes.up = None;
        write(&left.path, &processes).unwrap();
        let (found, ended) = tokio::join!(Left::find(&config), node.wait());
        assert!(found.is_ok() && !ended.unwrap().success());
    }
}
