//! The devices: the ten ASCOM types, and a second camera.

use serde::{Deserialize, Serialize};

/// A device: one of each of the ten ASCOM types with device number 0, and the guide camera, which is camera 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The mount.
    Telescope,
    /// The imaging camera.
    Camera,
    /// The filter wheel before the camera.
    FilterWheel,
    /// The focuser.
    Focuser,
    /// Dome and shutter.
    Dome,
    /// The site's own safety monitor.
    SafetyMonitor,
    /// The weather station.
    ObservingConditions,
    /// Telescope cover and flat panel.
    CoverCalibrator,
    /// Power sockets and the UPS.
    Switch,
    /// The camera rotator.
    Rotator,
    /// The camera of the guide scope; in no list, since few observatories have one.
    GuideCamera,
}

impl Kind {
    /// All ten.
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

    /// The name in ASCOM's own case, as the management API lists it.
    pub fn ascom(self) -> &'static str {
        match self {
            Self::Telescope => "Telescope",
            Self::Camera | Self::GuideCamera => "Camera",
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

    /// Its device number.
    pub fn number(self) -> u32 {
        u32::from(self == Self::GuideCamera)
    }

    /// The type as it stands in the address of a device, lower case.
    pub fn path(self) -> String {
        self.ascom().to_ascii_lowercase()
    }

    /// The device of an address, or None.
    pub fn at(path: &str, number: &str) -> Option<Self> {
        match (path, number) {
            ("camera", "1") => Some(Self::GuideCamera),
            (_, "0") => Self::ALL.into_iter().find(|kind| kind.path() == path),
            _ => None,
        }
    }

    /// The device of a name in an order to the simulator: a type in lower case, or `guidecamera`.
    pub fn from_name(name: &str) -> Option<Self> {
        if name == "guidecamera" { Some(Self::GuideCamera) } else { Self::at(name, "0") }
    }

    /// Interface version of ASCOM Platform 7.
    pub fn interface_version(self) -> u32 {
        match self {
            Self::ObservingConditions | Self::CoverCalibrator => 2,
            Self::FilterWheel | Self::Dome | Self::SafetyMonitor | Self::Switch => 3,
            Self::Telescope | Self::Camera | Self::GuideCamera | Self::Focuser | Self::Rotator => 4,
        }
    }
}
