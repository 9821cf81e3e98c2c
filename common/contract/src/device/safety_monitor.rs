//! A safety monitor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::record::StateRecord;
use crate::{Datum, DeviceKind, Kind, Payload};

/// The safety monitor, ASCOM SafetyMonitor.
#[derive(Debug)]
pub struct SafetyMonitor;

impl DeviceKind for SafetyMonitor {
    const KIND: Kind = Kind::SafetyMonitor;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// A safety monitor only speaks.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SafetyMonitorCapabilities")]
pub struct Capabilities {}

impl Payload for Capabilities {
    const NAME: &'static str = "safetymonitor.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SafetyMonitorFields")]
pub struct Fields {
    /// JSON `true` from the device is the only way to be safe.
    pub is_safe: Datum<bool>,
    /// Length of the gapless record of safe readings that ends now, s of sky time; it outlives the observatory
    /// node, so that a restarted one need not wait again. 0 after any unsafe or missing reading.
    pub gapless_safe_s: f64,
}

impl Payload for Fields {
    const NAME: &'static str = "safetymonitor.state";
}

impl Payload for StateRecord<Fields> {
    const NAME: &'static str = "safetymonitor.record";
}

/// Nothing can be asked of a safety monitor.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "SafetyMonitorCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {}

impl Payload for Command {
    const NAME: &'static str = "safetymonitor.command";
}
