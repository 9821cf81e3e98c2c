//! The closing as it runs: looks, sends what is due, and raises an alert when the truth lags.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use bus::MachineTime;
use config::CloseWithMount;
use contract::Outcome;
use contract::device::{cover_calibrator, dome, telescope};
use contract::observatory::AlertKind;
use tokio::task::JoinSet;
use units::seconds;

use super::decide::{Closing, CoverSight, DomeSight, MountSight, PARK_WAIT, Sight, Step};
use super::often::Often;
use crate::action::took_s;
use crate::control_room::ControlRoom;
use crate::hooks::AtClosing;
use crate::neighbours::Neighbours;
use crate::patience::patience;
use crate::rig::cover_calibrator::TRAVEL;
use crate::rig::telescope::Mount;
use crate::trouble::Trouble;
use schedule::plan::overheads::{Span, TOOK};

/// Closes whenever it must, until the node ends.
pub async fn keep_closed(room: Arc<ControlRoom>, neighbours: Neighbours) -> anyhow::Result<()> {
    let clock = room.node.bus.clock().clone();
    let (mut ruling, mut hold) = (room.ruling.clone(), room.hold.clone());
    let (mut wish, mut stirred) = (room.wish_closed.subscribe(), room.rig.stirred());
    let (mut closing, mut script): (Option<Closing>, AtClosing) = (None, AtClosing::default());
    let mut sent: JoinSet<(Step, Result<(), Trouble>)> = JoinSet::new();
    let mut under_way: HashSet<Step> = HashSet::new();
    let mut began_open = None;
    let mut often = Often::default();
    loop {
        let now = clock.machine();
        if let Some(why) = why_close(&room, now) {
            let sight = look(&room, &neighbours, now);
            let closing = closing.get_or_insert_with(|| {
                if !sight.is_closed() {
                    began_open = Some(clock.utc());
                    tracing::info!(why, "closing");
                    room.note_closing(&why);
                    if room.ruling.borrow().calls_for_closing(now) {
                        often.note(now, &why);
                    }
                }
                script.begin(&room, &sight, now);
                Closing::begin(now)
            });
            script.see(sight.is_closed());
            // The site's script has its moment before; the guards of the domes do not wait for it.
            let due = if script.holds(now) { Vec::new() } else { closing.due(&sight, now) };
            for step in due {
                if under_way.insert(step) {
                    let room = room.clone();
                    sent.spawn(async move { (step, send(&room, step).await) });
                }
            }
            escalate(&room, &sight, now.since(closing.began));
            if let Some(began) = began_open.take_if(|_| sight.is_closed()) {
                tracing::info!(span = Span::Close.word(), took_s = took_s(&clock, began), "{TOOK}");
            }
            if sight.is_closed() && room.wish_closed.borrow().is_some() {
                tracing::info!("verified closed");
                room.wish_closed.send_replace(None);
            }
        } else if closing.take().is_some() {
            began_open = None;
            script.end();
            calm(&room);
        }
        match often.told(clock.machine()) {
            Some(cause) => room.node.alerts.raise(AlertKind::ClosesOften, "", &cause),
            None => room.node.alerts.clear(AlertKind::ClosesOften, ""),
        }
        tokio::select! {
            Some(done) = sent.join_next() => {
                // A send that panicked leaves its step under way for ever: end, and be restarted.
                let (step, result) = done?;
                under_way.remove(&step);
                if let (Err(trouble), Some(closing)) = (result, closing.as_mut()) {
                    tracing::warn!(%trouble, "a step of the closing was not taken; it is sent again");
                    closing.refused(step, clock.machine());
                }
            }
            _ = ruling.changed() => {}
            _ = hold.changed() => {}
            _ = wish.changed() => {}
            _ = stirred.changed() => {}
            () = script.freed(clock.machine()) => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

/// Why everything must be closed now, if so.
fn why_close(room: &ControlRoom, now: MachineTime) -> Option<String> {
    if !room.may_speak() {
        // The commander closes; a standby that knows less must not shut a safe roof.
        return None;
    }
    if room.ruling.borrow().calls_for_closing(now) {
        return Some(room.ruling.borrow().why());
    }
    room.wish_closed.borrow().clone()
}

/// The devices' present states.
pub(crate) fn look(room: &ControlRoom, neighbours: &Neighbours, now: MachineTime) -> Sight {
    let sky_calls = room.ruling.borrow().calls_for_closing(now);
    let domes = room.rig.domes.iter().map(|dome| DomeSight {
        shutter: dome.shutter(),
        doubted: dome.is_doubted(),
        spared: !dome.is_own && !sky_calls && neighbours.work_under(dome, now),
        park: dome.park(!sky_calls),
    });
    let mounts = room.rig.mounts.iter().map(|mount| {
        let state = mount.instrument.fresh_reading("AtPark");
        let fields = state.as_ref().map(|state| &state.fields);
        let last = state.as_ref().and_then(|state| state.last_command.as_ref());
        MountSight {
            parked: fields.and_then(|fields| fields.at_park.known().copied()),
            slewing: fields.and_then(|fields| fields.slewing.known().copied()),
            tracking: fields.and_then(|fields| fields.tracking.known().copied()),
            cannot_park: mount.instrument.can().is_some_and(|can| !can.park),
            parking: last.is_some_and(|last| last.verb == "park" && last.outcome == Outcome::Running),
        }
    });
    let covers = room.rig.covers.iter().map(|cover| CoverSight {
        cover: cover.cover(),
        has_none: cover.instrument.can().is_some_and(|can| !can.cover),
    });
    Sight { domes: domes.collect(), mounts: mounts.collect(), covers: covers.collect() }
}

async fn send(room: &ControlRoom, step: Step) -> Result<(), Trouble> {
    let rig = &room.rig;
    match step {
        Step::CloseShutter(index) => match rig.domes.get(index) {
            Some(dome) => dome.instrument.ask(dome::Command::CloseShutter).await.map(|_| ()),
            None => Ok(()),
        },
        Step::ParkDome(index) => match rig.domes.get(index) {
            Some(dome) => dome.instrument.ask(dome::Command::Park).await.map(|_| ()),
            None => Ok(()),
        },
        Step::CloseCover(index) => match rig.covers.get(index) {
            Some(cover) => cover.instrument.ask(cover_calibrator::Command::CloseCover).await.map(|_| ()),
            None => Ok(()),
        },
        Step::StopMount(index) => {
            let Some(mount) = rig.mounts.get(index) else { return Ok(()) };
            let fields = mount.instrument.fresh().map(|state| state.fields).unwrap_or_default();
            // One after the other, since a newer command ends the one before it; each for itself, since a mount
            // that cannot abort may well park.
            if fields.slewing.known() != Some(&false) {
                stop_mount(mount, telescope::Command::Abort).await;
            }
            if fields.tracking.known() != Some(&false) {
                stop_mount(mount, telescope::Command::Track { on: false }).await;
            }
            if mount.instrument.can().is_some_and(|can| !can.park) {
                return Ok(());
            }
            mount.instrument.ask(telescope::Command::Park).await.map(|_| ())
        }
    }
}

/// Gives a stopping command a moment to be done.
async fn stop_mount(mount: &Mount, command: telescope::Command) {
    let done = async {
        let id = mount.instrument.ask(command).await?;
        mount.instrument.done(&id, "stop", Duration::from_secs(2)).await
    };
    if let Err(trouble) = done.await {
        tracing::warn!(%trouble, "the mount is parked all the same");
    }
}

/// Raises and clears the alerts of what is not closed in time.
fn escalate(room: &ControlRoom, sight: &Sight, closing_for: Duration) {
    let (alerts, clock) = (&room.node.alerts, room.node.bus.clock());
    for (dome, seen) in room.rig.domes.iter().zip(&sight.domes) {
        let name = &dome.instrument.device.name;
        let most = match dome.policy {
            CloseWithMount::Beside => patience(clock, dome.travel),
            CloseWithMount::ParkedWithinS => patience(clock, dome.travel) + dome.parked_within,
            CloseWithMount::ParkedOnly => dome.parked_within,
        };
        let most = if seen.park.is_some_and(|park| park.may_wait) { most + PARK_WAIT } else { most };
        if seen.is_closed() {
            alerts.clear(AlertKind::DomeNotClosed, name);
        } else if closing_for >= most {
            let shutter = seen.shutter.map_or("not known".to_owned(), |shutter| format!("{shutter:?}").to_lowercase());
            let cause = match seen.shutter {
                Some(dome::Shutter::Closed) => {
                    format!("{name} must be closed, and says so without proof: it was opened since")
                }
                _ => format!("{name} must be closed and is not: its shutter is {shutter}"),
            };
            alerts.raise(AlertKind::DomeNotClosed, name, &cause);
        }
    }
    for (mount, seen) in room.rig.mounts.iter().zip(&sight.mounts) {
        let name = &mount.instrument.device.name;
        if seen.is_stopped() {
            alerts.clear(AlertKind::MountNotParked, name);
        } else if closing_for >= patience(clock, seconds(mount.config.slew_timeout_s)) {
            alerts.raise(AlertKind::MountNotParked, name, &format!("{name} must be parked and is not seen to be"));
        }
    }
    for (cover, seen) in room.rig.covers.iter().zip(&sight.covers) {
        let name = &cover.instrument.device.name;
        if seen.is_closed() {
            alerts.clear(AlertKind::CoverNotClosed, name);
        } else if closing_for >= patience(clock, TRAVEL) {
            alerts.raise(AlertKind::CoverNotClosed, name, &format!("{name} must be closed and is not seen to be"));
        }
    }
}

/// Nothing calls for closing any more.
fn calm(room: &ControlRoom) {
    let rig = &room.rig;
    let domes = rig.domes.iter().map(|dome| (AlertKind::DomeNotClosed, &dome.instrument.device.name));
    let mounts = rig.mounts.iter().map(|mount| (AlertKind::MountNotParked, &mount.instrument.device.name));
    let covers = rig.covers.iter().map(|cover| (AlertKind::CoverNotClosed, &cover.instrument.device.name));
    for (kind, name) in domes.chain(mounts).chain(covers) {
        room.node.alerts.clear(kind, name);
    }
}
