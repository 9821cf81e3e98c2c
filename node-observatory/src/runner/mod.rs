//! Works through the schedule: starts each row in its window, and races it against the verdict.

mod held_up;
mod one_row;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use config::FaultPolicy;
use contract::Kind;
use contract::observatory::{ActionNow, RowState, RowStatus};
use safety::objection::Objection;
use schedule::rests::Rests;
use schedule::sequence::{Sequence, passed_words};
use schedule::{Row, RowId};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use units::{Utc, seconds};

use self::held_up::HeldUp;
use self::one_row::{RowEnd, run_row};
use crate::action::Techniques;
use crate::journal::Journal;
use crate::orders::rows::{RowChange, RowOrder};
use crate::row_context::{RowContext, RowTools};
use crate::schedule_file::Loaded;

/// The progress of the night's end.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Farewell {
    /// Rows are left.
    NotYet,
    /// All rows have ended, and everything is being closed.
    Closing,
    /// All rows have ended and everything is closed.
    Done,
}

struct Runner {
    tools: Arc<RowTools>,
    techniques: Arc<Techniques>,
    revision: u64,
    /// The lease under which the statuses were read from the journal.
    token: Option<u64>,
    sequence: Sequence,
    /// Rows that wait for a device to recover.
    rests: Rests,
    /// The alerts about them.
    postponed: HeldUp,
    /// The alerts about rows that have failed.
    failed: HeldUp,
    at_work: JoinSet<(RowId, RowEnd)>,
    begun: BTreeMap<RowId, Begun>,
    farewell: Farewell,
}

/// A row at work.
struct Begun {
    row: Row,
    /// Its place in the schedule when it began: its frames and steps are published under this number.
    number: u32,
    /// Signals that the schedule has it no longer.
    withdrawn: watch::Sender<bool>,
    /// Why it is skipped, where somebody has ordered that.
    skipped: Option<String>,
}

/// Announced frames of before a restart arrive within this time, and are then not taken again.
const CATCH_UP: Duration = Duration::from_secs(1);

/// Runs rows until the node ends.
pub async fn keep_observing(
    tools: Arc<RowTools>,
    techniques: Arc<Techniques>,
    mut loaded: watch::Receiver<Loaded>,
    mut ordered: mpsc::UnboundedReceiver<RowOrder>,
) -> anyhow::Result<()> {
    tokio::time::sleep(CATCH_UP).await;
    let authority = &tools.authority;
    let (mut verdict, mut hold) = (authority.verdict.clone(), authority.hold.clone());
    let (mut robotic, mut request) = (authority.robotic.subscribe(), authority.close_request.subscribe());
    let mut runner = Runner {
        tools: tools.clone(),
        techniques,
        revision: 0,
        token: None,
        sequence: Sequence::default(),
        rests: Rests::default(),
        postponed: HeldUp::postponed(),
        failed: HeldUp::failed(),
        at_work: JoinSet::new(),
        begun: BTreeMap::new(),
        farewell: Farewell::NotYet,
    };
    loop {
        runner.take_schedule(&loaded.borrow_and_update());
        if runner.tools.authority.objection(None).is_none() {
            runner.skip_passed();
            runner.end_rests();
            while runner.start_next() {}
            runner.forget_gone_causes();
            runner.log_end();
        } else {
            runner.farewell = Farewell::NotYet;
        }
        runner.tools.night.set_ended(runner.farewell == Farewell::Done);
        let nap = runner.until_next_start();
        tokio::select! {
            Some(done) = runner.at_work.join_next() => {
                let (id, end) = done?;
                runner.note_end(&id, end);
            }
            Some(order) = ordered.recv() => runner.follow(order),
            _ = verdict.changed() => {}
            _ = hold.changed() => {}
            _ = robotic.changed() => {}
            _ = request.changed() => {}
            changed = loaded.changed() => changed?,
            () = tokio::time::sleep(nap) => {}
        }
    }
}

