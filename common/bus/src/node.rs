//! How every node starts, lives and stops.

use std::future::Future;
use std::io::{IsTerminal as _, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::Parser;
use config::Observatory;
use config::header::HeaderTable;
use contract::node::{DiaryLine, NodeState};
use contract::observatory::AlertKind;
use contract::{Key, Name, NodeTopic, Role, Scalar};
use tokio::sync::mpsc;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{FilterExt as _, filter_fn};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::diary::DiaryLayer;
use crate::figures::Figures;
use crate::flood::{self, Flood};
pub use crate::host::host_name;
use crate::lines::{self, LogLine};
use crate::zenoh_log::{ZenohLog, is_zenoh};
use crate::{AlertBoard, Bus, Clock, Quality, Stop, console, disk, links, notify, private, threads, twin};

/// What a node's command line takes.
#[derive(Debug, Clone, Parser)]
#[command(version)]
pub struct NodeOptions {
    /// The telescope's observatory.toml.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// This node's name; needed where several nodes of one role serve one telescope. Where absent: `main`; all device
    /// nodes of the file, each as a process of its own, for the role `device`.
    #[arg(long)]
    pub id: Option<Name>,
    /// Prove the configuration and stop.
    #[arg(long)]
    pub check: bool,
    /// Listen here instead of where the configuration says, such as tcp/127.0.0.1:7447.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Meet this peer, in addition to those of the configuration.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Do not look for peers by multicast, whatever the configuration says.
    #[arg(long)]
    pub no_multicast: bool,
    /// Stop when standard input closes, that is when the parent process ends.
    #[arg(long)]
    pub with_parent: bool,
    /// This device node has a guard process around it, which alone sets this.
    #[arg(long, hide = true)]
    pub guarded: bool,
}

/// A node that has joined the bus.
#[derive(Clone)]
pub struct Node {
    /// The telescope's configuration.
    pub config: Arc<Observatory>,
    /// The site's FITS-header table.
    pub header: Arc<HeaderTable>,
    /// The bus.
    pub bus: Bus,
    /// This node's role.
    pub role: Role,
    /// This node's name.
    pub id: Name,
    /// Its alerts.
    pub alerts: AlertBoard,
    /// Set when somebody asks the node to end. Observatory and device nodes first do what an end in good order needs,
    /// and then set [`Self::stop`] themselves; for the others both come together.
    pub ending: Stop,
    /// Set when it is time to end, at once.
    pub stop: Stop,
    figures: Figures,
}

impl Node {
    /// A node around a bus that is open already.
    pub fn new(role: Role, id: Name, config: Observatory, header: HeaderTable, bus: Bus) -> Self {
        let alerts = AlertBoard::new(bus.clock().clone());
        Self {
            config: Arc::new(config),
            header: Arc::new(header),
            bus,
            role,
            id,
            alerts,
            ending: Stop::default(),
            stop: Stop::default(),
            figures: Figures::default(),
        }
    }

    /// One of this node's own keys.
    pub fn key(&self, topic: NodeTopic) -> Key {
        Key::Node(self.config.address(), self.role, self.id.clone(), topic)
    }

    /// How this node signs commands and permits, such as `observatory/callisto/main`.
    pub fn signature(&self) -> String {
        format!("{}/{}/{}", self.role, self.config.place.telescope, self.id)
    }

    /// Sets a figure of this node's published state; its name ends in its unit.
    pub fn figure(&self, name: &str, value: Scalar) {
        self.figures.set(name, value);
    }

    /// Runs a node's work in parallel with its own publications (presence, health, alerts, diary) until it is stopped.
    pub async fn live<W>(self, diary: Option<mpsc::Receiver<DiaryLine>>, work: W) -> anyhow::Result<()>
    where
        W: Future<Output = anyhow::Result<()>>,
    {
        let _alive = self.bus.show_alive(&self.key(NodeTopic::Alive)).await?;
        let states = self.bus.publisher::<NodeState>(&self.key(NodeTopic::State), Quality::State { cache: 1 }).await?;
        let alerts = self.bus.publisher(&self.key(NodeTopic::Alerts), Quality::State { cache: 100 }).await?;
        let lines = self.bus.publisher(&self.key(NodeTopic::Diary), Quality::Event { cache: 1000 }).await?;
        let (clock, state_key) = (self.bus.clock(), self.key(NodeTopic::State));
        let health = async {
            loop {
                let left_out = i64::try_from(flood::left_out()).unwrap_or(i64::MAX);
                self.figure("log_lines_left_out_count", Scalar::Int(left_out));
                states.put(self.state()).await?;
                clock.tick(Duration::from_secs(5)).await;
            }
        };
        let write = async {
            if let Some(mut diary) = diary {
                while let Some(line) = diary.recv().await {
                    lines.put(line).await?;
                }
            }
            std::future::pending::<anyhow::Result<()>>().await
        };
        tokio::select! {
            result = work => result,
            result = health => result,
            result = twin::leave_to_older(&state_key, &self.id, &self.bus, &self.alerts) => result,
            result = disk::keep_telling(&self.config, self.role, &self.figures, &self.alerts, clock) => result,
            result = links::keep_mending(&self.bus) => result,
            result = write => result,
            () = self.alerts.keep_time() => Ok(()),
            result = alerts.follow(self.alerts.watch(), Duration::from_secs(10)) => Ok(result?),
        }
    }

    pub(crate) fn state(&self) -> NodeState {
        let now = self.bus.clock().machine();
        NodeState {
            role: self.role,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            host: host_name(),
            pid: std::process::id(),
            uptime_s: now.since(started()).as_secs_f64(),
            speed: self.bus.clock().speed(),
            figures: self.figures.all(),
        }
    }
}

fn started() -> crate::MachineTime {
    static STARTED: std::sync::OnceLock<crate::MachineTime> = std::sync::OnceLock::new();
    *STARTED.get_or_init(crate::machine::now)
}

/// The text of a file, and no more of it than shows that it is too large.
fn read_text(file: &Path) -> std::io::Result<String> {
    let (mut bytes, most) = (Vec::new(), config::MOST_BYTES as u64 + 1);
    std::fs::File::open(file)?.take(most).read_to_end(&mut bytes)?;
    config::utf8(bytes).map_err(std::io::Error::other)
}

/// The text of a configuration file; errors name the file.
pub fn config_text(file: &Path) -> anyhow::Result<String> {
    let read = read_text(file);
    read.with_context(|| format!("cannot read the configuration {}", file.display()))
}

/// Reads a configuration file without the files that it names; errors name the file.
pub fn read_observatory(file: &Path) -> anyhow::Result<Observatory> {
    let text = config_text(file)?;
    let folder = file.parent().unwrap_or(Path::new("."));
    config::parse(&text, folder).with_context(|| format!("{} is not a valid configuration", file.display()))
}

/// Reads a configuration file with its FITS-header table; errors name the file.
pub fn read_config(file: &Path) -> anyhow::Result<(Observatory, HeaderTable)> {
    let config = read_observatory(file)?;
    let header = read_header(&config)?;
    Ok((config, header))
}

/// The FITS-header table of a configuration, its own or the built-in one.
fn read_header(config: &Observatory) -> anyhow::Result<HeaderTable> {
    let Some(csv) = &config.archive.fits_header else { return Ok(HeaderTable::default()) };
    let shown = csv.display();
    let text =
        read_text(csv).with_context(|| format!("archive.fits_header: cannot read the FITS-header table {shown}"))?;
    text.parse().with_context(|| format!("archive.fits_header: {shown} is not a valid FITS-header table"))
}

/// As [`read_config`], for a node that goes on with the built-in rows where the FITS-header table cannot be used: no
/// dome stays open because of a table. The returned text is the table's error.
fn read_config_of_node(file: &Path) -> anyhow::Result<(Observatory, HeaderTable, Option<String>)> {
    let config = read_observatory(file)?;
    Ok(match read_header(&config) {
        Ok(header) => (config, header, None),
        Err(why) => (config, HeaderTable::default(), Some(format!("{why:#}; the built-in rows are used"))),
    })
}

/// Starts one node as a process of its own: options, configuration, clock, bus, then `run` until a signal.
///
/// Returns the process's exit code; errors are printed once, with all their causes.
pub fn main<F, W>(role: Role, run: F) -> std::process::ExitCode
where
    F: FnOnce(Node) -> W,
    W: Future<Output = anyhow::Result<()>>,
{
    main_with(NodeOptions::parse(), role, run)
}

/// As [`main`], with options that somebody else has parsed.
pub fn main_with<F, W>(options: NodeOptions, role: Role, run: F) -> std::process::ExitCode
where
    F: FnOnce(Node) -> W,
    W: Future<Output = anyhow::Result<()>>,
{
    threads::ensure();
    private::keep_files_private();
    lines::take_panics();
    let started = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the runtime")
        .and_then(|runtime| runtime.block_on(start(options, role, run)));
    match started {
        Ok(()) => {
            lines::flush();
            std::process::ExitCode::SUCCESS
        }
        Err(error) => {
            let words = format!("node-{role}: {error:#}");
            if !was_said_before(&words) {
                lines::complain(words);
            }
            lines::flush();
            std::process::ExitCode::FAILURE
        }
    }
}

async fn start<F, W>(options: NodeOptions, role: Role, run: F) -> anyhow::Result<()>
where
    F: FnOnce(Node) -> W,
    W: Future<Output = anyhow::Result<()>>,
{
    started();
    let (mut config, header, wrong) = read_config_of_node(&options.config)?;
    if options.check {
        anyhow::ensure!(wrong.is_none(), "{}", wrong.unwrap_or_default());
        lines::say(format_args!("{}: valid ({} devices)", options.config.display(), config.devices().len()));
        return Ok(());
    }
    if !options.listen.is_empty() {
        config.bus.listen = options.listen;
    }
    config.bus.connect.extend(options.connect);
    config.bus.multicast &= !options.no_multicast;

    private::tighten(&config.folders.data, &config.folders.images);

    let diary = init_tracing();
    let clock = match &config.clock.simulator {
        Some(base) => Clock::of_simulator(base).await?,
        None => Clock::machine_clock(),
    };
    let bus = Bus::open(&config.bus, clock).await?;
    let id = match options.id {
        Some(id) => id,
        None => config::MAIN_NODE.parse().context("the name of a node that was given none")?,
    };
    let node = Node::new(role, id, config, header, bus.clone());
    tracing::info!(telescope = %node.config.address(), id = %node.id, "{role} node started");
    if let Some(why) = wrong {
        node.alerts.raise(AlertKind::Configuration, "archive.fits_header", &why);
    }

    tokio::spawn(end_when_asked(node.clone()));
    if options.with_parent && !options.guarded {
        let node = node.clone();
        tokio::spawn(async move {
            parent_end().await;
            asked_to_end(&node);
        });
    }
    tokio::spawn(async {
        loop {
            notify::alive();
            tokio::time::sleep(Duration::from_secs(5)).await;
        }
    });
    let result = node.clone().live(diary, run(node)).await;
    bus.close().await;
    result
}

/// The file by which a supervisor passes to a node the error that it logged when it ended last, so that a node that
/// cannot start for the same reason each time logs it once.
pub const LAST_WORDS: &str = "STARMESH_LAST_WORDS";

fn was_said_before(words: &str) -> bool {
    let Some(file) = std::env::var_os(LAST_WORDS) else { return false };
    if std::fs::read_to_string(&file).is_ok_and(|before| before == words) {
        return true;
    }
    // If it cannot be written, the error is logged again.
    let _ = std::fs::write(&file, words);
    false
}

/// The first signal asks for an end in good order, the second one ends the process at once.
async fn end_when_asked(node: Node) {
    end_asked().await;
    asked_to_end(&node);
    termination().await;
    let role = node.role;
    lines::complain(format_args!(
        "node-{role}: ended at once by a second signal; what this node guarded nobody guards now"
    ));
    lines::flush();
    std::process::exit(1);
}

fn asked_to_end(node: &Node) {
    node.ending.stop();
    if !matches!(node.role, Role::Device | Role::Observatory) {
        node.stop.stop();
    }
}

/// Log lines on the console, for a process that is no node.
pub fn log_to_console() {
    // A second subscriber is not needed.
    let _ = console_at("info").try_init();
}

/// Console at the level of `STARMESH_LOG` (default info), and the diary; `None` where a subscriber is set already.
fn init_tracing() -> Option<mpsc::Receiver<DiaryLine>> {
    let (diary, lines) = DiaryLayer::new();
    // The bus's own complaints stay off the bus: it would complain of them, too.
    let diary_filter = tracing_subscriber::EnvFilter::new("info,zenoh=off,uhlc=off").and(Flood::default());
    let set = on_console().with(diary.with_filter(diary_filter)).try_init();
    set.is_ok().then_some(lines)
}

/// Shows what a command does on the console, at the level of `STARMESH_LOG` (default warnings).
pub fn show_log() {
    // A second subscriber is not needed.
    let _ = console_at("warn").try_init();
}

fn on_console() -> impl tracing::Subscriber + for<'a> LookupSpan<'a> + Send + Sync {
    console_at("info")
}

/// The console. zenoh's own lines are printed only if `STARMESH_LOG` names zenoh; our own lines report what they mean.
fn console_at(level: &str) -> impl tracing::Subscriber + for<'a> LookupSpan<'a> + Send + Sync {
    let mut words = std::env::var("STARMESH_LOG").unwrap_or_else(|_| level.to_owned());
    if !words.contains("zenoh") {
        words.push_str(",zenoh=off,uhlc=off");
    }
    let filter = tracing_subscriber::EnvFilter::new(words).and(Flood::default());
    let colour = std::io::stderr().is_terminal();
    let console = tracing_subscriber::fmt::layer().fmt_fields(console::fields()).with_writer(|| LogLine);
    let console = console.with_ansi(colour).with_filter(filter);
    let of_zenoh = filter_fn(|metadata| is_zenoh(metadata.target()) && *metadata.level() <= tracing::Level::WARN);
    tracing_subscriber::registry().with(console).with(ZenohLog::new().with_filter(of_zenoh))
}

/// Waits until standard input closes; a thread of its own, so that a read without end cannot hold the runtime up.
pub async fn parent_end() {
    let (ended, end) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // Later input is not for us; an error ends the reading as the end of the file does.
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        let _ = ended.send(());
    });
    let _ = end.await;
}

