//! A mirror cover, a flat panel, or both.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Datum, DeviceKind, Kind, Payload};

/// The cover and flat panel, ASCOM CoverCalibrator.
#[derive(Debug)]
pub struct CoverCalibrator;

impl DeviceKind for CoverCalibrator {
    const KIND: Kind = Kind::CoverCalibrator;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What it has.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CoverCalibratorCapabilities")]
pub struct Capabilities {
    /// Has a cover.
    pub cover: bool,
    /// Has a panel.
    pub calibrator: bool,
    /// Largest brightness of the panel, device units; 0 where it is not known, so that the panel decides.
    pub max_brightness: i64,
}

impl Payload for Capabilities {
    const NAME: &'static str = "covercalibrator.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CoverCalibratorFields")]
pub struct Fields {
    /// The cover.
    pub cover: Datum<Cover>,
    /// The panel.
    pub calibrator: Datum<Calibrator>,
    /// Brightness, device units.
    pub brightness: Datum<i64>,
}

impl Payload for Fields {
    const NAME: &'static str = "covercalibrator.state";
}

/// ASCOM CoverStatus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cover {
    /// There is none.
    NotPresent,
    /// Closed.
    Closed,
    /// Moves.
    Moving,
    /// Open.
    Open,
    /// Not known.
    Unknown,
    /// In error.
    Error,
}

/// ASCOM CalibratorStatus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Calibrator {
    /// There is none.
    NotPresent,
    /// Dark.
    Off,
    /// Warms up or fades.
    NotReady,
    /// Lit and steady.
    Ready,
    /// Not known.
    Unknown,
    /// In error.
    Error,
}

/// What it may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CoverCalibratorCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Open the cover.
    OpenCover,
    /// Close the cover.
    CloseCover,
    /// Stop the cover.
    HaltCover,
    /// Light the panel.
    CalibratorOn {
        /// Device units, from 0 to `max_brightness`.
        brightness: i64,
    },
    /// Darken the panel.
    CalibratorOff,
}

impl Payload for Command {
    const NAME: &'static str = "covercalibrator.command";
}
