//! What an archive node says and answers.

use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::frame_search::{FoundFrame, FrameSearch};
use crate::log_search::LogSearch;
use crate::observatory::Priority;
use crate::{CommandId, Kind, Payload, Scalar};

/// A file is safe on disk; information, not the acknowledgement to the spool (that is `release`).
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Stored {
    /// Which frame.
    pub frame: CommandId,
    /// Configured name of the camera.
    pub camera: String,
    /// Path of the file, relative to the archive's image folder.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// All keywords are in the header.
    pub header_complete: bool,
}

impl Payload for Stored {
    const NAME: &'static str = "archive.stored";
}

/// A question about the past.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ArchiveQuestion {
    /// What is asked.
    pub ask: Ask,
    /// From this sky time on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_utc: Option<Utc>,
    /// Before this sky time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_utc: Option<Utc>,
    /// At most so many rows, the newest; 1000 where absent, never more than 100,000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
}

impl Payload for ArchiveQuestion {
    const NAME: &'static str = "archive.question";
}

/// Properties of one question, at most.
pub const MOST_PROPERTIES: usize = 64;

/// What may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ask {
    /// Polled values of one property.
    Readings {
        /// Kind of the device.
        kind: Kind,
        /// Its configured name.
        device: String,
        /// ASCOM name of the property.
        property: String,
    },
    /// Several properties over any time, drawn with few points: the extremes of each piece of time are kept. A question
    /// without `from_utc` begins a day before `to_utc`, or before now.
    Series {
        /// The properties, at most 64.
        properties: Vec<SeriesName>,
        /// At most so many points of each; together never more than 30,000.
        points: u32,
    },
    /// Frames.
    Frames,
    /// Frames by what they show, with their quality; the newest that meet the conditions.
    FindFrames(Box<FrameSearch>),
    /// Log lines.
    Log,
    /// Log lines that meet conditions. Lines of one instant are never parted: where the limit would, the answer has more.
    FindLog(Box<LogSearch>),
    /// Records of the audit, of all nodes of the telescope.
    Audit,
    /// Corrections of the guide loop.
    Corrections,
    /// Alerts that stood in that time, also those that are over, in the order in which they were raised.
    Alerts,
}

/// A property of a device.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SeriesName {
    /// Kind of the device.
    pub kind: Kind,
    /// Its configured name.
    pub device: String,
    /// ASCOM name of the property.
    pub property: String,
}

/// A text that names no property of a device.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no property: expected KIND/DEVICE/PROPERTY with the configured name and ASCOM's name, such as observingconditions/wx/WindGust"
)]
pub struct BadSeriesName(String);

impl FromStr for SeriesName {
    type Err = BadSeriesName;

    /// Reads `observingconditions/wx/WindGust`.
    fn from_str(text: &str) -> Result<Self, BadSeriesName> {
        let parts: Vec<&str> = text.trim().split('/').collect();
        match (parts.first().map(|kind| kind.parse()), &parts[..]) {
            (Some(Ok(kind)), [_, device, property]) if !device.is_empty() && !property.is_empty() => {
                Ok(Self { kind, device: (*device).to_owned(), property: (*property).to_owned() })
            }
            _ => Err(BadSeriesName(text.to_owned())),
        }
    }
}

/// The answer, oldest row first.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ArchiveAnswer {
    /// The rows.
    pub rows: Vec<ArchiveRow>,
    /// True where rows were left out: older ones by the limit, or those of [`Self::cut`].
    pub truncated: bool,
    /// Why rows are left out for another reason than the limit, and how to ask for less at a time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut: Option<String>,
}

impl Payload for ArchiveAnswer {
    const NAME: &'static str = "archive.answer";
}

/// One row of an answer.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArchiveRow {
    /// A polled value.
    Reading {
        /// Sky time of the poll.
        at_utc: Utc,
        /// The value; absent where there was none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        value: Option<Scalar>,
    },
    /// One of the properties of a question about series.
    Series(Series),
    /// A frame.
    Frame {
        /// Which frame.
        id: CommandId,
        /// Sky time of its start.
        at_utc: Utc,
        /// Configured name of the camera.
        camera: String,
        /// Path relative to the image folder.
        file: String,
        /// All keywords are in the header.
        header_complete: bool,
    },
    /// A frame of a question about frames that meet conditions.
    FoundFrame(Box<FoundFrame>),
    /// A log line.
    Log {
        /// Sky time.
        at_utc: Utc,
        /// `error`, `warn` or `info`.
        level: crate::node::Level,
        /// Role and id of the node.
        node: String,
        /// What it says.
        message: String,
    },
    /// A record of the audit.
    Audit(Box<crate::audit::AuditRecord>),
    /// A correction of the guide loop.
    Correction(Box<crate::observatory::Correction>),
    /// An alert that stood, whether or not it is over.
    Alert(PastAlert),
}

/// An alert as the archive knows it: raised again after it was over, it is another one of the same id.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct PastAlert {
    /// Names the cause, such as `dome-not-closed/dome_1`.
    pub id: String,
    /// How urgent.
    pub priority: Priority,
    /// Sky time when it was raised.
    pub raised_utc: Utc,
    /// Sky time when it was over; absent while it stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cleared_utc: Option<Utc>,
    /// What happened, as it was said last.
    pub cause: String,
    /// The person who saw to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledged_by: Option<String>,
}

/// A property over a time.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Series {
    /// Which property.
    #[serde(flatten)]
    pub property: SeriesName,
    /// How long the piece of time of a point is; 0 where each point is one reading.
    pub piece_s: f64,
    /// Oldest first; a piece of time without a value has no point.
    pub points: Vec<SeriesPoint>,
    /// Times without a value that are longer than three times what is usual for the property.
    pub gaps: Vec<Gap>,
}

/// What was read in a piece of time.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SeriesPoint {
    /// Sky time at which the piece begins, or its first value where a gap reaches into it; of a single reading, its own.
    pub at_utc: Utc,
    /// Values read.
    pub count: u64,
    /// The smallest, for numbers; true counts as 1, false as 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// The mean, for numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean: Option<f64>,
    /// The largest, for numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// The last value, for text and lists.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<Scalar>,
}

/// A time without a value.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Gap {
    /// The last value before it, or the beginning of what was asked.
    pub from_utc: Utc,
    /// The first value after it, or the end of what was asked, but not later than now.
    pub to_utc: Utc,
}
