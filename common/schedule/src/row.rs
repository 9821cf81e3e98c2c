//! One row of the schedule.

use std::fmt;
use std::sync::Arc;

use contract::Name;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use units::Utc;

use crate::action::Action;
use crate::written::Written;

/// Names a row by its content, so that a file that is read again finds its rows in the state that they had.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RowId(pub String);

impl fmt::Display for RowId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl RowId {
    /// From a row's text values; `twin` counts the rows before it that are the same.
    pub(super) fn of(object: &Value, twin: usize) -> Self {
        let digest = Sha256::digest(sorted(object).to_string().as_bytes());
        let short: String = digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        Self(if twin == 0 { short } else { format!("{short}-{twin}") })
    }
}

/// The same value with sorted keys: the order in which a tool writes them means nothing.
fn sorted(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<(&String, &Value)> = map.iter().collect();
            entries.sort_by_key(|(key, _)| *key);
            Value::Object(entries.into_iter().map(|(key, value)| (key.clone(), sorted(value))).collect())
        }
        Value::Array(list) => Value::Array(list.iter().map(sorted).collect()),
        plain => plain.clone(),
    }
}

/// One row.
#[derive(Clone)]
pub struct Row {
    /// By its content.
    pub id: RowId,
    /// Line of the file on which it begins, from 1.
    pub line: usize,
    /// The places of the row and its fields in the file.
    pub written: Arc<Written>,
    /// The camera that it is about.
    pub camera: Name,
    /// The action.
    pub action: Arc<Action>,
    /// Id of the observing programme or proposal that it is for, where it names one.
    pub programme: Option<String>,
    /// Earliest start.
    pub start: Utc,
    /// Latest end.
    pub end: Utc,
}

/// As much as could be read of a row with a fault that is not surely mended.
#[derive(Debug, Clone)]
pub struct PartOfRow {
    /// The places of the row and its fields in the file.
    pub written: Arc<Written>,
    /// The camera, where it is known.
    pub camera: Option<Name>,
    /// Filters that it asks for by name.
    pub filters: Vec<String>,
    /// Earliest start and latest end, where both can be read.
    pub window: Option<(Utc, Utc)>,
}

impl fmt::Debug for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {} to {} (line {})", self.action.name(), self.camera, self.start, self.end, self.line)
    }
}
