//! The ten ASCOM device types.

use serde::{Deserialize, Serialize};

/// An ASCOM device type; one device of each is in the observatory, all with device number 0.
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
    /// The site's own word on safety.
    SafetyMonitor,
    /// The weather station.
    ObservingConditions,
    /// Telescope cover and flat panel.
    CoverCalibrator,
    /// Power sockets and the UPS.
    Switch,
    /// The camera rotator.
    Rotator,
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

    /// The name as it stands in the address of a device, lower case.
    pub fn path(self) -> String {
        self.ascom().to_ascii_lowercase()
    }

    /// The device type of an address, or None.
    pub fn from_path(path: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.path() == path)
    }

    /// Interface version of ASCOM Platform 7.
    pub fn interface_version(self) -> u32 {
        match self {
            Self::ObservingConditions | Self::CoverCalibrator => 2,
            Self::FilterWheel | Self::Dome | Self::SafetyMonitor | Self::Switch => 3,
            Self::Telescope | Self::Camera | Self::Focuser | Self::Rotator => 4,
        }
    }
}
