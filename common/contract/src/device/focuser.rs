//! A focuser.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Datum, DeviceKind, Kind, Payload};

/// The focuser, ASCOM Focuser.
#[derive(Debug)]
pub struct Focuser;

impl DeviceKind for Focuser {
    const KIND: Kind = Kind::Focuser;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a focuser can do.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FocuserCapabilities")]
pub struct Capabilities {
    /// Knows its position.
    pub absolute: bool,
    /// Largest position, steps; 0 where it is not known, so that the driver decides.
    pub max_step: i64,
    /// Size of a step, micrometres.
    pub step_um: Datum<f64>,
    /// Most steps of one move; absent where that is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_increment: Option<i64>,
}

impl Capabilities {
    /// The last position, steps; `None` where it is not known.
    pub fn last_position(&self) -> Option<i64> {
        Some(self.max_step).filter(|last| *last > 0)
    }
}

impl Payload for Capabilities {
    const NAME: &'static str = "focuser.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FocuserFields")]
pub struct Fields {
    /// Position, steps.
    pub position: Datum<i64>,
    /// Moves.
    pub moving: Datum<bool>,
    /// Temperature of the tube, degrees Celsius.
    pub temperature_c: Datum<f64>,
}

impl Payload for Fields {
    const NAME: &'static str = "focuser.state";
}

/// What a focuser may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FocuserCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Go to a position.
    Move {
        /// Steps.
        position: i64,
    },
    /// Stop.
    Abort,
}

impl Payload for Command {
    const NAME: &'static str = "focuser.command";
}
