//! What a device node keeps of what it said: the evidence that outlives an observatory node.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Link;
use crate::{BootId, Payload};

/// Asks a device node what it said of a safety input before now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// So far back, s of sky time; the last state before that is told too.
    pub back_s: f64,
}

impl Payload for Question {
    const NAME: &'static str = "record.question";
}

/// The states that were said, oldest first and without a gap in their numbers; `F` being the typed fields of the kind.
///
/// It begins where the memory of the device node does: with its life, or with the oldest state that it keeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record<F> {
    /// The life of the device node that said them.
    pub boot_id: BootId,
    /// Sky seconds in a machine second, which turns the ages into sky time.
    pub speed: f64,
    /// The states.
    pub entries: Vec<Entry<F>>,
}

/// One state as it was said, without what no verdict needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry<F> {
    /// The number that it was said with.
    pub seq: u64,
    /// So long before this answer, s of machine time on the device node's boot-time clock.
    pub age_s: f64,
    /// How old each reading was when this was said, s of machine time, by its ASCOM name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub reading_ages_s: BTreeMap<String, f64>,
    /// Did the device answer?
    pub link: Link,
    /// What nodes decide with.
    pub fields: F,
}
