//! The rows of the schedule and how far they are.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::Finding;
use crate::Payload;

/// The schedule as the observatory runs it, at each change and every 10 s.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleState {
    /// File it was read from.
    pub file: String,
    /// Counts the versions taken since the node started.
    pub revision: u64,
    /// Why the newest file was not taken; absent when it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// The rows in order of their start.
    pub rows: Vec<RowState>,
    /// SHA-256 of the text that is active, as lower-case hex; absent before one was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// What was found in the schedule that is active, errors first where there are too many to be listed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<Finding>,
}

impl Payload for ScheduleState {
    const NAME: &'static str = "observatory.schedule";
}

/// One row.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RowState {
    /// Position in the order, from 0.
    pub row: u32,
    /// Type of the action.
    pub action: String,
    /// Camera.
    pub camera: String,
    /// Object, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Earliest start.
    pub start_utc: Utc,
    /// Latest end.
    pub end_utc: Utc,
    /// How far it is.
    pub status: RowStatus,
    /// Frames taken.
    pub frames: u32,
    /// Frames wanted; absent for "until the end".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_wanted: Option<u32>,
    /// Why it failed, was skipped or waits, in words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
}

impl RowState {
    /// The detail of a row that an unsafe sky stopped begins so; the verdict has the present reason.
    pub const NOT_SAFE: &str = "not safe: ";
    /// The detail of a row that must not expose the sky begins so.
    pub const SUSPENDED: &str = "suspended: ";

    /// The number of a row as people count: the first is 1.
    pub const fn told(row: u32) -> u32 {
        row.saturating_add(1)
    }

    /// Why it waits, where the present verdict does not say that better.
    pub fn own_detail(&self) -> Option<&str> {
        let is_of_verdict = [Self::NOT_SAFE, Self::SUSPENDED].iter().any(|words| self.detail.starts_with(words));
        Some(self.detail.as_str()).filter(|detail| !detail.is_empty() && !is_of_verdict)
    }
}

/// How far a row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowStatus {
    /// Its time has not come.
    Pending,
    /// Being done.
    Running,
    /// Stopped by an unsafe sky; goes on when it is safe and its window is open.
    Interrupted,
    /// Done.
    Finished,
    /// Tried and failed.
    Failed,
    /// Its window passed before it could start, or before it was done.
    Skipped,
}
