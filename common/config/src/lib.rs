//! What a site writes about itself: `observatory.toml` and the FITS-header table, read into checked types.
//!
//! Every node takes the same file and reads its own parts. Unknown keys are refused, relations between
//! devices are proven here once, and the rest of the code sees only [`Observatory`]. Pure: text in, values
//! out; relative paths are resolved against a folder that the caller names.

mod alerts;
mod check;
mod device;
mod faults;
pub mod header;
mod observatory;
mod slit;

pub use alerts::{Alerting, Email, Ping, Security, Smtp, Webhook};
pub use check::{ConfigError, parse};
pub use device::{
    Camera, CloseWithMount, Common, CoverCalibrator, Device, Dome, EquatorialChoice, FilterWheel, Focuser, Limit,
    Measure, MountLimits, ObservingConditions, Response, Rotator, SafetyMonitor, Switch, Telescope,
};
pub use faults::{FaultPolicy, Faults};
pub use observatory::{
    Archive, Bus, ClockSource, Folders, Observatory, Place, Safety, Schedule, Shared, Spool, Web, WindSector,
};
pub use slit::{Follow, Slit};
