//! Starts a node as a process of its own, and ends it in good order.

use std::future::Future;
use std::time::Duration;

use anyhow::Context as _;
use bus::{Bus, Clock};
use contract::Role;
use contract::observatory::AlertKind;

use crate::configuration::read_config_of_node;
use crate::log::init_tracing;
use crate::node::{Node, started};
use crate::options::NodeOptions;
use crate::signals::{end_asked, parent_end, termination};
use crate::{lines, private, runs, service_manager, signals};

/// The supervisor learns so often that this process runs; its timeout is a multiple of it.
const REPORT: Duration = Duration::from_secs(5);
/// A simulator that does not answer is asked so often, each second, before the node ends for that.
const SIMULATOR_TRIES: u32 = 30;

/// Starts one node as a process of its own: options, configuration, clock, bus, then `run` until a signal.
///
/// Returns the process's exit code; errors are printed once, with all their causes.
pub fn main<F, W>(options: NodeOptions, role: Role, run: F) -> std::process::ExitCode
where
    F: FnOnce(Node) -> W,
    W: Future<Output = anyhow::Result<()>>,
{
    signals::listen();
    bus::threads::ensure();
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
            if !was_printed_before(&words) {
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
    // From the first moment on: what a node waits for at its start, such as its clock, is no reason to end it.
    tokio::spawn(async {
        loop {
            service_manager::alive();
            tokio::time::sleep(REPORT).await;
        }
    });
    let (mut config, header, wrong) = read_config_of_node(&options.config)?;
    if options.check {
        anyhow::ensure!(wrong.is_none(), "{}", wrong.unwrap_or_default());
        lines::print_line(format_args!("{}: valid ({} devices)", options.config.display(), config.devices().len()));
        return Ok(());
    }
    if !options.listen.is_empty() {
        config.bus.listen = options.listen;
    }
    config.bus.connect.extend(options.connect);
    config.bus.multicast &= !options.no_multicast;

    private::tighten(&config.folders.data, &config.folders.images);

    let diary = init_tracing();
    let opened = async {
        let clock = match &config.clock.simulator {
            Some(base) => clock_of_simulator(base).await?,
            None => Clock::machine_clock(),
        };
        anyhow::Ok(Bus::open(&config.bus, clock).await?)
    };
    let bus = tokio::select! {
        biased;
        () = end_asked() => return Ok(()),
        bus = opened => bus?,
    };
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
    let runs = node.clone();
    tokio::spawn(async move { runs::notice(&runs).await });
    let result = node.clone().live(diary, run(node.clone())).await;
    bus.close().await;
    if result.is_ok() {
        runs::ended_well(&node).await;
    }
    result
}

/// The clock of a simulator, which may be started in the same moment as this node.
async fn clock_of_simulator(base: &str) -> anyhow::Result<Clock> {
    for _ in 1..SIMULATOR_TRIES {
        match Clock::of_simulator(base).await {
            Ok(clock) => return Ok(clock),
            Err(bus::ClockError::NoAnswer { .. }) => tokio::time::sleep(Duration::from_secs(1)).await,
            Err(error) => return Err(error.into()),
        }
    }
    Ok(Clock::of_simulator(base).await?)
}

/// The file by which a supervisor passes to a node the error that it logged when it ended last, so that a node that
/// cannot start for the same reason each time logs it once.
pub const LAST_WORDS: &str = "STARMESH_LAST_WORDS";

fn was_printed_before(words: &str) -> bool {
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
