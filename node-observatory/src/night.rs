//! The published state of the night: posture, actions under way, the rows of the schedule.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use contract::device::dome::Shutter;
use contract::observatory::{
    ActionNow, NightState, OrderTaken, Posture, RowState, RowStatus, ScheduleState, Trigger, TriggerKind,
};
use contract::{CommandId, Part};
use node::StandingAlerts;
use orders::RecentStates;
use tokio::sync::watch;
use units::Utc;

use crate::authority::Authority;
use crate::devices::Devices;
use crate::devices::dome::Dome;
use crate::expected::overdue;
use crate::publishing::{LEAST, publish};
use crate::tasks::Tasks;

/// What the runner and the actions write and the publishers read.
#[derive(Debug)]
pub struct PublishedNight {
    tonight: watch::Sender<Tonight>,
    schedule: watch::Sender<ScheduleState>,
    /// The present places of rows that began at another one; `None` for rows that have no place any more.
    moved: Mutex<BTreeMap<u32, Option<u32>>>,
    /// When which state was published; an order names one of them.
    pub states: RecentStates,
}

#[derive(Debug, Clone, Default)]
struct Tonight {
    /// By the place in the schedule at which their rows began.
    actions: BTreeMap<u32, ActionNow>,
    frames: u64,
    last_frame: Option<CommandId>,
    triggers: Vec<Trigger>,
    ended: bool,
    last_order: Option<OrderTaken>,
}

impl PublishedNight {
    /// An empty status for a schedule file.
    pub fn new(file: String) -> Self {
        let (refused, sha256, rows, findings) = Default::default();
        let schedule = ScheduleState { file, revision: 0, refused, sha256, rows, findings };
        let (tonight, schedule) = (watch::channel(Tonight::default()).0, watch::channel(schedule).0);
        Self { tonight, schedule, moved: Mutex::default(), states: RecentStates::default() }
    }

    /// An action begins.
    pub fn begin(&self, action: ActionNow) {
        self.tonight.send_modify(|tonight| {
            tonight.actions.insert(action.row, action);
        });
    }

    /// What an action does now, in words, and by when that should have ended.
    pub fn step(&self, row: u32, step: String, expected_by: Option<Utc>) {
        self.tonight.send_modify(|tonight| {
            if let Some(action) = tonight.actions.get_mut(&row) {
                (action.step, action.expected_by_utc) = (step, expected_by);
            }
        });
    }

    /// An action is over; `row` is where it began.
    pub fn end(&self, row: u32) {
        self.moved().remove(&row);
        self.tonight.send_modify(|tonight| {
            tonight.actions.remove(&row);
        });
    }

    /// A frame was announced.
    pub fn frame(&self, frame: &CommandId) {
        self.tonight.send_modify(|tonight| {
            tonight.frames += 1;
            tonight.last_frame = Some(frame.clone());
        });
    }

    /// What the newest frames show together.
    pub fn triggers(&self, triggers: Vec<Trigger>) {
        self.tonight.send_if_modified(|tonight| {
            let is_new = tonight.triggers != triggers;
            tonight.triggers = triggers;
            is_new
        });
    }

    /// Since when one of these stands for a camera and filter, if it does.
    pub fn trigger(&self, kind: TriggerKind, camera: &str, filter: Option<&str>) -> Option<Utc> {
        let tonight = self.tonight.borrow();
        let mut active = tonight.triggers.iter();
        let is_it = |t: &&Trigger| t.kind == kind && t.camera == camera && t.filter.as_deref() == filter;
        active.find(is_it).map(|trigger| trigger.since_utc)
    }

    /// An order was accepted.
    pub fn order(&self, taken: OrderTaken) {
        self.tonight.send_modify(|tonight| tonight.last_order = Some(taken));
    }

    /// The last row has ended and everything is closed, or that is over.
    pub fn set_ended(&self, ended: bool) {
        self.tonight.send_if_modified(|tonight| std::mem::replace(&mut tonight.ended, ended) != ended);
    }

    /// Changes the published state of the schedule.
    pub fn schedule(&self, change: impl FnOnce(&mut ScheduleState)) {
        self.schedule.send_modify(change);
    }

    /// The schedule whose rows are shown, by the SHA-256 of its text, and how far the row at a place of it is.
    pub fn shown(&self, row: u32) -> (Option<String>, Option<RowStatus>) {
        let schedule = self.schedule.borrow();
        let state = usize::try_from(row).ok().and_then(|index| schedule.rows.get(index));
        (schedule.sha256.clone(), state.map(|state| state.status))
    }

