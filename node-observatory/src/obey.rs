//! What a person's order does.
//!
//! An order that closes, or makes the verdict stricter, acts at once, whatever the disk does. Any other that is to
//! survive this node is on disk before it acts, and refused where the disk fails.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use contract::device::camera::Command as Cooler;
use contract::observatory::AlertKind;
use contract::{Accepted, CommandId, Order, OrderKind, Reason, Refusal, Reply};
use safety::annunciator::Annunciator;
use safety::said::Said;
use safety::standing::Standing;

use crate::control_room::ControlRoom;
use crate::kept::Unchanged;
use crate::schedule_file;
use crate::schedule_file::versions::Author;
use crate::standing_line;

/// An order that acted at once is answered when it is on disk and on the bus too, or after this.
const SETTLED: Duration = Duration::from_secs(1);

/// A set point that is corrected at once waits so long for the camera to end the one before it; an exposure may last.
const COOLER_TURN: Duration = Duration::from_secs(5);

/// Counts the orders that closed or made something stricter: what was ordered before and is still being written must
/// not undo them.
#[derive(Debug, Default)]
pub struct Tightened(AtomicU64);

impl Tightened {
    fn note(&self) {
        self.0.fetch_add(1, Ordering::SeqCst);
    }

    /// A check that nothing was tightened since now.
    fn watch(&self) -> impl Fn() -> Result<(), String> {
        let before = self.0.load(Ordering::SeqCst);
        move || {
            let same = self.0.load(Ordering::SeqCst) == before;
            if same { Ok(()) } else { Err("somebody ordered to be closed, or stricter, meanwhile".to_owned()) }
        }
    }
}

/// Does this order act before the disk has it?
pub fn acts_at_once(kind: &OrderKind) -> bool {
    match kind {
        OrderKind::Close | OrderKind::ReloadSchedule => true,
        OrderKind::Robotic(on) => !on,
        OrderKind::StayClosed(on) => *on,
        OrderKind::Override { for_s, .. } => *for_s == 0.0,
        OrderKind::Acknowledge(_)
        | OrderKind::Shelve { .. }
        | OrderKind::Unshelve(_)
        | OrderKind::PutSchedule { .. }
        | OrderKind::Cool { .. }
        | OrderKind::Warm(_) => false,
    }
}

/// Follows an order that acts at once.
pub fn at_once(room: &Arc<ControlRoom>, tightened: &Tightened, order: &Order) -> Reply {
    tell(order);
    match &order.kind {
        OrderKind::Robotic(_) => {
            tightened.note();
            robotic_off(room, "the robotic switch was turned off");
        }
        OrderKind::Close => {
            tightened.note();
            let why = format!("{} ordered it", order.from);
            robotic_off(room, &why);
            // Also when it was off already.
            room.wish_closed.send_replace(Some(why));
        }
        OrderKind::ReloadSchedule => room.reload.send_modify(|count| *count += 1),
        OrderKind::StayClosed(_) => {
            tightened.note();
            let said = said(room, order);
            room.standing.change(|standing| standing.stay_closed.replace(said.clone()) != Some(said));
        }
        OrderKind::Override { input, .. } => {
            let mut heeded = Ok(());
            room.standing.change(|standing| {
                heeded = standing.do_without(&room.rules, input, 0.0, said(room, order));
                heeded.is_ok()
            });
            if let Err(why) = heeded {
                return refuse(&order.id, Reason::Malformed, &why);
            }
            tightened.note();
        }
        OrderKind::Acknowledge(_)
        | OrderKind::Shelve { .. }
        | OrderKind::Unshelve(_)
        | OrderKind::PutSchedule { .. }
        | OrderKind::Cool { .. }
        | OrderKind::Warm(_) => {}
    }
    accept(&order.id)
}

/// Waits a moment until what acted at once is on disk and on the bus.
pub async fn settle(room: &ControlRoom) {
    let settled = async {
        room.standing.on_disk().await;
        let mut said = room.standing_said.subscribe();
        // The sender lives in the room, so waiting cannot fail.
        let _ = said.wait_for(|said| said.as_ref().is_some_and(|said| *said == standing_line::orders(room))).await;
    };
    let _ = tokio::time::timeout(SETTLED, settled).await;
}

