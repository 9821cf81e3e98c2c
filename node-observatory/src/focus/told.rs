//! Publishes the focus while no run is under way, and the runs that have ended.

use std::sync::Arc;
use std::time::Duration;

use bus::{Catch, Quality};
use contract::observatory::{FocusLearnt, FocusRun, FocuserFocus};
use contract::{Key, Part};
use tokio::sync::{mpsc, watch};

use super::Learnt;
use crate::control_room::ControlRoom;
use crate::night;
use crate::rig::focuser::Focuser;

/// The best positions are looked at again so often, machine time.
const PERIOD: Duration = Duration::from_secs(1);
/// Runs that are kept on the bus for archives and standbys that were away.
const RECOVERABLE: usize = 100;
/// Runs that wait to be looked at.
const WAITING: usize = 256;
/// Published temperatures are rounded to this, degrees: the readings jitter.
const TEMPERATURE_STEP_C: f64 = 0.1;

/// Keeps the published state of each focuser true.
pub async fn keep_showing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    loop {
        let focusers: Vec<FocuserFocus> = room.rig.focusers.iter().map(|focuser| known(&room, focuser)).collect();
        room.focus.send_if_modified(|shown| {
            let best_position = focusers.first().and_then(|focuser| focuser.best_position);
            let is_new = shown.focusers != focusers || shown.best_position != best_position;
            if shown.detail.is_empty() {
                shown.detail = "no focus run since this node started".to_owned();
            }
            (shown.focusers, shown.best_position) = (focusers, best_position);
            is_new
        });
        tokio::time::sleep(PERIOD).await;
    }
}

fn known(room: &ControlRoom, focuser: &Focuser) -> FocuserFocus {
    let learnt = room.focus_learnt.get();
    let model = learnt.model(focuser.name());
    let temperature_c = focuser.temperature_c().map(|c| (c / TEMPERATURE_STEP_C).round() * TEMPERATURE_STEP_C);
    FocuserFocus {
        focuser: focuser.name().to_owned(),
        best_position: focuser.best(),
        // Without the digits of the multiplication.
        temperature_c: temperature_c.map(|c| (c * 1000.0).round() / 1000.0),
        runs: u32::try_from(learnt.runs(focuser.name()).len()).unwrap_or(u32::MAX),
        steps_per_c: model.map(|model| model.steps_per_c.value),
        steps_per_c_error: model.map(|model| model.steps_per_c.error).filter(|error| error.is_finite()),
    }
}

/// Publishes each run once more when it has ended; a node that was away can recover them.
pub async fn keep_telling_runs(
    room: Arc<ControlRoom>,
    mut runs: mpsc::UnboundedReceiver<FocusRun>,
) -> anyhow::Result<()> {
    let key = Key::FocusRun(room.node.config.address());
    let line = room.node.bus.publisher::<FocusRun>(&key, Quality::Event { cache: RECOVERABLE }).await?;
    while let Some(run) = runs.recv().await {
        line.put(run).await?;
    }
    // The sender lives in the room.
    std::future::pending().await
}

/// Learns from the runs of another incarnation or node, so that a standby goes on with what the commander has found.
pub async fn keep_hearing_runs(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let key = Key::FocusRun(room.node.config.address());
    let runs = room.node.bus.subscribe::<FocusRun>(&key.to_string(), Catch::All, WAITING).await?;
    loop {
        let heard = runs.hear().await;
        if heard.said.boot_id != *room.node.bus.boot_id() {
            room.focus_learnt.change(|learnt| learnt.learn(&heard.said.body));
        }
    }
}

/// Publishes what runs have taught at each change and every 10 s. It includes runs of earlier incarnations, whose
/// events are no longer published.
pub async fn keep_telling_learnt(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let key = room.key(Part::FocusLearnt);
    let line = room.node.bus.publisher::<FocusLearnt>(&key, Quality::State { cache: 1 }).await?;
    let mut learnt = room.focus_learnt.subscribe();
    let (tell, told) = watch::channel(learnt.borrow_and_update().told());
    tokio::try_join!(follow(learnt, tell), night::keep_saying(&room, &line, told))?;
    Ok(())
}

async fn follow(mut learnt: watch::Receiver<Learnt>, tell: watch::Sender<FocusLearnt>) -> anyhow::Result<()> {
    loop {
        learnt.changed().await?;
        tell.send_replace(learnt.borrow_and_update().told());
    }
}

/// Takes over what the commander has learned for as long as this node stands by, so that its first row begins in focus.
pub async fn keep_hearing_learnt(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut told = room.node.bus.latest::<FocusLearnt>(&room.key(Part::FocusLearnt)).await?;
    loop {
        told.changed().await;
        let own = room.node.bus.boot_id();
        let Some(heard) = told.get().filter(|heard| heard.said.boot_id != *own) else { continue };
        if !room.may_speak() {
            // Written to this node's own disk once it commands.
            room.focus_learnt.change(|learnt| learnt.adopt(heard.said.body));
        }
    }
}
