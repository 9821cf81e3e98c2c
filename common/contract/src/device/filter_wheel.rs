//! A filter wheel.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Datum, DeviceKind, Kind, Payload};

/// The filter wheel, ASCOM FilterWheel.
#[derive(Debug)]
pub struct FilterWheel;

impl DeviceKind for FilterWheel {
    const KIND: Kind = Kind::FilterWheel;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a filter wheel has.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FilterWheelCapabilities")]
pub struct Capabilities {
    /// Names of its filters by position, from 0.
    pub names: Vec<String>,
    /// Focus offsets by position, focuser steps.
    pub focus_offsets: Vec<i64>,
}

impl Payload for Capabilities {
    const NAME: &'static str = "filterwheel.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FilterWheelFields")]
pub struct Fields {
    /// Position from 0; missing while the wheel turns.
    pub position: Datum<u32>,
    /// Name of the filter in the beam.
    pub filter: Datum<String>,
}

impl Payload for Fields {
    const NAME: &'static str = "filterwheel.state";
}

/// What a filter wheel may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "FilterWheelCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Turn to a position.
    Turn {
        /// From 0.
        position: u32,
    },
}

impl Payload for Command {
    const NAME: &'static str = "filterwheel.command";
}