/// Follows an order that is on disk before it acts.
pub async fn when_written(room: &Arc<ControlRoom>, tightened: &Tightened, order: &Order) -> Reply {
    tell(order);
    let still = tightened.watch();
    let told = said(room, order);
    let done = match &order.kind {
        OrderKind::Robotic(_) => turn_robotic_on(room, &still).await,
        OrderKind::StayClosed(_) => {
            change(room, &still, |standing| {
                standing.stay_closed = None;
                Ok(())
            })
            .await
        }
        OrderKind::Override { input, for_s } => {
            change(room, &still, |standing| standing.do_without(&room.rules, input, *for_s, told.clone())).await
        }
        OrderKind::Acknowledge(id) => about_alerts(room, |alerts| alerts.acknowledge(id, &told)).await,
        OrderKind::Shelve { alert, for_s } => {
            about_alerts(room, |alerts| alerts.shelve(alert, *for_s, told.clone())).await
        }
        OrderKind::Unshelve(id) => about_alerts(room, |alerts| alerts.unshelve(id)).await,
        OrderKind::PutSchedule { text } => {
            let author = Author { name: order.from.clone(), reason: order.reason.clone() };
            schedule_file::put(room, text, author).await
        }
        OrderKind::Cool { camera, set_c } => cooler(room, camera, |config| match set_c.or(config.temperature_c) {
            Some(set_c) if (-273.15..=100.0).contains(&set_c) => Ok(Cooler::Cool { set_c }),
            Some(set_c) => Err(format!("a set point of {set_c} C: expected -273.15 to 100")),
            None => Err(format!(
                "{camera} has no temperature_c in its configuration: add the set point to the order (--temperature-c)"
            )),
        })
        .await,
        OrderKind::Warm(camera) => cooler(room, camera, |_| Ok(Cooler::Warm)).await,
        OrderKind::Close | OrderKind::ReloadSchedule => Ok(()),
    };
    match done {
        Ok(()) => accept(&order.id),
        Err(Unchanged::Refused(why)) => {
            let reason = if still().is_ok() { Reason::Malformed } else { Reason::NotNow };
            refuse(&order.id, reason, &why)
        }
        Err(failed @ Unchanged::Disk { .. }) => refuse(&order.id, Reason::NotNow, &failed.to_string()),
    }
}

async fn change(
    room: &ControlRoom,
    still: impl Fn() -> Result<(), String>,
    does: impl Fn(&mut Standing) -> Result<(), String>,
) -> Result<(), Unchanged> {
    let changed = room.standing.change_when_written(|standing| still().and_then(|()| does(standing)));
    changed.await
}

async fn about_alerts(
    room: &ControlRoom,
    does: impl Fn(&mut Annunciator) -> Result<(), String>,
) -> Result<(), Unchanged> {
    room.annunciator.change_when_written(does).await
}

/// Gives a camera's cooler a command, and answers once the camera's node has taken it.
async fn cooler(
    room: &ControlRoom,
    camera: &str,
    command: impl Fn(&config::Camera) -> Result<Cooler, String>,
) -> Result<(), Unchanged> {
    let cameras = &room.rig.cameras;
    let Some(found) = cameras.iter().find(|known| known.config.common.name.as_str() == camera) else {
        let names = cameras.iter().map(|known| known.config.common.name.as_str());
        return Err(Unchanged::Refused(format!("no camera is named {camera:?}: {}", schedule::meant(camera, names))));
    };
    let command = command(&found.config).map_err(Unchanged::Refused)?;
    let taken = found.instrument.ask_within(&CommandId::fresh(), command, COOLER_TURN).await;
    taken.map_err(|trouble| Unchanged::Refused(trouble.to_string()))
}

async fn turn_robotic_on(room: &Arc<ControlRoom>, still: impl Fn() -> Result<(), String>) -> Result<(), Unchanged> {
    let at = room.clone();
    let written = tokio::task::spawn_blocking(move || at.journal.robotic(true, at.node.bus.clock().utc())).await;
    let written = written.map_err(std::io::Error::other).and_then(|written| written);
    written.map_err(|source| Unchanged::Disk { path: "the journal".to_owned(), source })?;
    if let Err(why) = still() {
        note_off(room);
        return Err(Unchanged::Refused(why));
    }
    room.robotic.send_replace(true);
    Ok(())
}

/// Turns the switch off; that closes what it had opened.
pub fn robotic_off(room: &Arc<ControlRoom>, why: &str) {
    if room.robotic.send_replace(false) {
        room.wish_closed.send_replace(Some(why.to_owned()));
        note_off(room);
    }
}

/// Records that the switch is off, in parallel with all else.
fn note_off(room: &Arc<ControlRoom>) {
    let room = room.clone();
    tokio::task::spawn_blocking(move || match room.journal.robotic(false, room.node.bus.clock().utc()) {
        Ok(()) => room.node.alerts.clear(AlertKind::Journal, ""),
        Err(error) => {
            let cause = format!("the robotic switch is off, and a restart will not know it: {error}");
            room.node.alerts.raise(AlertKind::Journal, "", &cause);
        }
    });
}

fn tell(order: &Order) {
    tracing::info!(from = order.from, kind = ?brief(&order.kind), reason = order.reason, "order");
}

/// An order in short for a line of text: of a schedule only its length, because the versions hold the text.
pub fn brief(kind: &OrderKind) -> OrderKind {
    match kind {
        OrderKind::PutSchedule { text } => OrderKind::PutSchedule { text: format!("{} bytes", text.len()) },
        short => short.clone(),
    }
}

/// The person who gave the order, the reason, and the present time.
pub fn said(room: &ControlRoom, order: &Order) -> Said {
    Said { from: order.from.clone(), reason: order.reason.clone(), at_utc: room.node.bus.clock().utc() }
}

fn accept(id: &CommandId) -> Reply {
    Reply::Accepted(Accepted { id: id.clone(), token: None })
}

/// A refusal, for people and programs.
pub fn refuse(id: &CommandId, reason: Reason, detail: &str) -> Reply {
    Reply::Refusal(Refusal { id: id.clone(), reason, detail: detail.to_owned() })
}
