//! The texts of schedules: the active one, those before it, and the list of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;

/// Asks for the text of a schedule, or for the list of all that were active.
#[derive(Debug, Clone, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleTextQuestion {
    /// The version that is wanted; the active text where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<u64>,
    /// The newest versions, at most so many (1000), and no text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub list: Option<u32>,
    /// Only versions before this one are listed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<u64>,
}

impl Payload for ScheduleTextQuestion {
    const NAME: &'static str = "schedule.text_question";
}

/// A text, or the list of versions.
#[derive(Debug, Clone, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleTexts {
    /// The text that was asked for; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// SHA-256 of this text, as lower-case hex.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// The versions that were asked for, the newest first; of a text its own, where it is stored as one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub versions: Vec<ScheduleVersion>,
    /// Why a text or a list that there is cannot be given. Absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl Payload for ScheduleTexts {
    const NAME: &'static str = "schedule.texts";
}

/// A schedule that was active, as the observatory node stored it.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ScheduleVersion {
    /// Counts up from 1.
    pub version: u64,
    /// Sky time when it was taken.
    pub at_utc: Utc,
    /// Its author, such as `web/ana`; `file` for a person or program that wrote the file itself.
    pub author: String,
    /// Why, in their words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Rows.
    pub rows: u32,
    /// Length of the text.
    pub bytes: u64,
    /// SHA-256 of the text, as lower-case hex.
    pub sha256: String,
}