impl Runner {
    /// Takes a newer schedule at once: rows that were done stay done, one at work that is unchanged goes on, and one
    /// that the schedule has no longer ends with the frame that is under way (docs/decisions/0030).
    fn take_schedule(&mut self, loaded: &Loaded) {
        self.tools.night.schedule_refused(&loaded.refused);
        // A new lease may come with a journal that another node went on writing: it is read once nothing runs.
        let token = self.tools.authority.hold.borrow().token().or(self.token);
        let is_same_reign = token == self.token;
        if (loaded.revision == self.revision && is_same_reign) || (!is_same_reign && !self.sequence.is_idle()) {
            return;
        }
        (self.revision, self.token) = (loaded.revision, token);
        self.farewell = Farewell::NotYet;
        // Before the rows are published: the counts of a row at work must not appear at another one's place.
        for (id, begun) in &self.begun {
            let place = loaded.rows.iter().position(|row| row.id == *id);
            self.tools.night.moved_to(begun.number, place.map(number));
        }
        let mut known: BTreeMap<&RowId, RowStatus> = BTreeMap::new();
        let machine = self.tools.authority.node.bus.clock().machine();
        // A row that rests does so under a new lease, too, and says why; what another node wrote of it counts before that.
        let stays = |id: &RowId| {
            is_same_reign || self.rests.rests(id, machine) && self.tools.journal.progress(id).ended.is_none()
        };
        self.tools.night.schedule(|schedule| {
            let before = std::mem::take(&mut schedule.rows);
            let states = self.sequence.rows().iter().map(|row| &row.id).zip(before).filter(|(id, _)| stays(id));
            let states: BTreeMap<&RowId, RowState> = states.collect();
            let rows = loaded.rows.iter().zip(0..);
            schedule.revision = loaded.revision;
            schedule.sha256 = Some(loaded.sha256.clone()).filter(|sha256| !sha256.is_empty());
            schedule.rows =
                rows.map(|(row, index)| state_of(&self.tools.journal, row, index, states.get(&row.id))).collect();
            known = loaded.rows.iter().map(|row| &row.id).zip(schedule.rows.iter().map(|row| row.status)).collect();
        });
        let leaving = self.sequence.take(loaded.rows.clone(), |id| known.get(id).copied());
        self.rests.keep(|id| self.sequence.place_of(id).is_some());
        let alerts = &self.tools.authority.node.alerts;
        self.postponed.keep_only(|id| self.sequence.place_of(id).is_some(), alerts);
        self.failed.keep_only(|id| self.sequence.place_of(id).is_some(), alerts);
        for (id, begun) in &self.begun {
            let leaves = leaving.contains(id) || begun.skipped.is_some();
            if begun.withdrawn.send_replace(leaves) != leaves && leaves {
                let (action, object) = (begun.row.action.name(), begun.row.action.object());
                tracing::info!(action, object, "the schedule has this row no longer; it ends");
            }
            if let Some(place) = self.sequence.place_of(id) {
                self.tools.night.at(number(place), |row| row.status = RowStatus::Running);
            }
        }
    }

    /// Follows an order about a row; the journal has it already.
    fn follow(&mut self, RowOrder { row: id, does }: RowOrder) {
        let alerts = &self.tools.authority.node.alerts;
        match (does, self.begun.get_mut(&id), self.sequence.place_of(&id)) {
            (RowChange::Skip(why), Some(begun), _) => {
                begun.skipped = Some(why);
                begun.withdrawn.send_replace(true);
            }
            (RowChange::Skip(why), None, Some(index)) => {
                self.postponed.remove(&id, alerts);
                self.sequence.set(index, RowStatus::Skipped);
                self.show(index, RowStatus::Skipped, why);
            }
            (RowChange::Repeat(why), None, Some(index)) => {
                self.rests.keep(|rests| *rests != id);
                self.postponed.remove(&id, alerts);
                self.failed.remove(&id, alerts);
                self.sequence.set(index, RowStatus::Pending);
                self.show(index, RowStatus::Pending, why);
                let taken = self.tools.journal.progress(&id).taken;
                self.tools.night.at(number(index), |row| row.frames = taken);
            }
            // It began again meanwhile, or the schedule has it no longer.
            (RowChange::Repeat(_), Some(_), _) | (_, None, None) => {}
        }
    }

    /// Marks rows whose window has passed, and takes that back where the clock was ahead.
    fn skip_passed(&mut self) {
        let now = self.tools.authority.surely(self.tools.authority.node.bus.clock().utc());
        // Only an order is in the journal, and stands.
        for index in self.sequence.skipped_before(now, |id| self.tools.journal.progress(id).ended.is_some()) {
            self.sequence.set(index, RowStatus::Pending);
            self.show(index, RowStatus::Pending, String::new());
        }
        for index in self.sequence.passed(now) {
            let (Some(row), Some(status)) = (self.sequence.rows().get(index), self.sequence.statuses().get(index))
            else {
                continue;
            };
            let taken = self.tools.journal.progress(&row.id).taken;
            let held_up = self.postponed.remove(&row.id, &self.tools.authority.node.alerts);
            let because = held_up.map(|why| format!(": {why}")).unwrap_or_default();
            let detail = format!("{}{because}", passed_words(*status, taken));
            tracing::info!(row = RowState::told(number(index)), action = row.action.name(), detail, "skipped");
            self.sequence.set(index, RowStatus::Skipped);
            self.show(index, RowStatus::Skipped, detail);
        }
    }

