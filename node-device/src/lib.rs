//! The device node: bridges ASCOM Alpaca devices to the bus.
//!
//! A reading takes this way: `alpaca` asks the server and accepts sloppy answers; a `driver` (one file per ASCOM kind,
//! pure mapping) selects the properties and defines their meaning; `serve`, the one loop for all kinds, polls,
//! publishes, executes commands and reconnects. A command takes this way: `command_server` answers it at once,
//! after `interlock::Authorization` has checked its token and the guard the permits; the loop executes it, and the
//! device's own state shows when it is done.
//!
//! Frames go to the `spool` on disk, are announced, served by HTTP, and removed when the archive releases them.
//! The dome's guard (`interlock::Guard` and `interlock::GuardLoop`, pure state machines) has a task and a connection of
//! its own: `guard_task`.
//!
//! # Invariants
//!
//! - The arbiter of the lease counts by its own grants: no message teaches it a token, and none ends a node
//!   (`token.rs`, decision 0047): `an_arbiter_learns_no_token_from_anybody_and_others_follow_it_up_and_down`.
//! - A mount that reports the same pier side beyond a meridian, the upper or the lower one, as before it has not flipped
//!   (`mount_limits.rs`): `past_each_meridian_only_the_wrong_side_of_the_pier_is_stopped`.
//! - A mount that tracks beyond a limit is ordered to stop until its own coordinates show that it stands, or it is
//!   parked (decision 0132): `orders_follow_each_other_until_the_coordinates_show_that_it_stands`.
//! - No command drops a stop that is not sent yet (`serve/command.rs`, decision 0132):
//!   `a_mount_that_ignores_the_end_of_tracking_at_its_limit_is_aborted_and_then_parked`.
//! - Tracking rates other than the sidereal one end with a slew, with tracking switched on or off and with a park
//!   (decision 0029).
//! - No command of a maker's own is sent that the device's block does not list (decision 0031):
//!   `only_what_is_listed_is_allowed` (`common/config/src/vendor.rs`).
//! - A frame leaves the spool only after the archive has sent its hash:
//!   `a_frame_survives_a_restart_and_goes_only_when_it_is_released_and_old`.
//! - Of what a node recorded before its restart, only the states without a gap up to its end are evidence (`state_file.rs`,
//!   decision 0177): `nothing_counts_from_before_a_line_that_is_damaged_missing_or_of_something_else`.
//! - The hardware watchdog is fed only while the permit is valid:
//!   `it_is_fed_four_times_in_its_limit_and_only_while_the_permit_is_valid` (`common/interlock/src/watchdog.rs`).

mod announce;
mod audit_log;
mod child;
mod close_request;
mod command_check;
mod command_server;
mod deadline;
mod deciding;
pub mod driver;
mod ending;
mod guard_process;
mod guard_task;
mod has;
mod mount_clock;
mod mount_limits;
mod mount_motion;
mod mount_sight;
mod node_part;
mod now;
mod permits;
mod polling;
mod readings;
mod record;
mod second_writer;
mod serve;
mod several;
mod shared_dome;
mod shutter_status;
mod simulated;
pub mod spool;
pub mod spool_http;
mod start;
mod state_file;
mod token;
mod watchdog;

use anyhow::Context as _;
use audit::Audit;
use node::{Node, NodeOptions};
use tokio::task::JoinSet;

pub use guard_process::forget_deleted_site;

use guard_process::link::GuardLink;
use guard_process::remembered_tokens;

