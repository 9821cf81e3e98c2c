//! Turns the slit of an open dome to where the telescope looks, in parallel with the rows.

use std::sync::Arc;
use std::time::Duration;

use config::Follow;
use contract::Reason;
use contract::device::dome::{Command, Shutter};

use super::note;
use super::view::{View, Way};
use crate::control_room::ControlRoom;
use crate::rig::dome::Dome;
use crate::trouble::Trouble;

/// Nothing is looked at more often.
const LEAST: Duration = Duration::from_millis(200);
/// After a turn that failed the dome is let alone for so long, each time twice as long ...
const REST: Duration = Duration::from_secs(5);
/// ... up to this.
const LONGEST_REST: Duration = Duration::from_secs(60);

/// Follows with every dome that has a slit, until the node ends.
pub async fn keep_following(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let with_slit = room.rig.domes.iter().filter(|dome| dome.follow != Follow::Off);
    futures_util::future::join_all(with_slit.map(|dome| follow(&room, dome))).await;
    std::future::pending().await
}

async fn follow(room: &ControlRoom, dome: &Dome) {
    let (mut stirred, mut aim) = (room.rig.stirred(), room.aim.subscribe());
    let mut failed = 0;
    loop {
        tokio::time::sleep(LEAST).await;
        tokio::select! {
            _ = stirred.changed() => {}
            _ = aim.changed() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        if !may_turn(room, dome) {
            continue;
        }
        let Some(view) = View::of(room, dome) else { continue };
        let turned = tokio::select! {
            biased;
            // A move that is under way is left to the closing.
            () = forbidden(room, dome) => continue,
            turned = follow_once(&view) => turned,
        };
        match turned {
            None => {}
            // A shutter that began to move, or a lease that went: no fault of the turning.
            Some(Err(Trouble::Refused { reason: Reason::WrongState | Reason::StaleToken, .. })) => {}
            Some(Ok(())) => {
                failed = 0;
                note(room, dome, &Ok(()));
            }
            Some(failure @ Err(_)) => {
                failed += 1;
                tracing::warn!(dome = %dome.instrument.device.name, failed, ?failure, "the slit was not turned");
                note(room, dome, &failure);
                stop(room, dome).await;
                tokio::time::sleep((REST * (1 << (failed - 1).min(4))).min(LONGEST_REST)).await;
            }
        }
    }
}

/// Turns once, if that is due.
async fn follow_once(view: &View<'_>) -> Option<Result<(), Trouble>> {
    match view.way()? {
        Way::Alone | Way::Itself => None,
        Way::Slave if view.is_slaved() => None,
        Way::Slave => Some(view.slave().await),
        Way::Turn => Some(view.turn(view.better(&view.aim()?)?).await),
    }
}

/// Stops a dome that still turns although its time is over: no other turn could be asked for before. The command would
/// stop a shutter too, so it is given only where none is to move.
async fn stop(room: &ControlRoom, dome: &Dome) {
    let turns = dome.instrument.fresh().is_some_and(|state| state.fields.slewing.known() == Some(&true));
    if !turns || !may_turn(room, dome) {
        return;
    }
    if let Err(trouble) = dome.instrument.ask(Command::Abort).await {
        tracing::warn!(%trouble, "a turn that does not end was not stopped");
    }
}

/// Only an open dome under a safe sky, which nothing asks to close, is turned, and only by the node that commands.
fn may_turn(room: &ControlRoom, dome: &Dome) -> bool {
    *room.robotic.borrow()
        && room.hold.borrow().token().is_some()
        && room.is_safe()
        && room.wish_closed.borrow().is_none()
        && dome.shutter() == Some(Shutter::Open)
}

/// Waits until nothing may be turned any more.
async fn forbidden(room: &ControlRoom, dome: &Dome) {
    let (mut ruling, mut wish) = (room.ruling.clone(), room.wish_closed.subscribe());
    while may_turn(room, dome) {
        tokio::select! {
            _ = ruling.changed() => {}
            _ = wish.changed() => {}
            () = tokio::time::sleep(LEAST) => {}
        }
    }
}