    /// Starts the next row whose time has come; false when there is none.
    fn start_next(&mut self) -> bool {
        let now = self.tools.authority.node.bus.clock().utc();
        let machine = self.tools.authority.node.bus.clock().machine();
        // A number identifies whose frames they are, so a row waits for one that began at its place.
        let is_taken = |index| self.begun.values().any(|begun| begun.number == number(index));
        let may = |index, row: &Row| {
            self.tools.authority.verdict.borrow().lets_begin(row.action.needs().safe)
                && !self.rests.rests(&row.id, machine)
                && !is_taken(index)
                && self.tools.authority.objection_to_begin(row).is_none()
        };
        let Some(index) = self.sequence.next(now, may) else { return false };
        let Some(row) = self.sequence.begin(index) else { return false };
        let number = number(index);
        let told = RowState::told(number);
        tracing::info!(row = told, action = row.action.name(), object = row.action.object(), "row begins");
        self.show(index, RowStatus::Running, String::new());
        self.farewell = Farewell::NotYet;
        self.tools.night.begin(ActionNow {
            row: number,
            action: row.action.name().to_owned(),
            camera: row.camera.to_string(),
            object: row.action.object().map(str::to_owned),
            step: "starting".to_owned(),
            started_utc: now,
            expected_by_utc: None,
        });
        let (withdrawn, withdrawal) = watch::channel(false);
        self.begun.insert(row.id.clone(), Begun { row: row.clone(), number, withdrawn, skipped: None });
        let (context, techniques) = (RowContext::new(self.tools.clone(), row, number), self.techniques.clone());
        self.at_work.spawn(async move { (context.row.id.clone(), run_row(&context, &techniques, withdrawal).await) });
        true
    }

    /// Takes the reason of an interruption from the rows that nothing stands against any more.
    fn forget_gone_causes(&self) {
        let machine = self.tools.authority.node.bus.clock().machine();
        let stands_against =
            |row: &Row| self.rests.rests(&row.id, machine) || self.tools.authority.objection_to_begin(row).is_some();
        for index in self.sequence.released(stands_against) {
            self.tools.night.at(number(index), |row| row.detail.clear());
        }
    }

    fn note_end(&mut self, id: &RowId, end: RowEnd) {
        let Some(Begun { row, number, skipped, .. }) = self.begun.remove(id) else { return };
        if end == RowEnd::Interrupted(Objection::NotRobotic) {
            // An opening that was under way may have taken the close request back in the very moment.
            let why = || Some("the robotic switch is off".to_owned());
            self.tools
                .authority
                .close_request
                .send_if_modified(|request| request.is_none() && std::mem::replace(request, why()).is_none());
        }
        if skipped.is_some() || !matches!(end, RowEnd::Postponed { .. }) {
            self.postponed.remove(id, &self.tools.authority.node.alerts);
        }
        let is_written = skipped.is_some() && !matches!(end, RowEnd::Finished(_));
        let (status, detail) = match end {
            RowEnd::Finished(detail) => (RowStatus::Finished, detail),
            _ if let Some(why) = skipped => (RowStatus::Skipped, why),
            RowEnd::Failed(detail, kind) => {
                self.failed.add(id, number, kind, &detail, &self.tools.authority.node.alerts);
                (RowStatus::Failed, detail)
            }
            RowEnd::Postponed { detail, kind, silent } => {
                (RowStatus::Interrupted, self.postpone(id, number, detail, kind, silent))
            }
            RowEnd::Waits(detail, clear) => {
                let clock = self.tools.authority.node.bus.clock();
                let left = clock.machine_duration(seconds(clear.seconds_since(clock.utc())));
                self.rests.hold(id, left, clock.machine());
                (RowStatus::Interrupted, detail)
            }
            RowEnd::Interrupted(objection) => (RowStatus::Interrupted, objection.to_string()),
            RowEnd::Withdrawn => (RowStatus::Interrupted, "it was taken from the schedule for a while".to_owned()),
        };
        self.tools.night.end(number);
        let told = RowState::told(number);
        match status {
            RowStatus::Finished => tracing::info!(row = told, action = row.action.name(), detail, "row finished"),
            _ => tracing::warn!(row = told, action = row.action.name(), detail, ?status, "row ended"),
        }
        if let Some(index) = self.sequence.end(id, status) {
            self.show(index, status, detail.clone());
        }
        if is_written || status == RowStatus::Interrupted {
            return;
        }
        // It counts before a new lease asks the journal which rows are left; only the disk is waited for elsewhere.
        let journal = self.tools.journal.clone();
        let sent = journal.end(&row.id, status, &detail, self.tools.authority.node.bus.clock().utc());
        tokio::task::spawn_blocking(move || {
            if let Err(error) = journal.arrive(sent) {
                tracing::warn!(%error, "the end of a row is not in the journal; a restart may begin it again");
            }
        });
    }

