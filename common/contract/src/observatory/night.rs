//! Posture, what is being done, and who commands.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::Trigger;
use crate::device::dome::Shutter;
use crate::{CommandId, Payload};

/// How the observatory stands to the sky.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Posture {
    /// Every enclosure is verified closed.
    Closed,
    /// On the way to open.
    Opening,
    /// At least one enclosure is open.
    Open,
    /// On the way to closed.
    Closing,
    /// Not known; treated as open.
    Unknown,
}

impl Posture {
    /// Its word, as it stands in payloads.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::Opening => "opening",
            Self::Open => "open",
            Self::Closing => "closing",
            Self::Unknown => "unknown",
        }
    }

    /// That of an enclosure by its shutter; whoever doubts a shutter passes none.
    pub const fn of_shutter(shutter: Option<Shutter>) -> Self {
        match shutter {
            None | Some(Shutter::Error) => Self::Unknown,
            Some(Shutter::Open) => Self::Open,
            Some(Shutter::Opening) => Self::Opening,
            Some(Shutter::Closing) => Self::Closing,
            Some(Shutter::Closed) => Self::Closed,
        }
    }

    /// The least closed of several; `None` where there are none.
    pub fn least_closed(each: impl Iterator<Item = Self>) -> Option<Self> {
        each.max_by_key(|posture| match posture {
            Self::Closed => 0,
            Self::Closing => 1,
            Self::Opening => 2,
            Self::Open => 3,
            Self::Unknown => 4,
        })
    }
}

/// What the observatory is doing, every second and at each change.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct NightState {
    /// Works through the schedule by itself.
    pub robotic: bool,
    /// How it stands.
    pub posture: Posture,
    /// The action under way; one per camera that works.
    pub actions: Vec<ActionNow>,
    /// Frames announced since this node started.
    pub frames: u64,
    /// Sky seconds with an open enclosure since this node started.
    pub open_s: f64,
    /// Speed of sky time; 1 except in a simulation.
    pub speed: f64,
    /// True when the devices are simulated.
    pub simulated: bool,
    /// The last row of the schedule has ended and everything is closed.
    pub ended: bool,
    /// The newest frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_frame: Option<CommandId>,
    /// What the newest frames say together; empty while all is well.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub triggers: Vec<Trigger>,
    /// The newest order that this node accepted: whoever gave it sees here that it arrived.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_order: Option<OrderTaken>,
}

/// An order that was accepted.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OrderTaken {
    /// Its id.
    pub id: CommandId,
    /// The person who ordered, such as `cli/ana@dome-pc`.
    pub from: String,
    /// What, such as `close`.
    pub verb: String,
    /// Sky time when it was accepted.
    pub at_utc: Utc,
    /// The night that it is about, `YYYYMMDD`, where it is about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub night: Option<String>,
}

impl Payload for NightState {
    const NAME: &'static str = "observatory.night";
}

/// An action under way.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ActionNow {
    /// Row of the schedule, from 0; people count from 1.
    pub row: u32,
    /// Type, such as `object`.
    pub action: String,
    /// Camera it works with.
    pub camera: String,
    /// Object, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// What it does now, in words: `slewing`, `exposing 3 of 10, 30 s, V`.
    pub step: String,
    /// Sky time of its start.
    pub started_utc: Utc,
    /// Sky time by which the step should have ended, where that can be told: beyond it, `step-overdue` is an alert.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_by_utc: Option<Utc>,
}

/// The node that commands this telescope.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Lease {
    /// The commander, empty while there is none.
    pub holder: String,
    /// Its fencing token.
    pub token: u64,
    /// Sky time since when.
    pub since_utc: Utc,
    /// The device node that granted it, such as `dome/dome_1`.
    pub arbiter: String,
}

impl Payload for Lease {
    const NAME: &'static str = "observatory.lease";
}
