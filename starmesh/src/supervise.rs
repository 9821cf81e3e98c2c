//! Starts node processes, watches them, ends those that hang, restarts them with back-off, and ends them by their own id only.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use contract::Role;
use node::Stop;
use node::restart::{self, Pauses};
use node::watchdog::{self, Watchdog};
use tokio::process::{Child, Command};
use tokio::sync::oneshot;

use crate::left::Left;
use crate::reports::Reports;

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
    /// The file of its console lines; those of this process where absent.
    pub log: Option<PathBuf>,
    /// It ends with this process; an enclosure's device node must not, because its guard outlives all other processes.
    pub with_parent: bool,
    /// The file with the started processes, for the next `up`.
    pub left: Option<Arc<Left>>,
    /// Where its ends are reported that nobody asked for.
    pub reports: Option<Reports>,
    /// What the guard process of an enclosure stores apart from the configuration is here; where absent, in the state
    /// folder of the service or the account, for as long as that exists.
    pub state: Option<PathBuf>,
}

/// How nodes name this supervisor in their last state.
const SUPERVISOR: &str = "starmesh up";
/// A process that lived so long prints the cause of its end again.
const HEALTHY: Duration = Duration::from_secs(60);
/// A node that ends again and again waits at most so long for its next start.
const MOST: Duration = Duration::from_secs(60);
/// An observatory node closes first, at most 15 s.
const END: Duration = Duration::from_secs(25);
/// Longer than a guard process takes at most.
const END_DEVICE: Duration = Duration::from_secs(310);
/// An enclosure has no guard meanwhile (docs/reliability.md).
const MOST_DEVICE: Duration = Duration::from_secs(5);

/// How a node ended that was not asked to.
struct Ended {
    status: String,
    is_hung: bool,
    /// It said why, perhaps as the last time.
    is_known_failure: bool,
}

impl Ended {
    fn of(status: String) -> Self {
        Self { status, is_hung: false, is_known_failure: false }
    }
}

impl NodeProcess {
    fn longest_pause(&self) -> Duration {
        if self.role == Role::Device { MOST_DEVICE } else { MOST }
    }

    /// A node that was asked to end does so within this time: one that closes an enclosure may wait for a park.
    pub fn end_within(&self) -> Duration {
        if self.role == Role::Device { END_DEVICE } else { END }
    }

    /// Starts it.
    pub fn spawn(&self) -> anyhow::Result<Child> {
        self.spawn_with(None, None)
    }

    /// The command that starts it, without what belongs to one life of it.
    pub fn command(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command.args(["node", self.role.word(), "--id", &self.id, "--config"]).arg(&self.config);
        command.args(&self.arguments);
        if let Some(state) = &self.state {
            command.env("STATE_DIRECTORY", state);
        }
        command
    }

    fn spawn_with(&self, last_words: Option<&Path>, watchdog: Option<&Watchdog>) -> anyhow::Result<Child> {
        let mut command = self.command(&node::runs::program()?);
        if self.with_parent {
            command.arg("--with-parent").stdin(Stdio::piped());
        } else {
            command.stdin(Stdio::null());
        }
        if let Some(file) = last_words {
            command.env(node::start::LAST_WORDS, file);
        }
        match watchdog {
            Some(watchdog) => command.env(watchdog::SOCKET, watchdog.path()),
            // A socket of our own supervisor is for us.
            None => command.env_remove(watchdog::SOCKET),
        };
        command.env(node::SUPERVISOR, SUPERVISOR);
        // Ctrl-C in a terminal is for the supervisor alone, which ends its nodes in order.
        #[cfg(unix)]
        command.process_group(0);
        if let Some(log) = &self.log {
            let file = append(log)?;
            command.stdout(file.try_clone()?).stderr(file);
        }
        let child = command.spawn().with_context(|| format!("cannot start the {} node", self.role))?;
        if let (Some(left), Some(pid)) = (&self.left, child.id()) {
            left.started(self.role, &self.id, pid);
        }
        Ok(child)
    }

    /// Starts the node, and again until the stop is requested: at once after a good run (10 s and more), and after a pause that
    /// grows while it ends again and again or cannot be started. `first`: whether the first start succeeded; why not is printed
    /// before.
    pub async fn keep(&self, stop: Stop, first: oneshot::Sender<bool>) {
        self.keep_pausing(stop, first, tokio::time::sleep).await;
    }

    async fn keep_pausing<P: Future<Output = ()>>(
        &self,
        stop: Stop,
        first: oneshot::Sender<bool>,
        sleep: impl Fn(Duration) -> P,
    ) {
        let (mut pauses, mut first) = (Pauses::default(), Some(first));
        // Without it a node that ends prints each time why.
        let words = tempfile::NamedTempFile::new().ok().map(tempfile::NamedTempFile::into_temp_path);
        let mut printed_before = String::new();
        loop {
            let started = Instant::now();
            let Some(ended) = self.run(&stop, words.as_deref(), &mut first).await else { return };
            // A process that has run for a while, or was killed, prints the cause of its end again.
            if !ended.is_known_failure || started.elapsed() > HEALTHY {
                printed_before.clear();
                // Where the file cannot be emptied, a line is left out at most.
                let _ = words.as_deref().map(|words| std::fs::write(words, ""));
            }
            let pause = pauses.after(started.elapsed(), self.longest_pause());
            let (status, next) = (ended.status, restart::words(pause));
            if let Some(reports) = &self.reports {
                reports.ended(self.role, &self.id, &status, &next, ended.is_hung);
            }
            let text = words.as_deref().and_then(|words| std::fs::read_to_string(words).ok()).unwrap_or_default();
            if text.is_empty() || text != printed_before {
                node::lines::complain(format_args!(
                    "starmesh: the {} node {} ended ({status}); next start {next}, and again without a further word while it \
                     ends for the same reason",
                    self.role, self.id
                ));
            }
            printed_before = text;
            tell(&mut first, false);
            if stop.or(sleep(pause)).await.is_none() {
                return;
            }
        }
    }

