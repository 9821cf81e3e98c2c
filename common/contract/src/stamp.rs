//! The envelope that every payload travels in: who sent it, in which order, and when.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

/// Names one incarnation of one node process; a restarted node has a new one.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct BootId(String);

/// Receivers remember ids by the thousand: a longer one is no id.
pub(crate) const MOST_ID_BYTES: usize = 128;

impl TryFrom<String> for BootId {
    type Error = String;

    fn try_from(id: String) -> Result<Self, Self::Error> {
        match id.len() {
            0..=MOST_ID_BYTES => Ok(Self(id)),
            bytes => Err(format!("a boot id of {bytes} bytes; expected at most {MOST_ID_BYTES}")),
        }
    }
}

impl BootId {
    /// A fresh id, never seen before. The order of two ids says nothing about which incarnation is the newer one, since
    /// clocks may be set back: the order of arrival decides (`interlock::Succession`).
    pub fn fresh() -> Self {
        Self(uuid::Uuid::now_v7().to_string())
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for BootId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A payload with its sender's boot id, sequence number and stamp; flat in JSON.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Stamped<T> {
    /// The sender's incarnation.
    pub boot_id: BootId,
    /// Counts from 0 per key within one incarnation, so that a gap is seen and a repeat is harmless.
    pub seq: u64,
    /// Sky time of the sender when it sent this; for the record, never for judging an age.
    pub at_utc: Utc,
    /// The sender's boot-time clock when it sent this, s. Only the difference of two payloads of one boot id means
    /// something: by it a receiver sees how much longer than others this one was on its way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sent_s: Option<f64>,
    /// For so long the sender had held this when it answered a question with it, s by its boot-time clock; absent from
    /// what is published.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_s: Option<f64>,
    /// The payload.
    #[serde(flatten)]
    pub body: T,
}
