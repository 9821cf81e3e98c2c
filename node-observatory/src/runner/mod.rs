//! Works through the schedule: starts each row in its window, and races it against the verdict.

mod one_row;
mod pick;
mod rests;

use std::sync::Arc;
use std::time::Duration;

use config::FaultPolicy;
use contract::Kind;
use contract::observatory::{ActionNow, AlertKind, RowState, RowStatus};
use tokio::sync::watch;
use tokio::task::JoinSet;
use units::Utc;

use self::one_row::{RowEnd, run_row};
use self::pick::{has_ended, pick};
use self::rests::Rests;
use crate::action::Stage;
use crate::control_room::{ControlRoom, Objection};
use crate::patience::seconds;
use crate::schedule::{Loaded, Row};

/// How the night's end stands.
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
    room: Arc<ControlRoom>,
    revision: u64,
    /// The lease under which the statuses were read from the journal.
    token: Option<u64>,
    rows: Arc<Vec<Row>>,
    statuses: Vec<RowStatus>,
    /// Rows that wait for a device to recover.
    rests: Rests,
    at_work: JoinSet<(usize, RowEnd)>,
    farewell: Farewell,
}

/// Announced frames of before a restart arrive within this time, and are then not taken again.
const CATCH_UP: Duration = Duration::from_secs(1);

/// Runs rows until the node ends.
pub async fn keep_observing(room: Arc<ControlRoom>, mut loaded: watch::Receiver<Loaded>) -> anyhow::Result<()> {
    tokio::time::sleep(CATCH_UP).await;
    let (mut ruling, mut hold) = (room.ruling.clone(), room.hold.clone());
    let (mut robotic, mut wish) = (room.robotic.subscribe(), room.wish_closed.subscribe());
    let mut runner = Runner {
        room,
        revision: 0,
        token: None,
        rows: Arc::default(),
        statuses: Vec::new(),
        rests: Rests::default(),
        at_work: JoinSet::new(),
        farewell: Farewell::NotYet,
    };
    loop {
        runner.take_schedule(&loaded.borrow_and_update());
        if runner.room.objection(None).is_none() {
            runner.skip_passed();
            while runner.start_next() {}
            runner.say_farewell();
        } else {
            runner.farewell = Farewell::NotYet;
        }
        runner.room.board.set_ended(runner.farewell == Farewell::Done);
        let nap = runner.until_next_start();
        tokio::select! {
            Some(done) = runner.at_work.join_next() => {
                let (index, end) = done?;
                runner.note_end(index, end);
            }
            _ = ruling.changed() => {}
            _ = hold.changed() => {}
            _ = robotic.changed() => {}
            _ = wish.changed() => {}
            changed = loaded.changed() => changed?,
            () = tokio::time::sleep(nap) => {}
        }
    }
}

impl Runner {
    /// Takes a newer schedule, once nothing runs; rows that were done stay done.
    fn take_schedule(&mut self, loaded: &Loaded) {
        self.room.board.schedule_refused(&loaded.refused);
        // a new lease may come with a journal that another node went on writing
        let token = self.room.hold.borrow().token().or(self.token);
        if (loaded.revision, token) == (self.revision, self.token) || !self.at_work.is_empty() {
            return;
        }
        (self.revision, self.token) = (loaded.revision, token);
        self.rows = loaded.rows.clone();
        self.farewell = Farewell::NotYet;
        self.rests = Rests::default();
        let states: Vec<RowState> =
            self.rows.iter().zip(0..).map(|(row, index)| state_of(&self.room, row, index)).collect();
        self.statuses = states.iter().map(|state| state.status).collect();
        self.room.board.schedule(|schedule| {
            schedule.revision = loaded.revision;
            schedule.rows = states;
        });
    }

    /// Marks rows whose window has passed.
    fn skip_passed(&mut self) {
        let now = self.room.node.bus.clock().utc();
        for (index, row) in self.rows.clone().iter().enumerate() {
            let waits = matches!(self.statuses[index], RowStatus::Pending | RowStatus::Interrupted);
            if waits && row.end < now {
                let taken = self.room.journal.progress(&row.id).taken;
                let detail = match (self.statuses[index], taken) {
                    (RowStatus::Interrupted, taken) => format!("interrupted; its window closed after {taken} frames"),
                    (_, 0) => "its window passed".to_owned(),
                    (_, taken) => format!("its window closed after {taken} frames"),
                };
                tracing::info!(row = index, action = row.action.name(), detail, "skipped");
                self.set(index, RowStatus::Skipped, detail);
            }
        }
    }

