//! A field rotator.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Datum, DeviceKind, Kind, Payload};

/// The rotator, ASCOM Rotator.
#[derive(Debug)]
pub struct Rotator;

impl DeviceKind for Rotator {
    const KIND: Kind = Kind::Rotator;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a rotator can do.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "RotatorCapabilities")]
pub struct Capabilities {
    /// Can turn the other way round.
    pub reverse: bool,
    /// Size of a step, degrees; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_deg: Option<f64>,
}

impl Payload for Capabilities {
    const NAME: &'static str = "rotator.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "RotatorFields")]
pub struct Fields {
    /// Position angle on the sky, degrees.
    pub position_deg: Datum<f64>,
    /// Mechanical angle, degrees.
    pub mechanical_deg: Datum<f64>,
    /// Turns.
    pub moving: Datum<bool>,
}

impl Payload for Fields {
    const NAME: &'static str = "rotator.state";
}

/// What a rotator may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "RotatorCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Turn to a position angle on the sky.
    Move {
        /// Degrees.
        position_deg: f64,
    },
    /// Stop.
    Abort,
}

impl Payload for Command {
    const NAME: &'static str = "rotator.command";
}
