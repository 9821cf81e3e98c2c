//! What an archive node says and answers.

use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{CommandId, Kind, Payload, Scalar};

/// A file is safe on disk; information, not the acknowledgement to the spool (that is `release`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Question {
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

impl Payload for Question {
    const NAME: &'static str = "archive.question";
}

/// What may be asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// Frames.
    Frames,
    /// Log lines.
    Log,
    /// Records of the audit, of all nodes of the telescope.
    Audit,
}

/// The answer, oldest row first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The rows.
    pub rows: Vec<Row>,
    /// True where older rows were left out by the limit.
    pub truncated: bool,
}

impl Payload for Answer {
    const NAME: &'static str = "archive.answer";
}

/// One row of an answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Row {
    /// A polled value.
    Reading {
        /// Sky time of the poll.
        at_utc: Utc,
        /// The value; absent where there was none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        value: Option<Scalar>,
    },
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
    Audit(Box<crate::audit::Record>),
}
