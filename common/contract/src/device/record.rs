//! The states that a device node stores after it published them: the evidence that outlives an observatory node, and a
//! restart of the device node itself.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Link;
use crate::{BootId, Payload};

/// Asks a device node what it published about a safety input before now.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RecordQuestion {
    /// So far back, s of sky time; the last state before that is reported too.
    pub back_s: f64,
}

impl Payload for RecordQuestion {
    const NAME: &'static str = "record.question";
}

/// The published states, oldest first and without a gap in their numbers; `F` being the typed fields of the kind.
///
/// It begins where the memory of the device node does: with the oldest state that it keeps, which an earlier
/// incarnation may have published.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct StateRecord<F> {
    /// The incarnation of the device node that published them.
    pub boot_id: BootId,
    /// Sky seconds in a machine second, which turns the ages into sky time.
    pub speed: f64,
    /// The states.
    pub entries: Vec<StateEntry<F>>,
    /// Those that earlier incarnations published, of the oldest one first, as this one found them on its disk.
    // A path, because a bare `default` would ask for one of `F`.
    #[serde(default = "Vec::<EarlierStates<F>>::new", skip_serializing_if = "Vec::is_empty")]
    pub earlier: Vec<EarlierStates<F>>,
}

/// The states of an earlier incarnation, oldest first and without a gap in their numbers. Its last ones may be absent:
/// it need not have written them.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "{F}EarlierStates")]
pub struct EarlierStates<F> {
    /// The incarnation of the device node that published them.
    pub boot_id: BootId,
    /// The states; their ages are those of this answer, too.
    pub entries: Vec<StateEntry<F>>,
}

/// One state as it was published, without what no verdict needs.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "{F}Entry")]
pub struct StateEntry<F> {
    /// The number that it was published with.
    pub seq: u64,
    /// So long before this answer, s of machine time on the device node's boot-time clock.
    pub age_s: f64,
    /// How old each reading was when this was published, s of machine time, by its ASCOM name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub reading_ages_s: BTreeMap<String, f64>,
    /// Did the device answer?
    pub link: Link,
    /// What nodes decide with.
    pub fields: F,
}