    /// Starts the next row whose time has come; false when there is none.
    fn start_next(&mut self) -> bool {
        let now = self.room.node.bus.clock().utc();
        let machine = self.room.node.bus.clock().machine();
        let may = |index, row: &Row| !self.rests.rests(index, machine) && self.room.objection(Some(row)).is_none();
        let Some(index) = pick(&self.rows, &self.statuses, now, may) else { return false };
        let row = self.rows[index].clone();
        let number = u32::try_from(index).unwrap_or(u32::MAX);
        tracing::info!(row = index, action = row.action.name(), object = row.action.object(), "row begins");
        self.set(index, RowStatus::Running, String::new());
        self.farewell = Farewell::NotYet;
        self.room.board.begin(ActionNow {
            row: number,
            action: row.action.name().to_owned(),
            camera: row.camera.to_string(),
            object: row.action.object().map(str::to_owned),
            step: "starting".to_owned(),
            started_utc: now,
        });
        let stage = Stage::new(self.room.clone(), row, number);
        self.at_work.spawn(async move { (index, run_row(&stage).await) });
        true
    }

    fn note_end(&mut self, index: usize, end: RowEnd) {
        if end == RowEnd::Interrupted(Objection::NotRobotic) {
            // an opening that was under way may have taken the wish back in the very moment
            let why = || Some("the robotic switch is off".to_owned());
            self.room.wish_closed.send_if_modified(|wish| wish.is_none() && std::mem::replace(wish, why()).is_none());
        }
        if !matches!(end, RowEnd::Postponed(..)) {
            self.room.node.alerts.clear(AlertKind::RowPostponed, index);
        }
        let (status, detail) = match end {
            RowEnd::Finished(detail) => (RowStatus::Finished, detail),
            RowEnd::Failed(detail) => (RowStatus::Failed, detail),
            RowEnd::Postponed(detail, kind) => (RowStatus::Interrupted, self.postpone(index, detail, kind)),
            RowEnd::Interrupted(objection) => (RowStatus::Interrupted, objection.to_string()),
        };
        let row = self.rows[index].clone();
        self.room.board.end(u32::try_from(index).unwrap_or(u32::MAX));
        match status {
            RowStatus::Finished => tracing::info!(row = index, action = row.action.name(), detail, "row finished"),
            _ => tracing::warn!(row = index, action = row.action.name(), detail, ?status, "row ended"),
        }
        self.set(index, status, detail.clone());
        if status == RowStatus::Interrupted {
            return;
        }
        let room = self.room.clone();
        tokio::task::spawn_blocking(move || {
            if let Err(error) = room.journal.ended(&row.id, status, &detail, room.node.bus.clock().utc()) {
                tracing::warn!(%error, "the end of a row is not in the journal; a restart may begin it again");
            }
        });
    }

    /// Lets a row rest for a device's sake, as the policy for that kind has it; returns what is shown.
    fn postpone(&mut self, index: usize, detail: String, kind: Option<Kind>) -> String {
        let (faults, clock) = (&self.room.node.config.faults, self.room.node.bus.clock());
        let rest = self.rests.begin(index, seconds(faults.rest_s), clock.machine());
        match kind.map_or(FaultPolicy::Postpone, |kind| faults.policy(kind)) {
            FaultPolicy::Close => drop(self.room.wish_closed.send_replace(Some(detail.clone()))),
            FaultPolicy::Stop => crate::order::switch_robotic(&self.room, false, &detail),
            FaultPolicy::Postpone | FaultPolicy::Skip | FaultPolicy::Without => {}
        }
        self.room.node.alerts.raise(AlertKind::RowPostponed, index, &detail);
        format!("{detail}; tried again in {:.0} s", rest.as_secs_f64())
    }

    /// After the last row: closes everything, and says that the night has ended once that is verified.
    fn say_farewell(&mut self) {
        if self.rows.is_empty() || !self.statuses.iter().all(|status| has_ended(*status)) {
            self.farewell = Farewell::NotYet;
            return;
        }
        let wish = &self.room.wish_closed;
        self.farewell = match self.farewell {
            Farewell::NotYet => {
                tracing::info!("the schedule has ended");
                wish.send_replace(Some("the schedule has ended".to_owned()));
                Farewell::Closing
            }
            Farewell::Closing if wish.borrow().is_none() => {
                tracing::info!("the night has ended: closed and parked");
                Farewell::Done
            }
            farewell => farewell,
        };
    }

    fn set(&mut self, index: usize, status: RowStatus, detail: String) {
        self.statuses[index] = status;
        self.room.board.row(u32::try_from(index).unwrap_or(u32::MAX), |row| {
            row.status = status;
            row.detail = detail;
        });
    }

    fn until_next_start(&self) -> Duration {
        let clock = self.room.node.bus.clock();
        let now = clock.utc();
        let waiting = self
            .rows
            .iter()
            .zip(&self.statuses)
            .filter(|(row, status)| **status == RowStatus::Pending && row.start > now);
        let next: Option<Utc> = waiting.map(|(row, _)| row.start).min();
        let left = next.map(|start| clock.machine_duration(crate::patience::seconds(start.seconds_since(now))));
        left.unwrap_or(Duration::MAX).clamp(Duration::from_millis(1), Duration::from_secs(1))
    }
}

/// A row as it is shown when a schedule is taken.
fn state_of(room: &ControlRoom, row: &Row, index: u32) -> RowState {
    let progress = room.journal.progress(&row.id);
    let (status, detail) = progress.ended.unwrap_or((RowStatus::Pending, String::new()));
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