/// Waits for SIGTERM, Ctrl-C or the end of the terminal, whichever asks first for an end in good order.
pub async fn end_asked() {
    tokio::select! {
        () = termination() => {}
        () = hangup() => {}
    }
}

/// Waits until the terminal ends. A shell may signal this twice, so this is never the second signal, which ends at
/// once.
#[cfg(unix)]
async fn hangup() {
    use tokio::signal::unix::{SignalKind, signal};
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    // Under `nohup` the end of the terminal means nothing.
    if heeds_hangup(&status)
        && let Ok(mut hangup) = signal(SignalKind::hangup())
    {
        hangup.recv().await;
        return;
    }
    std::future::pending().await
}

#[cfg(not(unix))]
async fn hangup() {
    std::future::pending().await
}

/// Does a process with this status, as Linux reports it, not ignore SIGHUP? An unknown status counts as ignoring it.
#[cfg(unix)]
fn heeds_hangup(status: &str) -> bool {
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 == 0)
}

/// Waits for SIGTERM or Ctrl-C.
#[cfg(unix)]
pub async fn termination() {
    use tokio::signal::unix::{SignalKind, signal};
    let Ok(mut terminate) = signal(SignalKind::terminate()) else {
        let _ = tokio::signal::ctrl_c().await;
        return;
    };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = tokio::signal::ctrl_c() => {}
    }
}

/// Waits for Ctrl-C.
#[cfg(not(unix))]
pub async fn termination() {
    let _ = tokio::signal::ctrl_c().await;
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_terminal_asks_for_an_end_unless_it_is_to_be_ignored() {
        assert!(heeds_hangup("Name:\tstarmesh\nSigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n"));
        assert!(!heeds_hangup("SigIgn:\t0000000000001001\n"), "nohup");
        assert!(!heeds_hangup(""), "nothing is told");
    }

    #[tokio::test]
    async fn a_hangup_is_an_order_to_end() {
        if !heeds_hangup(&std::fs::read_to_string("/proc/self/status").unwrap()) {
            return; // these tests themselves run under nohup
        }
        let asked = tokio::spawn(end_asked());
        tokio::task::yield_now().await;
        rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::HUP).unwrap();
        asked.await.unwrap();
    }
}
