//! The device node: bridges ASCOM Alpaca devices to the bus.
//!
//! One reading's way: `alpaca` asks the server and forgives what is sloppy; a `driver` (one file per ASCOM kind,
//! pure mapping) says which properties matter and what they mean; `serve`, the one loop for all kinds, polls,
//! publishes, obeys and reconnects. One command's way: `front` answers it at once, after `gate` has looked at its
//! token and `guard` at the permits; the loop does it, and the device's own state shows when it is done.
//!
//! Frames go to the `spool` on disk, are announced, served by HTTP, and removed when the archive releases them.
//! The dome's `guard` stands beside all this: a pure state machine with a task and a connection of its own.

mod accounts;
pub mod alpaca;
mod announce;
mod contact;
mod deadline;
pub mod driver;
mod front;
mod gate;
pub mod guard;
mod guard_task;
mod has;
mod holder;
mod mount_limits;
mod mount_watch;
mod node_part;
mod permits;
mod readings;
mod record;
mod second_writer;
mod serve;
mod shared_dome;
mod simulated;
pub mod spool;
pub mod spool_http;
mod start;
mod token;
mod watchdog;

pub use alpaca::discovery::{Found, as_toml, discover};

use anyhow::Context as _;
use audit::Audit;
use bus::Node;
use tokio::task::JoinSet;

/// Serves the devices of a node until it is stopped.
pub async fn run(node: Node) -> anyhow::Result<()> {
    let part = node_part::NodePart::of(&node)?;
    simulated::check_speed(node.bus.clock(), &part.devices).await?;
    let mut tasks = JoinSet::new();
    let audit = Audit::start(&node).await?;
    let spool = start::all(&node, &part, &audit, &mut tasks).await?;
    tracing::info!(devices = part.devices.len(), "serving");
    let result = loop {
        match tasks.join_next().await {
            None => break Ok(()),
            Some(Ok(Ok(()))) if node.stop.is_stopped() => {}
            // one task that ends early ends the node: a clean start beats a clever repair
            Some(Ok(Ok(()))) => break Err(anyhow::anyhow!("a task of the device node ended by itself")),
            Some(Ok(Err(error))) => break Err(error),
            Some(Err(died)) => break Err(died).context("a task of the device node died"),
        }
    };
    if let Some(spool) = spool {
        spool.settle(std::time::Duration::from_secs(10)).await;
    }
    tasks.shutdown().await;
    audit.end().await;
    result
}
