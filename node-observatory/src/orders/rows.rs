//! Orders about one row of the schedule in force: done without, or run again.

use std::sync::Arc;

use contract::observatory::{RowState, RowStatus};
use contract::{Order, OrderedRow};
use schedule::{Row, RowId};
use tokio::sync::{mpsc, watch};
use units::Utc;

use crate::journal::Journal;
use crate::night::PublishedNight;
use crate::persisted::Unchanged;
use crate::schedule_file::Loaded;

/// What the runner is told about a row, once the journal has it.
#[derive(Debug)]
pub struct RowOrder {
    /// The row.
    pub row: RowId,
    /// What becomes of it.
    pub does: RowChange,
}

/// What becomes of a row by order.
#[derive(Debug)]
pub enum RowChange {
    /// It is done without, for this reason.
    Skip(String),
    /// It runs again, for this reason.
    Repeat(String),
}

/// The rows of the schedule in force, and the way to who works through them.
pub struct OrderedRows {
    /// The journal.
    pub journal: Arc<Journal>,
    /// The schedule in force.
    pub loaded: watch::Receiver<Loaded>,
    /// How far its rows are.
    pub night: Arc<PublishedNight>,
    /// To the runner.
    pub runner: mpsc::UnboundedSender<RowOrder>,
}

impl OrderedRows {
    /// Does without a row that has not ended.
    ///
    /// # Errors
    /// There is no such row, or it has ended; or the disk fails. Then it is as it was.
    pub async fn skip(&self, ordered: &OrderedRow, order: &Order, now: Utc) -> Result<(), Unchanged> {
        let (row, status) = self.find(ordered)?;
        if let RowStatus::Finished | RowStatus::Failed | RowStatus::Skipped = status {
            return Err(Unchanged::Overtaken(format!("{} has ended already: it {}", told(ordered), ending(status))));
        }
        let why = by("skipped", order);
        let (id, detail) = (row.id.clone(), why.clone());
        self.write(move |journal| journal.end_by_order(&id, RowStatus::Skipped, &detail, now)).await?;
        self.tell(row.id, RowChange::Skip(why));
        Ok(())
    }

    /// Runs a row again that has ended, or that rests.
    ///
    /// # Errors
    /// There is no such row, it waits or runs anyway, or its window is over; or the disk fails. Then it is as it was.
    pub async fn repeat(&self, ordered: &OrderedRow, order: &Order, now: Utc) -> Result<(), Unchanged> {
        let (row, status) = self.find(ordered)?;
        let told = told(ordered);
        let anew = match status {
            RowStatus::Finished => true,
            RowStatus::Failed | RowStatus::Skipped | RowStatus::Interrupted => false,
            RowStatus::Pending => {
                return Err(Unchanged::Overtaken(format!("{told} has not begun: it runs when its turn comes")));
            }
            RowStatus::Running => {
                let what = format!("{told} is under way; to begin it anew, skip it first");
                return Err(Unchanged::Overtaken(what));
            }
        };
        if row.end <= now {
            return Err(Unchanged::Overtaken(format!(
                "the window of {told} was over at {}; give it a later end in the schedule instead",
                row.end.to_second()
            )));
        }
        let id = row.id.clone();
        self.write(move |journal| journal.again(&id, anew, now)).await?;
        self.tell(row.id, RowChange::Repeat(by("again", order)));
        Ok(())
    }

    fn find(&self, ordered: &OrderedRow) -> Result<(Row, RowStatus), Unchanged> {
        let loaded = self.loaded.borrow().clone();
        if let Some(of) = ordered.of.as_ref().filter(|of| **of != loaded.sha256) {
            let now = if loaded.sha256.is_empty() { "none" } else { &loaded.sha256 };
            return Err(Unchanged::Overtaken(format!(
                "another schedule is in force than the one that the row was chosen from: {now} and not {of} (SHA-256); look at \
                 its rows, and order again"
            )));
        }
        let Some(row) = usize::try_from(ordered.row).ok().and_then(|index| loaded.rows.get(index)) else {
            let what = match loaded.rows.len() {
                0 => "the schedule in force has no rows".to_owned(),
                count => format!("there is no {}: the schedule in force has {count} rows", told(ordered)),
            };
            return Err(Unchanged::Refused(what));
        };
        match self.night.shown(ordered.row) {
            (Some(sha256), Some(status)) if sha256 == loaded.sha256 => Ok((row.clone(), status)),
            _ => Err(Unchanged::Overtaken(
                "the schedule is being replaced at this moment; look at its rows, and order again".to_owned(),
            )),
        }
    }

    async fn write(
        &self,
        line: impl FnOnce(&Journal) -> std::io::Result<()> + Send + 'static,
    ) -> Result<(), Unchanged> {
        let journal = self.journal.clone();
        let written = tokio::task::spawn_blocking(move || line(&journal)).await;
        let written = written.map_err(std::io::Error::other).and_then(|written| written);
        written.map_err(|source| Unchanged::Disk { path: "the journal".to_owned(), source })
    }

    fn tell(&self, row: RowId, does: RowChange) {
        if self.runner.send(RowOrder { row, does }).is_err() {
            tracing::warn!("nobody works through the schedule: this node ends");
        }
    }
}

fn told(ordered: &OrderedRow) -> String {
    format!("row {}", RowState::told(ordered.row))
}

fn ending(status: RowStatus) -> &'static str {
    match status {
        RowStatus::Failed => "failed",
        RowStatus::Skipped => "was skipped",
        _ => "is finished",
    }
}

fn by(what: &str, order: &Order) -> String {
    let name = if order.operator().is_empty() { "an order" } else { order.operator() };
    let why = if order.reason.trim().is_empty() { String::new() } else { format!(": {}", order.reason.trim()) };
    format!("{what} by {name}{why}")
}
