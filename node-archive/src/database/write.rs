//! What is written into the database.

use std::path::PathBuf;

use contract::device::camera::Frame;
use contract::node::Level;
use contract::observatory::{Correction, FocusRun, FrameFacts};
use contract::{BootId, CommandId, Device, Scalar};
use units::Utc;

/// One thing to be written.
#[derive(Debug, Clone)]
pub enum Write {
    /// A polled value, or why there was none.
    Reading {
        /// Whose.
        device: Device,
        /// ASCOM name of the property.
        property: String,
        /// The value.
        value: Result<Scalar, String>,
        /// Sky time of the poll.
        at: Utc,
        /// The message that brought it.
        said: (BootId, u64),
    },
    /// A line of a node's diary.
    Log {
        /// Of which telescope.
        telescope: String,
        /// Role and id of the node.
        node: String,
        /// Module that wrote it.
        target: String,
        /// How much it matters.
        level: Level,
        /// What it says.
        message: String,
        /// Sky time.
        at: Utc,
        /// The message that brought it.
        said: (BootId, u64),
    },
    /// A frame's file is about to get this name.
    Writing {
        /// Which frame.
        frame: CommandId,
        /// Path relative to the folder of images.
        file: String,
    },
    /// A frame's file is safe under its name; a row that is there already stays.
    Stored(Box<StoredImage>),
    /// What the camera's node announces of a frame whose row is there.
    Announced(Box<Frame>),
    /// A header is complete.
    Complete(CommandId),
    /// A record of a node's audit.
    Audit(Box<StoredRecord>),
    /// What guiding did about a frame.
    Correction(Box<StoredCorrection>),
    /// What was measured on a frame.
    Facts(Box<StoredFacts>),
    /// A focus run that has ended.
    Focus(Box<StoredRun>),
    /// The facts of a message stand in the header of their frame, or could not be put there.
    FactsTaken {
        /// Which frame.
        frame: CommandId,
        /// The message that brought them.
        said: (BootId, u64),
        /// Whether they stand there.
        in_header: bool,
    },
}

/// A row of the table of the audit.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRecord {
    /// Which node wrote it, such as `device/callisto/main`.
    pub node: String,
    /// Its chain.
    pub chain: String,
    /// Its number there; -1 where it cannot be read.
    pub number: i64,
    /// Sky time, where it can be read.
    pub at: Option<Utc>,
    /// Who asked.
    pub from: String,
    /// The device, empty for an order.
    pub device: String,
    /// What was asked.
    pub verb: String,
    /// Fencing token.
    pub token: Option<i64>,
    /// What became of it, one word.
    pub outcome: String,
    /// The whole record, as its node wrote it.
    pub line: String,
    /// Its hash.
    pub sha256: String,
    /// What is wrong with it or with its place in the chain.
    pub fault: Option<String>,
}

/// A row of the table of images.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredImage {
    /// What the device node said of the frame.
    pub frame: Frame,
    /// Absolute path of the file.
    pub path: PathBuf,
    /// Path relative to the folder of images, with `/` on every system.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// Sky time when it was stored.
    pub stored: Utc,
}

/// A correction with the message that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredCorrection {
    /// What was done.
    pub correction: Correction,
    /// Of which telescope.
    pub telescope: String,
    /// Life of the node that said it, and its number.
    pub said: (BootId, u64),
}

/// Facts with the message that brought them.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredFacts {
    /// What was measured, or why not.
    pub facts: FrameFacts,
    /// Sky time when it was said.
    pub at: Utc,
    /// Life of the node that said it, and number on the frame's key.
    pub said: (BootId, u64),
}

/// A run with the message that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRun {
    /// The run.
    pub run: FocusRun,
    /// Its plot, relative to the folder of images, with `/` on every system.
    pub plot: String,
    /// Sky time when it was said.
    pub at: Utc,
    /// Life of the node that said it, and number on its key.
    pub said: (BootId, u64),
}
