//! The things that are written into the database.

use std::path::{Path, PathBuf};

use bus::Gap;
use contract::device::camera::Frame;
use contract::node::Level;
use contract::observatory::{Alert, Correction, FocusRun, FrameFacts, RowState};
use contract::{BootId, CommandId, Device, Key, Scalar};
use units::Utc;

/// One thing to be written.
#[derive(Debug, Clone)]
pub enum Write {
    /// A polled value, or why there was none.
    Reading {
        /// The device.
        device: Device,
        /// ASCOM name of the property.
        property: String,
        /// The value.
        value: Result<Scalar, String>,
        /// Sky time of the poll.
        at: Utc,
    },
    /// All rows of a sample are handed over.
    Received {
        /// Its key.
        key: Key,
        /// Incarnation and sequence number of the sample.
        origin: (BootId, u64),
        /// Sky time when it was published.
        at: Utc,
    },
    /// Samples that nothing can bring any more.
    Lost(Gap),
    /// Some of the values that are older than the newest days are no longer needed.
    ForgetOld {
        /// So many days with values stay.
        days: u32,
    },
    /// A line of a node's diary.
    Log {
        /// The node's telescope.
        telescope: String,
        /// Role and id of the node.
        node: String,
        /// Module that wrote it.
        target: String,
        /// The level of the line.
        level: Level,
        /// The text of the line.
        message: String,
        /// Sky time.
        at: Utc,
        /// Incarnation and sequence number of the sample.
        origin: (BootId, u64),
    },
    /// A frame's file is about to get this name.
    Writing {
        /// Which frame.
        frame: CommandId,
        /// Path relative to the folder of images.
        file: String,
    },
    /// A frame's file is safe under its name, whose whole path on this host is here; a row that is there already stays.
    Stored(Box<StoredImage>, PathBuf),
    /// The camera node's announcement of a frame whose row exists.
    Announced(Box<Frame>),
    /// A header is complete.
    Complete(CommandId),
    /// A header is to be completed again.
    Recomplete(CommandId),
    /// A record of a node's audit.
    Audit(Box<StoredRecord>),
    /// A correction that guiding made.
    Correction(Box<StoredCorrection>),
    /// The facts that were measured on a frame.
    Facts(Box<StoredFacts>),
    /// A focus run that has ended.
    Focus(Box<StoredRun>),
    /// A state of the observatory node.
    State(Box<StoredState>),
    /// A row of the schedule.
    Row(Box<StoredRow>),
    /// The active alerts.
    Alerts(Box<StoredAlerts>),
    /// The fluxes of the stars of a frame.
    Fluxes(Box<StoredFluxes>),
    /// The facts of a sample are in the header of their frame, or its file is gone.
    FactsTaken {
        /// Which frame.
        frame: CommandId,
        /// Incarnation and sequence number of the sample.
        origin: (BootId, u64),
        /// Whether they are in the header.
        in_header: bool,
    },
}

/// A row of the table of the audit.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRecord {
    /// Which node wrote it, such as `device/callisto/main`.
    pub node: String,
    /// The chain of the record.
    pub chain: String,
    /// Its number there; -1 where it cannot be read.
    pub number: i64,
    /// Sky time, where it can be read.
    pub at: Option<Utc>,
    /// The person or node that asked.
    pub from: String,
    /// The device, empty for an order.
    pub device: String,
    /// The word of the command or order.
    pub verb: String,
    /// Fencing token.
    pub token: Option<i64>,
    /// The outcome, one word.
    pub outcome: String,
    /// The whole record, as its node wrote it.
    pub line: String,
    /// Its hash.
    pub sha256: String,
    /// The fault of the record, or of its place in the chain.
    pub fault: Option<String>,
}

/// A row of the table of images.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredImage {
    /// The frame as the device node announced it.
    pub frame: Frame,
    /// Path of its file relative to the folder of images, with `/` on every system.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// Sky time when it was stored.
    pub stored: Utc,
}

impl StoredImage {
    /// Where its file is: the folder of images may have moved since it was stored.
    pub fn path(&self, images: &Path) -> PathBuf {
        images.join(&self.file)
    }
}

/// A correction with the sample that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredCorrection {
    /// The correction.
    pub correction: Correction,
    /// The telescope.
    pub telescope: String,
    /// Incarnation of the node that published it, and sequence number.
    pub origin: (BootId, u64),
}

/// Facts with the sample that brought them.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredFacts {
    /// The facts, or the reason why there are none.
    pub facts: FrameFacts,
    /// Sky time when they were published.
    pub at: Utc,
    /// Incarnation of the node that published them, and sequence number on the frame's key.
    pub origin: (BootId, u64),
}

/// A run with the sample that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRun {
    /// The run.
    pub run: FocusRun,
    /// Its plot, relative to the folder of images, with `/` on every system.
    pub plot: String,
    /// Sky time when it was published.
    pub at: Utc,
    /// Incarnation of the node that published it, and sequence number on its key.
    pub origin: (BootId, u64),
}

/// A state of the observatory node with the sample that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredState {
    /// Which part of the node, such as `night`.
    pub part: &'static str,
    /// What makes it another state than the one before.
    pub same: String,
    /// The state, as JSON.
    pub state: String,
    /// Sky time when it was published.
    pub at: Utc,
    /// So long after the same state something may have happened in between, sky s.
    pub gap_s: f64,
    /// Incarnation of the node that published it, and sequence number on its key.
    pub origin: (BootId, u64),
}

/// A row of the schedule with the sample that brought it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRow {
    /// The row.
    pub row: RowState,
    /// Sky time when it was published.
    pub at: Utc,
    /// Incarnation of the node that published it, and sequence number on its key.
    pub origin: (BootId, u64),
}

/// The active alerts with the sample that brought them.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredAlerts {
    /// The alerts.
    pub alerts: Vec<Alert>,
    /// Sky time when they were published.
    pub at: Utc,
    /// Incarnation of the node that published them, and sequence number on their key.
    pub origin: (BootId, u64),
}

/// The fluxes of the stars of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredFluxes {
    /// Which frame.
    pub frame: CommandId,
    /// Frames whose fluxes can be compared have the same series.
    pub series: String,
    /// Where the stars of a new series are, ICRS degrees, the target first; empty for one that has its stars.
    pub new_stars: Vec<[f64; 2]>,
    /// The fluxes.
    pub fluxes: Vec<StarFlux>,
}

/// The flux of a star.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StarFlux {
    /// Which star of the series; 0 is the target.
    pub star: u32,
    /// Column, px.
    pub x_px: f64,
    /// Row, px.
    pub y_px: f64,
    /// Above the sky, ADU.
    pub flux_adu: f64,
    /// Its standard error, ADU.
    pub error_adu: f64,
    /// A pixel of it is saturated.
    pub is_saturated: bool,
}