    /// Starts the node and waits for its end; `None` if it was asked to end. A node that cannot be started has ended too.
    async fn run(&self, stop: &Stop, words: Option<&Path>, first: &mut Option<oneshot::Sender<bool>>) -> Option<Ended> {
        let watchdog = Watchdog::open();
        if let Err(error) = watchdog.as_ref().map_err(std::io::Error::kind)
            && error != std::io::ErrorKind::Unsupported
        {
            node::lines::complain(format_args!(
                "starmesh: nobody will notice it if the {} node hangs: {error}",
                self.role
            ));
        }
        let mut child = match self.spawn_with(words, watchdog.as_ref().ok()) {
            Ok(child) => child,
            Err(error) => return Some(Ended::of(format!("it was not started: {error:#}"))),
        };
        tell(first, true);
        // `wait` would close it, and the node would take that for our end.
        let lifeline = child.stdin.take();
        let Some(ended) = stop.or(watchdog::ended(&mut child, &watchdog)).await else {
            drop(lifeline);
            if let Err(error) = end(child, self.end_within()).await {
                node::lines::complain(format_args!("starmesh: the {} node {}: {error:#}", self.role, self.id));
            }
            return None;
        };
        let Some(ended) = ended else {
            // It takes no signal that asks. The guard of an enclosure outlives its guard process, and the other way round.
            let status = match child.kill().await {
                Ok(()) => "it did not report for 20 s, so it was killed".to_owned(),
                Err(error) => format!("it did not report for 20 s, and cannot be killed: {error}"),
            };
            return Some(Ended { is_hung: true, ..Ended::of(status) });
        };
        let is_known_failure = ended.as_ref().is_ok_and(|status| status.code() == Some(1));
        let status = ended.map_or_else(|error| error.to_string(), |status| status.to_string());
        Some(Ended { is_known_failure, ..Ended::of(status) })
    }
}

/// Tells once whether the first start succeeded.
fn tell(first: &mut Option<oneshot::Sender<bool>>, is_started: bool) {
    // Nobody may want to know.
    let _ = first.take().map(|first| first.send(is_started));
}

/// Ends a node: closes its standard input, asks it by signal where there are signals, and after its time has passed
/// kills it.
pub async fn end(mut child: Child, within: Duration) -> anyhow::Result<()> {
    drop(child.stdin.take());
    #[cfg(unix)]
    if let Some(pid) = child.id().and_then(|id| i32::try_from(id).ok()).and_then(rustix::process::Pid::from_raw) {
        // It may have ended just now; then there is no process to ask.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
    if tokio::time::timeout(within, child.wait()).await.is_err() {
        child.kill().await.context("cannot end a node that does not stop by itself")?;
    }
    Ok(())
}

fn append(log: &Path) -> anyhow::Result<std::fs::File> {
    let mut options = std::fs::OpenOptions::new();
    options.create(true).append(true);
    // The logs of nodes about the site are only for its user, like their data.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(log).with_context(|| format!("cannot write the log {}", log.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It cannot be started as long as its log has no folder. Then it is this test's own program, which does not know these
    /// arguments and ends.
    fn logging_to(role: Role, folder: &Path, log: &Path) -> NodeProcess {
        NodeProcess {
            role,
            id: "main".to_owned(),
            config: folder.join("observatory.toml"),
            arguments: Vec::new(),
            log: Some(log.to_owned()),
            with_parent: true,
            left: None,
            reports: None,
            state: None,
        }
    }

    #[tokio::test]
    async fn a_node_that_ends_at_once_is_started_after_pauses_that_grow_to_the_longest_one_of_its_role() {
        let folder = tempfile::tempdir().unwrap();
        for (role, wanted_s) in [(Role::Archive, &[1, 2, 4, 8, 16, 32, 60, 60][..]), (Role::Device, &[1, 2, 4, 5, 5])] {
            let node = logging_to(role, folder.path(), &folder.path().join("none/node.log"));
            let (stop, (first, _is_started)) = (Stop::default(), oneshot::channel());
            let paused_s = std::cell::RefCell::new(Vec::new());
            let pause = |pause: Duration| {
                paused_s.borrow_mut().push(pause.as_secs());
                if paused_s.borrow().len() == wanted_s.len() {
                    stop.stop();
                }
                std::future::ready(())
            };
            node.keep_pausing(stop.clone(), first, pause).await;
            assert_eq!(*paused_s.borrow(), wanted_s, "{role}");
        }
    }

    #[tokio::test]
    async fn a_node_that_cannot_be_started_is_started_again() {
        let folder = tempfile::tempdir().unwrap();
        let logs = folder.path().join("logs");
        let log = logs.join("archive.log");
        let node = logging_to(Role::Archive, folder.path(), &log);
        assert!(node.spawn().is_err(), "its log has no folder");
        let (stop, (first, mut is_started)) = (Stop::default(), oneshot::channel());
        let mut keeping = std::pin::pin!(node.keep(stop.clone(), first));
        let first_start = tokio::time::timeout(Duration::ZERO, &mut keeping).await;
        assert!(first_start.is_err() && !log.exists(), "one start that failed ended the supervision");
        assert_eq!(is_started.try_recv(), Ok(false), "and it is told");
        std::fs::create_dir(&logs).unwrap();
        let second_start = async {
            while !log.exists() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            stop.stop();
        };
        let both = async { tokio::join!(keeping, second_start) };
        tokio::time::timeout(Duration::from_secs(60), both).await.unwrap();
    }
}
