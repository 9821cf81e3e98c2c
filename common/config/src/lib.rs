//! What a site writes about itself: `observatory.toml` and the FITS-header table, read into checked types.
//!
//! Every node takes the same file and reads its own parts. Unknown keys are refused, relations between
//! devices are proven here once, and the rest of the code sees only [`Observatory`]. Pure: text in, values
//! out; relative paths are resolved against a folder that the caller names.
//!
//! # Invariants
//!
//! - All faults that refuse a configuration are reported together, with their lines (decision 0055):
//!   `a_file_with_ten_faults_reports_ten_with_their_lines_in_order`.
//! - A configuration that this crate accepts can run; a part of it that turns out to be unusable stops only itself (decision 0056).
//! - Any text is a configuration or is refused with a reason: `any_text_is_a_configuration_or_refused_with_a_reason`.
//! - An enclosure has a device node of its own unless its block names one (decision 0043):
//!   `an_enclosure_has_a_node_of_its_own_where_no_block_names_one`.

mod alerts;
mod bucket;
mod check;
mod delivery;
mod device;
mod device_faults;
mod device_nodes;
mod document;
mod encoding;
pub mod endpoints;
mod fault;
mod faults;
mod findings;
mod flats;
mod focusing;
#[cfg(test)]
mod fuzz_tests;
mod guide_calibration;
mod guiding;
pub mod header;
mod hooks;
mod host;
mod imaging;
mod limits;
mod names;
mod nearest;
mod network_archive;
mod observatory;
mod pair;
mod plausible;
mod pointing;
mod read;
mod relations;
mod sensor;
mod slit;
mod vendor;
mod visibility;
mod web;
mod words;

pub use alerts::{Alerting, Email, Format, Ping, Security, Smtp, Webhook};
pub use bucket::Bucket;
pub use check::{MOST_BYTES, examine, locate, parse};
pub use contract::device::dome::CloseWithMount;
pub use delivery::Delivery;
pub use device::{
    Camera, Common, CoverCalibrator, Device, Dome, EquatorialChoice, FilterWheel, Focuser, Limit, Measure, MountLimits,
    ObservingConditions, Response, Rotator, SafetyMonitor, Switch, Telescope,
};
pub use device_nodes::{ENCLOSURE_NODE, MAIN_NODE};
pub use encoding::{NotUtf8, utf8};
pub use fault::{ConfigError, Fault};
pub use faults::{FaultPolicy, Faults};
pub use flats::Flats;
pub use focusing::{Approach, Focusing, OnDrift};
pub use guide_calibration::GuideStart;
pub use guiding::{Gains, GuideControl, Guiding, WhenLost};
pub use hooks::Hooks;
pub use host::host_port;
pub use imaging::Imaging;
pub use names::Names;
pub use nearest::{distance, meant, nearest};
pub use network_archive::NetworkArchive;
pub use observatory::{
    Archive, Bus, ClockSource, FileProfile, Folders, Observatory, Place, Safety, Schedule, Shared, Spool, WindSector,
};
pub use pointing::{OnFailure, Pointing};
pub use sensor::Sensor;
pub use slit::{Follow, Slit};
pub use vendor::VendorPattern;
pub use visibility::{Horizon, HorizonSource, ScheduleCheck};
pub use web::{Network, Web, Webcam};
pub use words::sexagesimal;