    /// Shows why the newest schedule was not taken, or that it was.
    pub fn schedule_refused(&self, refused: &Option<String>) {
        self.schedule.send_if_modified(|schedule| {
            let changed = schedule.refused != *refused;
            schedule.refused.clone_from(refused);
            changed
        });
    }

    /// A row that is at work and began at one place of the schedule is at another one now, or nowhere any more.
    pub fn moved_to(&self, began: u32, now: Option<u32>) {
        self.moved().insert(began, now);
        self.tonight.send_if_modified(|tonight| {
            let (Some(action), Some(now)) = (tonight.actions.get_mut(&began), now) else { return false };
            std::mem::replace(&mut action.row, now) != now
        });
    }

    fn moved(&self) -> MutexGuard<'_, BTreeMap<u32, Option<u32>>> {
        self.moved.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the published state of a row at work, wherever it is now; `began` is where it began.
    pub fn row(&self, began: u32, change: impl FnOnce(&mut RowState)) {
        let now = self.moved().get(&began).copied().unwrap_or(Some(began));
        if let Some(now) = now {
            self.at(now, change);
        }
    }

    /// Changes the published state of the row at a place of the schedule in force.
    pub fn at(&self, row: u32, change: impl FnOnce(&mut RowState)) {
        self.schedule.send_if_modified(|schedule| {
            let index = usize::try_from(row).unwrap_or(usize::MAX);
            let Some(state) = schedule.rows.get_mut(index) else { return false };
            let before = state.clone();
            change(state);
            *state != before
        });
    }
}

const SECOND: Duration = Duration::from_secs(1);

/// Starts the tasks that publish the night.
pub fn start(
    tasks: &mut Tasks,
    authority: &Arc<Authority>,
    devices: &Arc<Devices>,
    published_night: &Arc<PublishedNight>,
) {
    tasks.spawn("publish safety", keep_publishing_safety(authority.clone()));
    tasks.spawn("publish night", keep_publishing_night(authority.clone(), devices.clone(), published_night.clone()));
    tasks.spawn("publish schedule", keep_publishing_schedule(authority.clone(), published_night.clone()));
}

/// Publishes the night each second and at each change.
async fn keep_publishing_night(
    authority: Arc<Authority>,
    devices: Arc<Devices>,
    published_night: Arc<PublishedNight>,
) -> anyhow::Result<()> {
    let night = authority.node.bus.publisher::<NightState>(&authority.key(Part::Night)).await?;
    let clock = authority.node.bus.clock().clone();
    let (mut tonight, mut stirred) = (published_night.tonight.subscribe(), devices.stirred());
    let mut robotic = authority.robotic.subscribe();
    let (mut open_s, mut looked) = (0.0, clock.sky());
    let mut was = Posture::Unknown;
    let (mut published_at, mut touched) = (None, true);
    let mut overdue_steps = StandingAlerts::default();
    loop {
        let posture = posture(&devices);
        let now = clock.sky();
        if was == Posture::Open {
            open_s += now.since(looked).as_secs_f64();
        }
        if was != posture {
            tracing::info!(from = ?was, to = ?posture, "posture");
        }
        looked = now;
        touched |= was != posture;
        was = posture;
        let due = published_at.is_none_or(|at| clock.machine().since(at) >= SECOND - LEAST * 2);
        overdue_steps.keep(overdue(tonight.borrow().actions.values(), clock.utc()), &authority.node.alerts);
        if (touched || due) && authority.is_publishing() {
            let published = tonight.borrow_and_update().clone();
            let robotic_now = *robotic.borrow();
            published_night.states.note(night.next_seq(), clock.machine());
            night
                .put(NightState {
                    robotic: robotic_now,
                    posture,
                    actions: published.actions.into_values().collect(),
                    frames: published.frames,
                    open_s,
                    speed: clock.speed(),
                    simulated: clock.is_simulated(),
                    ended: published.ended,
                    last_frame: published.last_frame,
                    triggers: published.triggers,
                    last_order: published.last_order,
                })
                .await?;
            published_at = Some(clock.machine());
        }
        tokio::time::sleep(LEAST).await;
        touched = tokio::select! {
            changed = tonight.changed() => changed.map(|()| true)?,
            changed = robotic.changed() => changed.map(|()| true)?,
            _ = stirred.changed() => false,
            () = clock.tick(SECOND) => false,
        };
    }
}

