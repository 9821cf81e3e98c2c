//! Node processes: started, watched, restarted with back-off, and ended by their own id only.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bus::Stop;
use contract::Role;
use tokio::process::{Child, Command};

/// How one node is started.
#[derive(Debug, Clone)]
pub struct NodeProcess {
    /// Its role.
    pub role: Role,
    /// Its name.
    pub id: String,
    /// The telescope's observatory.toml.
    pub config: PathBuf,
    /// Further arguments of `starmesh node`.
    pub arguments: Vec<String>,
    /// Where its console lines go; to this process's own where absent.
    pub log: Option<PathBuf>,
    /// It ends with this process; an enclosure's device node must not, for its guard outlives everybody.
    pub with_parent: bool,
}

/// A process that lived so long is healthy again: the next restart comes at once.
const HEALTHY: Duration = Duration::from_secs(60);
/// A node that keeps ending waits at most so long for its next start.
const MOST: Duration = Duration::from_secs(60);
/// An enclosure has no guard meanwhile (docs/reliability.md).
const MOST_DEVICE: Duration = Duration::from_secs(5);

impl NodeProcess {
    fn longest_pause(&self) -> Duration {
        if self.role == Role::Device { MOST_DEVICE } else { MOST }
    }

    /// Starts it.
    pub fn spawn(&self) -> anyhow::Result<Child> {
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let mut command = Command::new(program);
        command.args(["node", self.role.word(), "--id", &self.id, "--config"]).arg(&self.config);
        command.args(&self.arguments);
        if self.with_parent {
            command.arg("--with-parent").stdin(Stdio::piped());
        } else {
            command.stdin(Stdio::null());
        }
        if let Some(log) = &self.log {
            let file = append(log)?;
            command.stdout(file.try_clone()?).stderr(file);
        }
        command.spawn().with_context(|| format!("cannot start the {} node", self.role))
    }

    /// Keeps it running until the stop is said: restarted after 1 s, with back-off while it keeps ending.
    pub async fn keep(&self, stop: Stop) -> anyhow::Result<()> {
        let mut pause = Duration::from_secs(1);
        loop {
            let started = Instant::now();
            let mut child = self.spawn()?;
            // waiting would close it, and the node would take that for our end
            let lifeline = child.stdin.take();
            let Some(ended) = stop.or(child.wait()).await else {
                drop(lifeline);
                return end(child).await;
            };
            let status = ended.map_or_else(|error| error.to_string(), |status| status.to_string());
            pause = if started.elapsed() > HEALTHY {
                Duration::from_secs(1)
            } else {
                (pause * 2).min(self.longest_pause())
            };
            eprintln!("starmesh: the {} node {} ended ({status}); next start in {pause:?}", self.role, self.id);
            if stop.or(tokio::time::sleep(pause)).await.is_none() {
                return Ok(());
            }
        }
    }
}

/// Ends a node: closes its standard input, asks it by signal where there are signals, and after 20 s kills it.
pub async fn end(mut child: Child) -> anyhow::Result<()> {
    drop(child.stdin.take());
    #[cfg(unix)]
    if let Some(pid) = child.id().and_then(|id| i32::try_from(id).ok()).and_then(rustix::process::Pid::from_raw) {
        // it may have ended just now; then there is nobody to ask
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
    if tokio::time::timeout(Duration::from_secs(20), child.wait()).await.is_err() {
        child.kill().await.context("cannot end a node that does not stop by itself")?;
    }
    Ok(())
}

fn append(log: &Path) -> anyhow::Result<std::fs::File> {
    std::fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(log)
        .with_context(|| format!("cannot write the log {}", log.display()))
}
