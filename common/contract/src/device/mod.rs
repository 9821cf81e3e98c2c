//! The ten ASCOM kinds: what each can do, what is true of it, and what it may be asked.

pub mod camera;
pub mod cover_calibrator;
pub mod dome;
pub mod filter_wheel;
pub mod focuser;
pub mod observing_conditions;
pub mod record;
pub mod rotator;
pub mod safety_monitor;
pub mod switch;
pub mod telescope;
pub mod vendor;

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{CommandId, NoData, Payload, Reading};

/// An ASCOM device type.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A mount.
    Telescope,
    /// A camera.
    Camera,
    /// A filter wheel.
    FilterWheel,
    /// A focuser.
    Focuser,
    /// A dome or roof.
    Dome,
    /// Something that says safe or not.
    SafetyMonitor,
    /// A weather station.
    ObservingConditions,
    /// A mirror cover or flat panel.
    CoverCalibrator,
    /// A set of switches.
    Switch,
    /// A field rotator.
    Rotator,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 10] = [
        Self::Telescope,
        Self::Camera,
        Self::FilterWheel,
        Self::Focuser,
        Self::Dome,
        Self::SafetyMonitor,
        Self::ObservingConditions,
        Self::CoverCalibrator,
        Self::Switch,
        Self::Rotator,
    ];

    /// As it stands in keys and in Alpaca paths: lower case.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Telescope => "telescope",
            Self::Camera => "camera",
            Self::FilterWheel => "filterwheel",
            Self::Focuser => "focuser",
            Self::Dome => "dome",
            Self::SafetyMonitor => "safetymonitor",
            Self::ObservingConditions => "observingconditions",
            Self::CoverCalibrator => "covercalibrator",
            Self::Switch => "switch",
            Self::Rotator => "rotator",
        }
    }

    /// As ASCOM and the FITS-header table write it: `FilterWheel`.
    pub const fn ascom(self) -> &'static str {
        match self {
            Self::Telescope => "Telescope",
            Self::Camera => "Camera",
            Self::FilterWheel => "FilterWheel",
            Self::Focuser => "Focuser",
            Self::Dome => "Dome",
            Self::SafetyMonitor => "SafetyMonitor",
            Self::ObservingConditions => "ObservingConditions",
            Self::CoverCalibrator => "CoverCalibrator",
            Self::Switch => "Switch",
            Self::Rotator => "Rotator",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A word that names no ASCOM device type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no ASCOM device type; expected one of telescope, camera, filterwheel, focuser, dome, safetymonitor, observingconditions, covercalibrator, switch, rotator"
)]
pub struct UnknownKind(String);

impl FromStr for Kind {
    type Err = UnknownKind;
    fn from_str(text: &str) -> Result<Self, UnknownKind> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.word().eq_ignore_ascii_case(text))
            .ok_or_else(|| UnknownKind(text.to_owned()))
    }
}

/// Ties a kind to its three payloads.
pub trait DeviceKind: Send + Sync + 'static {
    /// Which kind.
    const KIND: Kind;
    /// What such a device can do.
    type Capabilities: Payload;
    /// What nodes decide with.
    type Fields: Payload + Default;
    /// What it may be asked.
    type Command: Payload;
}

/// Calls a function that is generic over [`DeviceKind`] for the kind that is known at run time only.
macro_rules! of_kind {
    ($kind:expr, $function:ident) => {
        match $kind {
            Kind::Telescope => $function::<crate::device::telescope::Telescope>(),
            Kind::Camera => $function::<crate::device::camera::Camera>(),
            Kind::FilterWheel => $function::<crate::device::filter_wheel::FilterWheel>(),
            Kind::Focuser => $function::<crate::device::focuser::Focuser>(),
            Kind::Dome => $function::<crate::device::dome::Dome>(),
            Kind::SafetyMonitor => $function::<crate::device::safety_monitor::SafetyMonitor>(),
            Kind::ObservingConditions => $function::<crate::device::observing_conditions::ObservingConditions>(),
            Kind::CoverCalibrator => $function::<crate::device::cover_calibrator::CoverCalibrator>(),
            Kind::Switch => $function::<crate::device::switch::Switch>(),
            Kind::Rotator => $function::<crate::device::rotator::Rotator>(),
        }
    };
}
pub(crate) use of_kind;