/// The posture of the observatory by the states of its enclosures; a telescope without one is closed when parked.
pub fn posture(devices: &Devices) -> Posture {
    if devices.domes.is_empty() {
        let parked = devices
            .mounts
            .iter()
            .map(|mount| mount.instrument.fresh().and_then(|state| state.fields.at_park.known().copied()));
        return of_parks(parked);
    }
    // A dome whose status is closed without proof is not known to be closed.
    let shutter = |dome: &Dome| dome.shutter().filter(|shutter| *shutter != Shutter::Closed || !dome.is_doubted());
    let each = devices.domes.iter().map(|dome| Posture::of_shutter(shutter(dome)));
    Posture::least_closed(each).unwrap_or(Posture::Closed)
}

fn of_parks(parked: impl Iterator<Item = Option<bool>>) -> Posture {
    let each = parked.map(|parked| match parked {
        None => Posture::Unknown,
        Some(true) => Posture::Closed,
        Some(false) => Posture::Open,
    });
    Posture::least_closed(each).unwrap_or(Posture::Closed)
}

/// Publishes the schedule at each change and every 10 s.
async fn keep_publishing_schedule(
    authority: Arc<Authority>,
    published_night: Arc<PublishedNight>,
) -> anyhow::Result<()> {
    let line = authority.node.bus.publisher::<ScheduleState>(&authority.key(Part::Schedule)).await?;
    let mut schedule = published_night.schedule.subscribe();
    loop {
        let published = schedule.borrow_and_update().clone();
        publish(&authority, &line, published).await?;
        tokio::time::sleep(LEAST).await;
        if let Ok(changed) = tokio::time::timeout(Duration::from_secs(10), schedule.changed()).await {
            changed?;
        }
    }
}

/// Publishes the verdict whenever the safety loop renews it; a loop that is dead falls silent.
async fn keep_publishing_safety(authority: Arc<Authority>) -> anyhow::Result<()> {
    let line = authority.node.bus.publisher(&authority.key(Part::Safety)).await?;
    let mut current_verdict = authority.verdict.clone();
    let mut published = None;
    loop {
        current_verdict.changed().await?;
        let newest = current_verdict.borrow_and_update().clone();
        let verdict = newest.state.verdict;
        // Each arrival is judged, but published only once a second while nothing changes.
        let due =
            published.is_none_or(|(at, was)| was != verdict || newest.judged.since(at) >= Duration::from_millis(900));
        if due {
            published = Some((newest.judged, verdict));
            publish(&authority, &line, newest.state).await?;
        }
    }
}

#[cfg(test)]
mod tests {
    use contract::observatory::RowStatus;

    use super::*;

    #[test]
    fn what_a_row_at_work_counts_is_published_where_it_stands_now() {
        let published_night = PublishedNight::new("schedule.jsonl".to_owned());
        let row = |row| RowState {
            row,
            action: "object".to_owned(),
            camera: "cam".to_owned(),
            object: None,
            start_utc: Utc::EPOCH,
            end_utc: Utc::EPOCH,
            status: RowStatus::Pending,
            frames: 0,
            frames_wanted: None,
            detail: String::new(),
        };
        published_night.schedule(|schedule| schedule.rows = vec![row(0), row(1)]);
        let frames = || published_night.schedule.borrow().rows.iter().map(|row| row.frames).collect::<Vec<_>>();
        published_night.row(0, |row| row.frames = 1);
        assert_eq!(frames(), [1, 0]);
        published_night.moved_to(0, Some(1));
        published_night.row(0, |row| row.frames = 2);
        assert_eq!(frames(), [1, 2]);
        published_night.moved_to(0, None);
        published_night.row(0, |row| row.frames = 3);
        assert_eq!(frames(), [1, 2], "nowhere any more");
        published_night.end(0);
        published_night.row(0, |row| row.frames = 4);
        assert_eq!(frames(), [4, 2], "the next row that begins there");
    }

    #[test]
    fn the_posture_is_that_of_the_least_closed_dome() {
        let of = |shutters: &[Option<Shutter>]| {
            Posture::least_closed(shutters.iter().copied().map(Posture::of_shutter)).unwrap()
        };
        assert_eq!(of(&[Some(Shutter::Closed), Some(Shutter::Closed)]), Posture::Closed);
        assert_eq!(of(&[Some(Shutter::Closed), Some(Shutter::Open)]), Posture::Open);
        assert_eq!(of(&[Some(Shutter::Closing), Some(Shutter::Closed)]), Posture::Closing);
        assert_eq!(of(&[Some(Shutter::Open), None]), Posture::Unknown);
        assert_eq!(of(&[Some(Shutter::Error)]), Posture::Unknown);
    }
}
