//! Turns the slit of an open dome to where the telescope looks, in parallel with the rows.

use std::sync::Arc;
use std::time::Duration;

use config::Follow;
use contract::Reason;
use contract::device::dome::{Command, Shutter};

use super::view::{DomeTurner, View};
use super::{Slits, note};
use crate::action_error::ActionError;
use crate::devices::dome::Dome;

/// Nothing is looked at more often.
const LEAST: Duration = Duration::from_millis(200);
/// After a turn that failed the dome is let alone for so long, each time twice as long ...
const REST: Duration = Duration::from_secs(5);
/// ... up to this.
const LONGEST_REST: Duration = Duration::from_secs(60);

/// Follows with every dome that has a slit, until the node ends.
pub async fn keep_following(slits: Arc<Slits>) -> anyhow::Result<()> {
    let with_slit = slits.devices.domes.iter().filter(|dome| dome.follow != Follow::Off);
    futures_util::future::join_all(with_slit.map(|dome| follow(&slits, dome))).await;
    std::future::pending().await
}

async fn follow(slits: &Slits, dome: &Dome) {
    let (mut stirred, mut aim) = (slits.devices.stirred(), slits.aim.subscribe());
    let mut failed = 0;
    loop {
        tokio::time::sleep(LEAST).await;
        tokio::select! {
            _ = stirred.changed() => {}
            _ = aim.changed() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        if !may_turn(slits, dome) {
            continue;
        }
        let Some(view) = View::of(slits, dome) else { continue };
        let turned = tokio::select! {
            biased;
            // A move that is under way is left to the closing.
            () = forbidden(slits, dome) => continue,
            turned = follow_once(&view) => turned,
        };
        match turned {
            None => {}
            // A shutter that began to move, or a lease that went: no fault of the turning.
            Some(Err(
                ActionError::Superseded { .. }
                | ActionError::Refused { reason: Reason::WrongState | Reason::StaleToken, .. },
            )) => {}
            Some(Ok(())) => {
                failed = 0;
                note(slits, dome, &Ok(()));
            }
            Some(failure @ Err(_)) => {
                failed += 1;
                tracing::warn!(dome = %dome.instrument.device.name, failed, ?failure, "the slit was not turned");
                note(slits, dome, &failure);
                stop(slits, dome).await;
                tokio::time::sleep((REST * (1 << (failed - 1).min(4))).min(LONGEST_REST)).await;
            }
        }
    }
}

/// Turns once, if that is due.
async fn follow_once(view: &View<'_>) -> Option<Result<(), ActionError>> {
    match view.way()? {
        DomeTurner::Alone | DomeTurner::Itself => None,
        DomeTurner::Slave if view.is_slaved() => None,
        DomeTurner::Slave => Some(view.slave().await),
        DomeTurner::Turn => Some(view.turn(view.better(&view.aim()?)?).await),
    }
}

/// Stops a dome that still turns although its time is over: no other turn could be asked for before. The command would
/// stop a shutter too, so it is given only where none is to move.
async fn stop(slits: &Slits, dome: &Dome) {
    let turns = dome.instrument.fresh().is_some_and(|state| state.fields.slewing.known() == Some(&true));
    if !turns || !may_turn(slits, dome) {
        return;
    }
    if let Err(error) = dome.instrument.ask(Command::Abort).await {
        tracing::warn!(%error, "a turn that does not end was not stopped");
    }
}

/// Only an open dome under a safe sky, which nothing asks to close, is turned, and only by the node that commands.
fn may_turn(slits: &Slits, dome: &Dome) -> bool {
    *slits.authority.robotic.borrow()
        && slits.authority.hold.borrow().token().is_some()
        && slits.authority.is_safe()
        && slits.authority.close_request.borrow().is_none()
        && dome.shutter() == Some(Shutter::Open)
}

/// Waits until nothing may be turned any more.
async fn forbidden(slits: &Slits, dome: &Dome) {
    let (mut verdict, mut request) = (slits.authority.verdict.clone(), slits.authority.close_request.subscribe());
    while may_turn(slits, dome) {
        tokio::select! {
            _ = verdict.changed() => {}
            _ = request.changed() => {}
            () = tokio::time::sleep(LEAST) => {}
        }
    }
}
