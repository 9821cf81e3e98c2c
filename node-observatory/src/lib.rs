//! The observatory node: runs one telescope.
//!
//! It judges whether the sky is safe ([`safety`]), says so once a second to every dome's guard ([`permit`]), holds
//! the right to command ([`lease`]), works through the schedule ([`runner`], [`action`]) while the sky allows, and
//! closes ([`closing`]) when it does not, when people order it ([`order`]), and at the night's end. Each of these is
//! a task of its own; they meet in the [`control_room`]. The safety loop waits for none of them.

pub mod action;
mod alerting;
pub mod annunciator;
pub mod closing;
pub mod control_room;
pub mod journal;
pub mod lease;
mod ledger;
mod neighbours;
mod night;
mod opening;
mod order;
mod patience;
pub mod permit;
pub mod rig;
pub mod runner;
pub mod safety;
pub mod schedule;
mod slit;
pub mod standing;
mod start;
mod takeover;
mod trouble;

use anyhow::{Context as _, bail};
use bus::Node;
use tokio::task::JoinSet;

pub use trouble::Trouble;

/// Runs the telescope until the node is told to stop.
///
/// A task that ends early ends the node, which is then started afresh; meanwhile the guards of the domes, hearing
/// no permit, close.
pub async fn run(node: Node) -> anyhow::Result<()> {
    let start::Start { room, ruling, hold, loaded, neighbours } = start::start(&node).await?;
    let (schedule, audit) = (loaded.subscribe(), room.audit.clone());
    let mut tasks: JoinSet<(&str, anyhow::Result<()>)> = JoinSet::new();
    let mut run = |name, task: start::Task| tasks.spawn(async move { (name, task.await) });

    let (rules, standing) = (room.rules.clone(), room.standing.subscribe());
    run("safety", Box::pin(safety::task::keep_judging(node.clone(), rules, standing, ruling)));
    run("closing", Box::pin(closing::keep_closed(room.clone(), neighbours.clone())));
    run("lease", Box::pin(lease::keep_holding(room.clone(), hold)));
    run("permit", Box::pin(permit::keep_renewing(room.clone())));
    run("standing orders", Box::pin(standing::keep_reminding(room.clone())));
    run("standing orders on disk", Box::pin(standing::keep_on_disk(room.clone())));
    run("orders", Box::pin(order::keep_answering(room.clone())));
    run("schedule", Box::pin(schedule::keep_reading(node.clone(), loaded, room.reload.subscribe())));
    run("runner", Box::pin(runner::keep_observing(room.clone(), schedule)));
    run("dome slits", Box::pin(slit::keep_following(room.clone())));
    run("frames", Box::pin(ledger::keep_counting_frames(room.clone())));
    run("files", Box::pin(ledger::keep_counting_files(room.clone())));
    run("neighbours", Box::pin(neighbours.keep_hearing(node.clone())));
    run("tell safety", Box::pin(night::keep_telling_safety(room.clone())));
    run("tell night", Box::pin(night::keep_telling_night(room.clone())));
    run("tell schedule", Box::pin(night::keep_telling_schedule(room.clone())));
    run("tell the rest", Box::pin(night::keep_telling_the_rest(room.clone())));
    let pinging = room.clone();
    let is_well = move || pinging.is_judging() && pinging.may_speak();
    let alerts = room.alerts.subscribe();
    run("ping", Box::pin(notify::keep_pinging(node.clone(), is_well)));
    run("alerts out", Box::pin(notify::keep_sending(node.clone(), alerts)));
    run("silent nodes", Box::pin(alerting::keep_noticing_silence(room.clone())));
    run("alerts", Box::pin(alerting::keep_merging(room)));

    let ended = node.stop.or(tasks.join_next()).await;
    tasks.shutdown().await;
    audit.end().await;
    let Some(ended) = ended else { return Ok(()) };
    match ended {
        Some(Ok((name, result))) => {
            result.with_context(|| format!("the task {name:?} failed"))?;
            bail!("the task {name:?} ended")
        }
        Some(Err(error)) => Err(error).context("a task was lost"),
        None => bail!("there are no tasks"),
    }
}
