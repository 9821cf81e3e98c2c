//! A set of switches and gauges, such as power and UPS.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::record::StateRecord;
use crate::{Datum, DeviceKind, Kind, Payload};

/// The switches, ASCOM Switch.
#[derive(Debug)]
pub struct Switch;

impl DeviceKind for Switch {
    const KIND: Kind = Kind::Switch;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What it has.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SwitchCapabilities")]
pub struct Capabilities {
    /// The switches by number.
    pub switches: Vec<SwitchDescription>,
}

impl Payload for Capabilities {
    const NAME: &'static str = "switch.capabilities";
}

/// One switch.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct SwitchDescription {
    /// Its name.
    pub name: String,
    /// Can be set.
    pub can_write: bool,
    /// Smallest value; the least number there is while it could not be read.
    pub minimum: f64,
    /// Largest value; the largest number there is while it could not be read.
    pub maximum: f64,
    /// Distance of its values; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SwitchFields")]
pub struct Fields {
    /// Values by number, in the switch's own unit.
    pub values: Vec<Datum<f64>>,
}

impl Payload for Fields {
    const NAME: &'static str = "switch.state";
}

impl Payload for StateRecord<Fields> {
    const NAME: &'static str = "switch.record";
}

/// The number of the switch that a property is the value of: 3 for `GetSwitchValue3`.
pub fn number_of(property: &str) -> Option<usize> {
    property.strip_prefix("GetSwitchValue")?.parse().ok()
}

/// What it may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SwitchCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Set a switch.
    Set {
        /// Number of the switch, from 0.
        number: u32,
        /// Value in the switch's own unit.
        value: f64,
    },
}

impl Payload for Command {
    const NAME: &'static str = "switch.command";
}
