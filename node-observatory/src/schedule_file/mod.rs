//! The schedule file of the telescope: read when it changes, replaced by order, and its findings published.
//!
//! The crate `schedule` defines what a schedule is.

mod answering;
pub mod earlier_nights;
mod file;
pub mod findings;
mod plan;
mod put;
mod texts;
pub mod versions;

use std::sync::{Arc, Mutex};

use schedule::names::KnownNames;
use tokio::sync::watch;

pub use file::{FileReading, Loaded, reload};
pub use put::put;

use self::earlier_nights::EarlierNights;
use self::versions::Versions;
use crate::authority::Authority;
use crate::devices::Devices;
use crate::night::PublishedNight;
use crate::tasks::Tasks;

/// The file, and what its rows are checked by.
pub struct ScheduleFile {
    /// Whether this node may act.
    pub authority: Arc<Authority>,
    /// The devices.
    pub devices: Arc<Devices>,
    /// The looked-up names of targets.
    pub names: watch::Receiver<KnownNames>,
    /// Every schedule that was in force.
    pub versions: Versions,
    /// Counts orders to read the file again.
    pub reload: watch::Sender<u64>,
    /// What came of the newest reading.
    pub read: watch::Sender<FileReading>,
    /// The text that is active; held by whoever replaces it.
    pub active: Mutex<Option<ActiveText>>,
    /// The archive's telemetry, for forecasts.
    pub earlier_nights: Arc<EarlierNights>,
}

/// The text of the active schedule.
#[derive(Debug, Clone)]
pub struct ActiveText {
    /// As it was read or put.
    pub text: Arc<str>,
    /// Lower-case hex.
    pub sha256: String,
}

/// Starts the tasks of the file; returns the schedule as it is read.
pub fn start(tasks: &mut Tasks, file: &Arc<ScheduleFile>, night: &Arc<PublishedNight>) -> watch::Receiver<Loaded> {
    let (loaded, schedule) = watch::channel(Loaded::default());
    tasks.spawn("schedule", file::keep_reading(file.clone(), loaded));
    tasks.spawn("survey the schedule", findings::keep_surveying(file.clone(), night.clone(), schedule.clone()));
    tasks.spawn("answer about schedules", answering::keep_answering(file.clone()));
    schedule
}
