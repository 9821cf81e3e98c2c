//! The mirror cover.

use std::time::Duration;

use contract::device::cover_calibrator::{self, Command};

use super::instrument::Instrument;
use crate::action_error::ActionError;

/// A cover, a flat panel, or both.
pub struct Cover {
    /// The device.
    pub instrument: Instrument<cover_calibrator::CoverCalibrator>,
}

/// The slowest petals need less, sky time.
pub const TRAVEL: Duration = Duration::from_secs(120);
/// The slowest lamps are steady, or dark, by then, sky time.
const WARM_UP: Duration = Duration::from_secs(120);

impl Cover {
    /// The cover as the device reports it now; `None` where that is not known.
    pub fn cover(&self) -> Option<cover_calibrator::Cover> {
        self.instrument.fresh().and_then(|state| state.fields.cover.known().copied())
    }

    /// Closes the cover, where there is one.
    pub async fn close(&self) -> Result<(), ActionError> {
        use cover_calibrator::Cover::{Closed, NotPresent};
        if matches!(self.cover(), Some(NotPresent | Closed)) || !self.instrument.capabilities().await?.cover {
            return Ok(());
        }
        self.instrument.execute(Command::CloseCover, TRAVEL).await.map(|_| ())
    }

    /// Lights the panel, and waits until it is steady; brightness in device units.
    pub async fn light(&self, brightness: i64) -> Result<(), ActionError> {
        self.instrument.execute(Command::CalibratorOn { brightness }, WARM_UP).await.map(|_| ())
    }

    /// Darkens the panel, unless it is known to be dark or not there.
    pub async fn darken(&self) -> Result<(), ActionError> {
        use cover_calibrator::Calibrator::{NotPresent, Off};
        if matches!(self.panel(), Some(NotPresent | Off)) || !self.instrument.capabilities().await?.calibrator {
            return Ok(());
        }
        self.instrument.execute(Command::CalibratorOff, WARM_UP).await.map(|_| ())
    }

    fn panel(&self) -> Option<cover_calibrator::Calibrator> {
        self.instrument.fresh().and_then(|state| state.fields.calibrator.known().copied())
    }

    /// Opens the cover, where there is one; a panel that somebody left lit is darkened first.
    pub async fn open(&self) -> Result<(), ActionError> {
        use cover_calibrator::Calibrator::{NotReady, Ready};
        if matches!(self.panel(), Some(Ready | NotReady)) {
            self.darken().await?;
        }
        use cover_calibrator::Cover::{NotPresent, Open};
        if matches!(self.cover(), Some(NotPresent | Open)) || !self.instrument.capabilities().await?.cover {
            return Ok(());
        }
        self.instrument.execute(Command::OpenCover, TRAVEL).await.map(|_| ())
    }
}