/// `starmesh node device`: one node, or without `--id` all device nodes of the file, each as a process of its own.
///
/// A node that serves an enclosure runs inside a guard process, which this process then is.
pub fn main(mut options: NodeOptions) -> std::process::ExitCode {
    // Before anything is read: an open enclosure is closed also when the end is ordered while this process starts.
    node::signals::listen();
    if options.check {
        return node::start::main(options, contract::Role::Device, run);
    }
    if options.guarded {
        let own = options.clone();
        return node::start::main(options, contract::Role::Device, |node| run_guarded(node, own));
    }
    if options.id.is_none() {
        match node::configuration::read_observatory(&options.config) {
            Ok(config) if config.device_nodes().len() == 1 => {
                options.id = config.device_nodes().first().and_then(|id| id.parse().ok());
            }
            // A file without devices: the node reports it.
            Ok(config) if config.device_nodes().is_empty() => {}
            Ok(_) => return several::main(&options),
            Err(_) if guard_process::is_needed(&options, config::ENCLOSURE_NODE) => {
                return several::main(&options);
            }
            // The node reports what is wrong with the file.
            Err(_) => {}
        }
    }
    if let Some(id) = options.id.clone()
        && guard_process::is_needed(&options, id.as_str())
    {
        return guard_process::main(&options, id.as_str());
    }
    let is_enclosure = options.id.as_ref().is_none_or(|id| id.as_str() == config::ENCLOSURE_NODE);
    if is_enclosure && node::configuration::read_observatory(&options.config).is_err() {
        node::lines::complain(format_args!(
            "NOBODY GUARDS the enclosure of {}: the file cannot be used, and no copy of one that worked exists",
            options.config.display()
        ));
    }
    node::start::main(options, contract::Role::Device, run)
}

/// Is enough known of the enclosure of a configuration file to close it although the file cannot be used?
pub fn closes_by_copy(config: &std::path::Path) -> bool {
    guard_process::places::Places::of(config, config::ENCLOSURE_NODE).copy().is_some()
}

/// Has anybody commanded this telescope before, as far as the guard process of one of its domes on this host remembers?
pub fn was_commanded(config: &std::path::Path, observatory: &config::Observatory) -> bool {
    let telescope = observatory.place.telescope.as_str();
    let remembers = |dome: &config::Dome| {
        let tokens = remembered_tokens(config, dome.common.node_id(contract::Kind::Dome));
        tokens.get(telescope).is_some_and(|token| *token > 0)
    };
    observatory.dome.iter().any(remembers)
}

/// Serves the devices of a node until it is stopped.
pub async fn run(node: Node) -> anyhow::Result<()> {
    serve_devices(node, None).await
}

async fn run_guarded(node: Node, options: NodeOptions) -> anyhow::Result<()> {
    serve_devices(node, Some((GuardLink::open(), options))).await
}

async fn serve_devices(node: Node, guarded: Option<(GuardLink, NodeOptions)>) -> anyhow::Result<()> {
    let part = node_part::NodePart::of(&node)?;
    simulated::check_speed(node.bus.clock(), &part.devices).await?;
    let mut tasks = JoinSet::new();
    let audit = Audit::start(&node).await?;
    let link = guarded.as_ref().map(|(link, _)| link);
    let remembered = guarded.as_ref().map(|(_, options)| remembered_tokens(&options.config, node.id.as_str()));
    let remembered = remembered.unwrap_or_default();
    let (spool, enclosures) = start::all(&node, &part, &audit, (link, remembered), &mut tasks).await?;
    let names = enclosures.iter().map(|enclosure| enclosure.name.to_string()).collect();
    tasks.spawn(ending::close_first(node.clone(), link.cloned(), enclosures));
    if let Some((link, options)) = guarded {
        tasks.spawn(ending::outlive_guard_process(node.clone(), link, options, names));
    }
    tracing::info!(devices = part.devices.len(), "serving");
    let result = loop {
        match tasks.join_next().await {
            None => break Ok(()),
            Some(Ok(Ok(()))) if node.stop.is_stopped() => {}
            // One task that ends early ends the node: a clean start beats a clever repair.
            Some(Ok(Ok(()))) => break Err(anyhow::anyhow!("a task of the device node ended by itself")),
            Some(Ok(Err(error))) => break Err(error),
            Some(Err(died)) => break Err(died).context("a task of the device node died"),
        }
    };
    if let Some(spool) = spool {
        spool.settle(std::time::Duration::from_secs(10)).await;
        tasks.shutdown().await;
        if let Err(died) = tokio::task::spawn_blocking(move || spool.sweep_at_the_end()).await {
            tracing::error!(%died, "the spool could not be swept");
        }
    } else {
        tasks.shutdown().await;
    }
    audit.end().await;
    result
}