    /// Lets a row rest for a device's sake, as the policy for that kind has it; returns the state to publish.
    fn postpone(
        &mut self,
        id: &RowId,
        number: u32,
        detail: String,
        kind: Option<Kind>,
        silent: Option<String>,
    ) -> String {
        let (faults, clock) = (&self.tools.authority.node.config.faults, self.tools.authority.node.bus.clock());
        let sooner = silent.as_ref().map(|device| format!(", or when {device} answers")).unwrap_or_default();
        let rest = self.rests.begin(id, seconds(faults.rest_s), clock.machine());
        if let Some(device) = silent {
            self.rests.end_when_heard(id, device, seconds(faults.pause_s), clock.machine());
        }
        match kind.map_or(FaultPolicy::Postpone, |kind| faults.policy(kind)) {
            FaultPolicy::Close => drop(self.tools.authority.close_request.send_replace(Some(detail.clone()))),
            FaultPolicy::Stop => crate::robotic::turn_off(&self.tools.authority, &self.tools.journal, &detail),
            FaultPolicy::Postpone | FaultPolicy::Skip | FaultPolicy::Without => {}
        }
        self.postponed.add(id, number, kind, &detail, &self.tools.authority.node.alerts);
        let again = clock.utc().plus_seconds(rest.as_secs_f64() * clock.speed());
        format!("{detail}; tried again at {}{sooner}", again.time_of_day())
    }

    /// Ends the rests of rows for a device that was silent and answers again.
    fn end_rests(&mut self) {
        let (devices, machine) = (&self.tools.devices, self.tools.authority.node.bus.clock().machine());
        self.rests.heard(|device| devices.is_heard(device), machine);
    }

    /// After the last row: closes everything, and publishes that the night has ended once that is verified.
    fn log_end(&mut self) {
        if !self.sequence.is_over() {
            self.farewell = Farewell::NotYet;
            return;
        }
        let request = &self.tools.authority.close_request;
        self.farewell = match self.farewell {
            Farewell::NotYet => {
                tracing::info!("the schedule has ended");
                request.send_replace(Some("the schedule has ended".to_owned()));
                Farewell::Closing
            }
            Farewell::Closing if request.borrow().is_none() => {
                tracing::info!("the night has ended: closed and parked");
                Farewell::Done
            }
            farewell => farewell,
        };
    }

    /// Shows how far a row of the schedule in force is.
    fn show(&self, index: usize, status: RowStatus, detail: String) {
        self.tools.night.at(number(index), |row| {
            row.status = status;
            row.detail = detail;
        });
    }

    fn until_next_start(&self) -> Duration {
        let clock = self.tools.authority.node.bus.clock();
        let now = clock.utc();
        let each = self.sequence.rows().iter().zip(self.sequence.statuses());
        let waiting = each.filter(|(row, status)| **status == RowStatus::Pending && row.start > now);
        let next: Option<Utc> = waiting.map(|(row, _)| row.start).min();
        let left = next.map(|start| clock.machine_duration(units::seconds(start.seconds_since(now))));
        left.unwrap_or(Duration::MAX).clamp(Duration::from_millis(1), Duration::from_secs(1))
    }
}

/// The published number of a place in the schedule.
fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

/// The published state of a row when a schedule is taken: as it was before, else as the journal has it.
fn state_of(journal: &Journal, row: &Row, index: u32, before: Option<&RowState>) -> RowState {
    let progress = journal.progress(&row.id);
    let known = before.map(|before| (before.status, before.detail.clone())).or(progress.ended);
    let (status, detail) = known.unwrap_or((RowStatus::Pending, String::new()));
    RowState {
        row: index,
        action: row.action.name().to_owned(),
        camera: row.camera.to_string(),
        object: row.action.object().map(str::to_owned),
        start_utc: row.start,
        end_utc: row.end,
        status,
        frames: progress.taken,
        frames_wanted: row.action.frames_wanted(),
        detail,
    }
}
