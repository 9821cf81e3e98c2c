//! The rows in force and the status of each: pure, so that tests prove for any schedule which rows may run at the same
//! time.

use std::collections::BTreeMap;
use std::sync::Arc;

use contract::observatory::RowStatus;
use units::Utc;

use crate::pick::{has_ended, pick};
use crate::row::{Row, RowId};

/// The rows of the schedule in force, and those of an older one that are still at work.
#[derive(Debug, Default)]
pub struct Sequence {
    rows: Arc<Vec<Row>>,
    statuses: Vec<RowStatus>,
    at_work: BTreeMap<RowId, Row>,
}

impl Sequence {
    /// The rows, in order of their start.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The status of each row.
    pub fn statuses(&self) -> &[RowStatus] {
        &self.statuses
    }

    /// Does nothing run, not even a row that the schedule no longer has?
    pub fn is_idle(&self) -> bool {
        self.at_work.is_empty()
    }

    /// The row to be started now, if there is one. None while a row that was taken from the schedule is still ending:
    /// it has its camera and its mount until then.
    pub fn next(&self, now: Utc, may: impl Fn(usize, &Row) -> bool) -> Option<usize> {
        let ends = self.at_work.keys().any(|id| self.place_of(id).is_none());
        if ends { None } else { pick(&self.rows, &self.statuses, now, may) }
    }

    /// A row begins.
    pub fn begin(&mut self, index: usize) -> Option<Row> {
        let row = self.rows.get(index)?.clone();
        self.set(index, RowStatus::Running);
        self.at_work.insert(row.id.clone(), row.clone());
        Some(row)
    }

    /// A row has ended; returns its place in the schedule in force, if it has one.
    pub fn end(&mut self, id: &RowId, status: RowStatus) -> Option<usize> {
        self.at_work.remove(id)?;
        let index = self.place_of(id)?;
        self.set(index, status);
        Some(index)
    }

    /// Changes the status of a row that is not at work.
    pub fn set(&mut self, index: usize, status: RowStatus) {
        if let Some(known) = self.statuses.get_mut(index) {
            *known = status;
        }
    }

    /// Takes another schedule: rows that it has unchanged get their `known` status, and go on where they are at work.
    /// Returns those at work that it no longer has.
    pub fn take(&mut self, rows: Arc<Vec<Row>>, known: impl Fn(&RowId) -> Option<RowStatus>) -> Vec<RowId> {
        let status = |row: &Row| match known(&row.id) {
            _ if self.at_work.contains_key(&row.id) => RowStatus::Running,
            // No task works at it any more.
            None | Some(RowStatus::Running) => RowStatus::Pending,
            Some(status) => status,
        };
        self.statuses = rows.iter().map(status).collect();
        self.rows = rows;
        self.at_work.keys().filter(|id| self.place_of(id).is_none()).cloned().collect()
    }

    /// Have all rows ended, and is there one?
    pub fn is_over(&self) -> bool {
        !self.rows.is_empty() && self.is_idle() && self.statuses.iter().all(|status| has_ended(*status))
    }

    /// Rows that wait although their window has passed.
    pub fn passed(&self, now: Utc) -> Vec<usize> {
        let waits = |status| matches!(status, RowStatus::Pending | RowStatus::Interrupted);
        let each = self.rows.iter().zip(&self.statuses).enumerate();
        each.filter(|(_, (row, status))| waits(**status) && row.end < now).map(|(index, _)| index).collect()
    }

    /// Rows that were skipped although their window has not passed, but for those that were `ended` in another way.
    pub fn skipped_before(&self, now: Utc, ended: impl Fn(&RowId) -> bool) -> Vec<usize> {
        let each = self.rows.iter().zip(&self.statuses).enumerate();
        let early =
            each.filter(|(_, (row, status))| **status == RowStatus::Skipped && row.end >= now && !ended(&row.id));
        early.map(|(index, _)| index).collect()
    }

    /// Interrupted rows that nothing stands against any more: the reason of their interruption has gone.
    pub fn released(&self, stands_against: impl Fn(&Row) -> bool) -> Vec<usize> {
        let each = self.rows.iter().zip(&self.statuses).enumerate();
        let released = each.filter(|(_, (row, status))| **status == RowStatus::Interrupted && !stands_against(row));
        released.map(|(index, _)| index).collect()
    }

    /// Where a row stands.
    pub fn place_of(&self, id: &RowId) -> Option<usize> {
        self.rows.iter().position(|row| row.id == *id)
    }
}

/// The text for a row whose window has passed, with the frames that it took.
pub fn passed_words(status: RowStatus, taken: u32) -> String {
    match (status, taken) {
        (RowStatus::Interrupted, taken) => format!("its window closed before it could go on, after {taken} frames"),
        (_, 0) => "its window passed".to_owned(),
        (_, taken) => format!("its window closed after {taken} frames"),
    }
}

#[cfg(test)]
#[path = "sequence_tests.rs"]
mod tests;