/// The link between a device node and its device.
#[derive(Debug, Clone, PartialEq, Eq, Default, JsonSchema, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum Link {
    /// Not yet connected since the node started.
    #[default]
    Connecting,
    /// The device answers.
    Connected,
    /// The device does not answer; the node keeps trying.
    Lost {
        /// Why.
        reason: NoData,
    },
}

/// How a command ended, or that it has not.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum CommandOutcome {
    /// Still being done.
    Running,
    /// Done, as seen in the device's own state.
    Done,
    /// Not done.
    Failed {
        /// Why.
        reason: String,
    },
}

/// The newest command that a device was given.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct LastCommand {
    /// Its id.
    pub id: CommandId,
    /// The sender.
    pub from: String,
    /// What was asked, such as `open_shutter`.
    pub verb: String,
    /// Sky time when it was taken.
    pub taken_utc: Utc,
    /// How it went.
    pub outcome: CommandOutcome,
    /// What the device answered to a command of its maker's own; absent for all others, and until it has answered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer: Option<String>,
}

/// What is true of a device now, `F` being the typed fields of its kind (or plain JSON for a reader of all kinds).
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct DeviceState<F> {
    /// Does the device answer?
    pub link: Link,
    /// True while something moves, exposes or is read out, and while that is unknown.
    pub busy: bool,
    /// How often this state is published, s of machine time, at least; silence of five times that is a loss.
    pub period_s: f64,
    /// How often the device is asked for what nodes decide with, s of machine time; absent in states of versions that
    /// did not report it; then it is `period_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poll_s: Option<f64>,
    /// The newest command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_command: Option<LastCommand>,
    /// What nodes decide with.
    pub fields: F,
    /// Everything that was polled, under its ASCOM name.
    pub readings: BTreeMap<String, Reading>,
}

impl<F> DeviceState<F> {
    /// Is command `id` the newest one, ended well, and nothing moves any more?
    pub fn has_done(&self, id: &CommandId) -> bool {
        !self.busy
            && self.last_command.as_ref().is_some_and(|last| last.id == *id && last.outcome == CommandOutcome::Done)
    }

    /// How old a property's reading was when this was sent, s of machine time; `None` where it was not read, or by
    /// a version that did not report it.
    pub fn age_s(&self, property: &str) -> Option<f64> {
        self.readings.get(property)?.age_s
    }

    /// The same state with other fields.
    pub fn map<G>(self, change: impl FnOnce(F) -> G) -> DeviceState<G> {
        DeviceState {
            link: self.link,
            busy: self.busy,
            period_s: self.period_s,
            poll_s: self.poll_s,
            last_command: self.last_command,
            fields: change(self.fields),
            readings: self.readings,
        }
    }
}

impl<F: Payload> Payload for DeviceState<F> {
    const NAME: &'static str = F::NAME;
}

impl Payload for serde_json::Value {
    const NAME: &'static str = "any";
}

/// What a device can do, with what it says of itself.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct DeviceDescription<C> {
    /// The Alpaca server, `host:port`, and the device's number there.
    pub server: String,
    /// Number on that server.
    pub number: u32,
    /// ASCOM `Name`.
    pub device_name: String,
    /// ASCOM `DriverInfo` and `DriverVersion`.
    pub driver: String,
    /// ASCOM `InterfaceVersion`.
    pub interface_version: i64,
    /// True where the server says that it is a simulator of ours, which alone may run at another speed than 1.
    pub simulated: bool,
    /// What the kind can do. Where it could not be read, flags are true, so that the device decides.
    pub can: C,
    /// Properties of that which could not be read, by their ASCOM names, and why; they are asked for again.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub unread: BTreeMap<String, NoData>,
}

impl<C: Payload> Payload for DeviceDescription<C> {
    const NAME: &'static str = C::NAME;
}
