//! The mirror cover.

use std::time::Duration;

use contract::device::cover_calibrator::{self, Command};

use super::instrument::Instrument;
use crate::trouble::Trouble;

/// A cover, a flat panel, or both.
pub struct Cover {
    /// The device.
    pub instrument: Instrument<cover_calibrator::CoverCalibrator>,
}

/// The slowest petals need less, sky time.
pub const TRAVEL: Duration = Duration::from_secs(120);

impl Cover {
    /// The cover as the device says now; `None` where that is not known.
    pub fn cover(&self) -> Option<cover_calibrator::Cover> {
        self.instrument.fresh().and_then(|state| state.fields.cover.known().copied())
    }

    /// Opens the cover, where there is one.
    pub async fn open(&self) -> Result<(), Trouble> {
        use cover_calibrator::Cover::{NotPresent, Open};
        if matches!(self.cover(), Some(NotPresent | Open)) || !self.instrument.capabilities().await?.cover {
            return Ok(());
        }
        self.instrument.obey(Command::OpenCover, TRAVEL).await.map(|_| ())
    }
}
