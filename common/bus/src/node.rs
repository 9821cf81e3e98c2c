//! How every node starts, lives and stops.

use std::collections::BTreeMap;
use std::future::Future;
use std::io::{IsTerminal as _, Read as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context as _;
use clap::Parser;
use config::Observatory;
use config::header::HeaderTable;
use contract::node::{DiaryLine, NodeState};
use contract::{Key, Name, NodeTopic, Role, Scalar};
use tokio::sync::mpsc;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::FilterExt as _;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::diary::DiaryLayer;
use crate::flood::{self, Flood};
use crate::{AlertBoard, Bus, Clock, Quality, Stop, disk, links, threads, twin};

/// What a node's command line takes.
#[derive(Debug, Clone, Parser)]
#[command(version)]
pub struct NodeOptions {
    /// The telescope's observatory.toml.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// This node's name; needed where several nodes of one role serve one telescope.
    #[arg(long, default_value = "main")]
    pub id: Name,
    /// Prove the configuration and stop.
    #[arg(long)]
    pub check: bool,
    /// Listen here instead of where the configuration says, such as tcp/127.0.0.1:7447.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Meet this peer, beside those of the configuration.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Do not look for peers by multicast, whatever the configuration says.
    #[arg(long)]
    pub no_multicast: bool,
    /// Stop when standard input closes, that is when the parent process ends.
    #[arg(long)]
    pub with_parent: bool,
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
    /// Heard when it is time to end.
    pub stop: Stop,
    figures: Arc<Mutex<BTreeMap<String, Scalar>>>,
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
            stop: Stop::default(),
            figures: Arc::default(),
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
        self.figures.lock().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned(), value);
    }

    /// Runs a node's work beside its own voice (presence, health, alerts, diary) until it is stopped.
    pub async fn live<W>(self, diary: Option<mpsc::Receiver<DiaryLine>>, work: W) -> anyhow::Result<()>
    where
        W: Future<Output = anyhow::Result<()>>,
    {
        let _alive = self.bus.show_alive(&self.key(NodeTopic::Alive)).await?;
        let states = self.bus.publisher::<NodeState>(&self.key(NodeTopic::State), Quality::State { cache: 1 }).await?;
        let alerts = self.bus.publisher(&self.key(NodeTopic::Alerts), Quality::State { cache: 100 }).await?;
        let lines = self.bus.publisher(&self.key(NodeTopic::Diary), Quality::Event { cache: 1000 }).await?;
        let health = async {
            loop {
                let left_out = i64::try_from(flood::left_out()).unwrap_or(i64::MAX);
                self.figure("log_lines_left_out_count", Scalar::Int(left_out));
                states.put(self.state()).await?;
                self.bus.clock().tick(Duration::from_secs(5)).await;
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
            result = twin::leave_to_older(&self) => result,
            result = disk::keep_telling(&self) => result,
            result = links::keep_mending(&self) => result,
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
            figures: self.figures.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }
}

/// This host's name, as its shell, Windows or the Linux kernel tells it; empty where none does.
pub fn host_name() -> String {
    let told = std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME"));
    let name = told.or_else(|_| std::fs::read_to_string("/proc/sys/kernel/hostname")).unwrap_or_default();
    name.trim().to_owned()
}

fn started() -> crate::MachineTime {
    static STARTED: std::sync::OnceLock<crate::MachineTime> = std::sync::OnceLock::new();
    *STARTED.get_or_init(crate::MachineTime::now)
}

/// The text of a file, and no more of it than shows that it is too large.
fn read_text(file: &Path) -> std::io::Result<String> {
    let (mut text, most) = (String::new(), config::MOST_BYTES as u64 + 1);
    std::fs::File::open(file)?.take(most).read_to_string(&mut text)?;
    Ok(text)
}

/// Reads a configuration file with its FITS-header table; errors name the file.
pub fn read_config(file: &Path) -> anyhow::Result<(Observatory, HeaderTable)> {
    let text = read_text(file).with_context(|| format!("cannot read the configuration {}", file.display()))?;
    let folder = file.parent().unwrap_or(Path::new("."));
    let config =
        config::parse(&text, folder).with_context(|| format!("{} is not a valid configuration", file.display()))?;
    let header = match &config.archive.fits_header {
        None => HeaderTable::default(),
        Some(csv) => read_text(csv)
            .with_context(|| format!("cannot read the FITS-header table {}", csv.display()))?
            .parse()
            .with_context(|| format!("{} is not a valid FITS-header table", csv.display()))?,
    };
    Ok((config, header))
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
    let started = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the runtime")
        .and_then(|runtime| runtime.block_on(start(options, role, run)));
    match started {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("node-{role}: {error:#}");
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
    let (mut config, header) = read_config(&options.config)?;
    if options.check {
        println!("{}: valid ({} devices)", options.config.display(), config.devices().len());
        return Ok(());
    }
    if !options.listen.is_empty() {
        config.bus.listen = options.listen;
    }
    config.bus.connect.extend(options.connect);
    config.bus.multicast &= !options.no_multicast;

    let diary = init_tracing();
    let clock = match &config.clock.simulator {
        Some(base) => Clock::of_simulator(base).await?,
        None => Clock::machine_clock(),
    };
    let bus = Bus::open(&config.bus, clock).await?;
    let node = Node::new(role, options.id, config, header, bus.clone());
    tracing::info!(telescope = %node.config.address(), id = %node.id, "{role} node started");

    let stop = node.stop.clone();
    tokio::spawn(async move {
        tokio::select! {
            () = termination() => {}
            () = parent_end(), if options.with_parent => {}
        }
        stop.stop();
    });
    let result = node.clone().live(diary, run(node)).await;
    bus.close().await;
    result
}

/// Console at the level of `STARMESH_LOG` (default info), and the diary; `None` where a subscriber is set already.
fn init_tracing() -> Option<mpsc::Receiver<DiaryLine>> {
    let words = std::env::var("STARMESH_LOG").unwrap_or_else(|_| "info,zenoh=warn,uhlc=error".to_owned());
    let filter = tracing_subscriber::EnvFilter::new(words).and(Flood::default());
    let (diary, lines) = DiaryLayer::new();
    // what the bus complains of stays off the bus: it would complain of that, too
    let diary_filter = tracing_subscriber::EnvFilter::new("info,zenoh=off,uhlc=off").and(Flood::default());
    let colour = std::io::stderr().is_terminal();
    let console = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(colour).with_filter(filter);
    let set = tracing_subscriber::registry().with(console).with(diary.with_filter(diary_filter)).try_init();
    set.is_ok().then_some(lines)
}

/// Waits until standard input closes; a thread of its own, so that a read without end cannot hold the runtime up.
async fn parent_end() {
    let (ended, end) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // whatever comes is not for us; an error ends the reading as the end of the file does
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        let _ = ended.send(());
    });
    let _ = end.await;
}

#[cfg(unix)]
async fn termination() {
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

#[cfg(not(unix))]
async fn termination() {
    let _ = tokio::signal::ctrl_c().await;
}
