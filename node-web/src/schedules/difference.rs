//! The difference of two schedules, as it is answered.

use schedule::difference::{Difference, FieldChange, RowChange, WrittenRow};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

/// What would change if a draft were put in force now.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ScheduleDifference {
    /// SHA-256 of the schedule in force: in quotes the `If-Match` of an activation.
    pub in_force_sha256: String,
    /// ETag of the draft that was compared.
    pub draft_etag: String,
    /// Rows that both have; order of fields, blanks and comments count for nothing.
    pub same: u32,
    /// Other rows, in the order of the draft; a row that is gone stands where it was.
    pub changes: Vec<ChangedRow>,
}

/// A row that differs.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ChangedRow {
    /// What becomes of it.
    pub change: RowFate,
    /// Line of the schedule in force on which it begins, from 1.
    pub line_before: Option<u32>,
    /// Line of the draft on which it begins, from 1.
    pub line_after: Option<u32>,
    /// The row in force.
    pub before: Option<Map<String, Value>>,
    /// The row of the draft.
    pub after: Option<Map<String, Value>>,
    /// Of a changed row, the fields that differ.
    pub fields: Vec<ChangedField>,
}

/// What becomes of a row.
#[derive(Debug, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RowFate {
    /// It is new.
    Added,
    /// It is gone.
    Removed,
    /// A row of the same camera, action and object has other fields.
    Changed,
}

/// A field that differs.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ChangedField {
    /// JSON pointer within the row, such as `/action_value/exptime`.
    pub pointer: String,
    /// As it is in force; absent where the row had none.
    pub before: Option<Value>,
    /// As the draft has it; absent where the row has none.
    pub after: Option<Value>,
}

impl ScheduleDifference {
    /// Of a schedule in force and a draft, named by hash and ETag.
    pub fn of(found: Difference, in_force_sha256: String, draft_etag: String) -> Self {
        let changes = found.changes.into_iter().map(ChangedRow::from).collect();
        let same = u32::try_from(found.same).unwrap_or(u32::MAX);
        Self { in_force_sha256, draft_etag, same, changes }
    }
}

impl From<RowChange> for ChangedRow {
    fn from(change: RowChange) -> Self {
        let split = |row: WrittenRow| (Some(row.line), Some(row.row));
        let (change, before, after, fields) = match change {
            RowChange::Added(row) => (RowFate::Added, (None, None), split(row), Vec::new()),
            RowChange::Removed(row) => (RowFate::Removed, split(row), (None, None), Vec::new()),
            RowChange::Changed { before, after, fields } => (RowFate::Changed, split(before), split(after), fields),
        };
        let ((line_before, before), (line_after, after)) = (before, after);
        let field = |FieldChange { pointer, before, after }| ChangedField { pointer, before, after };
        Self { change, line_before, line_after, before, after, fields: fields.into_iter().map(field).collect() }
    }
}
