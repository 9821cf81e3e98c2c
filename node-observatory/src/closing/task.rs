//! The closing as it runs: looks, sends what is due, and raises an alert when the truth lags.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use bus::MachineTime;
use config::CloseWithMount;
use contract::CommandOutcome;
use contract::device::{cover_calibrator, dome, telescope};
use contract::observatory::AlertKind;
use node::Node;
use schedule::plan::overheads::{TOOK, TimedPart};
use tokio::task::JoinSet;
use units::seconds;

use super::decide::{Closing, CoverSight, DomeSight, MountSight, PARK_WAIT, Sight, Step};
use super::often::Often;
use crate::action_error::ActionError;
use crate::authority::Authority;
use crate::command_timeout::command_timeout;
use crate::devices::Devices;
use crate::devices::cover_calibrator::TRAVEL;
use crate::devices::telescope::Mount;
use crate::failover::shared_roof::SharedRoofWatch;
use crate::hooks::{AtClosing, ScriptedSite};
use crate::took::took_s;

/// Closes whenever it must, until the node ends.
pub async fn keep_closed(site: Arc<ScriptedSite>, other_telescopes: SharedRoofWatch) -> anyhow::Result<()> {
    let (authority, devices) = (&site.authority, &site.devices);
    let clock = authority.node.bus.clock().clone();
    let (mut verdict, mut hold) = (authority.verdict.clone(), authority.hold.clone());
    let (mut request, mut stirred) = (authority.close_request.subscribe(), devices.stirred());
    let (mut closing, mut script): (Option<Closing>, AtClosing) = (None, AtClosing::default());
    let mut sent: JoinSet<(Step, Result<(), ActionError>)> = JoinSet::new();
    let mut under_way: HashSet<Step> = HashSet::new();
    let mut began_open = None;
    let mut often = Often::default();
    loop {
        let now = clock.machine();
        close_over_what_is_not_stopped(authority, devices);
        if let Some(why) = why_close(authority, now) {
            let sight = look(authority, devices, &other_telescopes, now);
            let closing = closing.get_or_insert_with(|| {
                if !sight.is_closed() {
                    began_open = Some(clock.utc());
                    tracing::info!(why, "closing");
                    authority.note_closing(&why);
                    if authority.verdict.borrow().calls_for_closing(now) {
                        often.note(now, &why);
                    }
                }
                script.begin(&site, sight.is_known_open(), now);
                Closing::begin(now)
            });
            script.see(sight.is_closed());
            // The site's script has its moment before; the guards of the domes do not wait for it.
            let due = if script.holds(now) { Vec::new() } else { closing.due(&sight, now) };
            for step in due {
                if under_way.insert(step) {
                    let devices = devices.clone();
                    sent.spawn(async move { (step, send(&devices, step).await) });
                }
            }
            escalate(&authority.node, devices, &sight, now.since(closing.began));
            if let Some(began) = began_open.take_if(|_| sight.is_closed()) {
                tracing::info!(span = TimedPart::Close.word(), took_s = took_s(&clock, began), "{TOOK}");
            }
            if sight.is_closed() && authority.close_request.borrow().is_some() {
                tracing::info!("verified closed");
                authority.close_request.send_replace(None);
            }
        } else if closing.take().is_some() {
            began_open = None;
            script.end();
            calm(&authority.node, devices);
        }
        match often.report(clock.machine()) {
            Some(cause) => authority.node.alerts.raise(AlertKind::ClosesOften, "", &cause),
            None => authority.node.alerts.clear(AlertKind::ClosesOften, ""),
        }
        tokio::select! {
            Some(done) = sent.join_next() => {
                // A send that panicked leaves its step under way for ever: end, and be restarted.
                let (step, result) = done?;
                under_way.remove(&step);
                if let (Err(error), Some(closing)) = (result, closing.as_mut()) {
                    tracing::warn!(%error, "a step of the closing was not taken; it is sent again");
                    closing.refused(step, clock.machine());
                }
            }
            _ = verdict.changed() => {}
            _ = hold.changed() => {}
            _ = request.changed() => {}
            _ = stirred.changed() => {}
            () = script.freed(clock.machine()) => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
    }
}

/// Why everything must be closed now, if so.
fn why_close(authority: &Authority, now: MachineTime) -> Option<String> {
    if !authority.is_publishing() {
        // The commander closes; a standby that knows less must not shut a safe roof.
        return None;
    }
    if authority.verdict.borrow().calls_for_closing(now) {
        return Some(authority.verdict.borrow().why());
    }
    authority.close_request.borrow().clone()
}

/// A mount that its device node could neither stop nor park at a limit: everything is closed, and a person is needed.
fn close_over_what_is_not_stopped(authority: &Authority, devices: &Devices) {
    if !authority.is_publishing() {
        return;
    }
    let not_stopped = devices.mounts.iter().find_map(|mount| {
        let beyond = mount.is_stopped_for().filter(|beyond| beyond.not_stopped)?;
        Some(format!("{} does not stop at its limit: {}", mount.instrument.device.name, beyond.why))
    });
    let Some(why) = not_stopped else { return };
    authority.close_request.send_if_modified(|request| {
        let is_new = request.is_none();
        request.get_or_insert(why);
        is_new
    });
}

/// The devices' present states.
pub(crate) fn look(
    authority: &Authority,
    devices: &Devices,
    other_telescopes: &SharedRoofWatch,
    now: MachineTime,
) -> Sight {
    let sky_calls = authority.verdict.borrow().calls_for_closing(now);
    let domes = devices.domes.iter().map(|dome| DomeSight {
        shutter: dome.shutter(),
        doubted: dome.is_doubted(),
        spared: !dome.is_own && !sky_calls && other_telescopes.work_under(dome, now),
        park: dome.park(!sky_calls),
    });
    let mounts = devices.mounts.iter().map(|mount| {
        let state = mount.instrument.fresh_reading("AtPark");
        let fields = state.as_ref().map(|state| &state.fields);
        let last = state.as_ref().and_then(|state| state.last_command.as_ref());
        let park = last.filter(|last| last.verb == "park").map(|last| &last.outcome);
        let tells = fields.is_none_or(|fields| !fields.at_park.is_refused());
        MountSight {
            parked: fields.and_then(telescope::Fields::parked),
            parked_unseen: !tells && park == Some(&CommandOutcome::Done),
            slewing: fields.and_then(|fields| fields.slewing.known().copied()),
            tracking: fields.and_then(|fields| fields.tracking.known().copied()),
            cannot_park: mount.instrument.can().is_some_and(|can| !can.park),
            parking: park == Some(&CommandOutcome::Running),
        }
    });
    let covers = devices.covers.iter().map(|cover| CoverSight {
        cover: cover.cover(),
        has_none: cover.instrument.can().is_some_and(|can| !can.cover),
    });
    Sight { domes: domes.collect(), mounts: mounts.collect(), covers: covers.collect() }
}

async fn send(devices: &Devices, step: Step) -> Result<(), ActionError> {
    match step {
        Step::CloseShutter(index) => match devices.domes.get(index) {
            Some(dome) => dome.instrument.ask(dome::Command::CloseShutter).await.map(|_| ()),
            None => Ok(()),
        },
        Step::ParkDome(index) => match devices.domes.get(index) {
            Some(dome) => dome.instrument.ask(dome::Command::Park).await.map(|_| ()),
            None => Ok(()),
        },
        Step::CloseCover(index) => match devices.covers.get(index) {
            Some(cover) => cover.instrument.ask(cover_calibrator::Command::CloseCover).await.map(|_| ()),
            None => Ok(()),
        },
        Step::StopMount(index) => {
            let Some(mount) = devices.mounts.get(index) else { return Ok(()) };
            let fields = mount.instrument.fresh().map(|state| state.fields).unwrap_or_default();
            // One after the other, since a newer command ends the one before it; each for itself, since a mount
            // that cannot abort may well park.
            // One that says that it is parked while it slews is on its way there: an abort would leave it elsewhere.
            if fields.slewing.known() != Some(&false) && fields.at_park.known() != Some(&true) {
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
    if let Err(error) = done.await {
        tracing::warn!(%error, "the mount is parked all the same");
    }
}

/// Raises and clears the alerts of what is not closed in time.
fn escalate(node: &Node, devices: &Devices, sight: &Sight, closing_for: Duration) {
    let (alerts, clock) = (&node.alerts, node.bus.clock());
    for (dome, seen) in devices.domes.iter().zip(&sight.domes) {
        let name = &dome.instrument.device.name;
        let most = match dome.policy {
            CloseWithMount::Alongside => command_timeout(clock, dome.travel),
            CloseWithMount::ParkedWithinS => command_timeout(clock, dome.travel) + dome.parked_within,
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
    for (mount, seen) in devices.mounts.iter().zip(&sight.mounts) {
        let name = &mount.instrument.device.name;
        if seen.is_stopped() {
            alerts.clear(AlertKind::MountNotParked, name);
        } else if closing_for >= command_timeout(clock, seconds(mount.config.slew_timeout_s)) {
            alerts.raise(AlertKind::MountNotParked, name, &format!("{name} must be parked and is not seen to be"));
        }
    }
    for (cover, seen) in devices.covers.iter().zip(&sight.covers) {
        let name = &cover.instrument.device.name;
        if seen.is_closed() {
            alerts.clear(AlertKind::CoverNotClosed, name);
        } else if closing_for >= command_timeout(clock, TRAVEL) {
            alerts.raise(AlertKind::CoverNotClosed, name, &format!("{name} must be closed and is not seen to be"));
        }
    }
}

/// Nothing calls for closing any more.
fn calm(node: &Node, devices: &Devices) {
    let domes = devices.domes.iter().map(|dome| (AlertKind::DomeNotClosed, &dome.instrument.device.name));
    let mounts = devices.mounts.iter().map(|mount| (AlertKind::MountNotParked, &mount.instrument.device.name));
    let covers = devices.covers.iter().map(|cover| (AlertKind::CoverNotClosed, &cover.instrument.device.name));
    for (kind, name) in domes.chain(mounts).chain(covers) {
        node.alerts.clear(kind, name);
    }
}
