//! Guiding: holding a field where the reference frame saw it.
//!
//! Pure: no clock, no mount. Each frame's shift and time go in, pulses and their reason come out. Formulae and sources:
//! docs/formulae.md, "Guiding".
//!
//! - [`mod@reference`] remembers the stars and measures how far they moved, in boxes around where they should be.
//! - [`calibration`] knows what pulses do to the stars: from pulses, or from a plate solution.
//! - [`Guider`] decides: per axis a bank of Kalman filters foresees drift and worm (or the predecessor's [`pid`]
//!   reacts), Dec turns round only with reason, and a lost field is looked for.
//!
//! Signs: a shift is where stars are less where they were; positive pulses are East and North.

mod axis;
mod bank;
pub mod calibration;
mod decision;
mod guider;
mod hypothesis;
mod lost;
mod patch;
pub mod pid;
pub mod reference;
mod reversal;
mod rotation;
mod settings;
mod slack;
mod watch;

pub use calibration::{Calibration, CalibrationError, Pier};
pub use decision::{Ask, AxisLog, Decision, Log, Pulses, State, Unstable, Why};
pub use guider::Guider;
pub use reference::{Measurement, Reference};
pub use settings::{Control, GuideSettings};

use crate::shift::{Method, NoShift, Shift};

/// When a frame was exposed, s on the caller's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Middle of the exposure, s.
    pub mid_s: f64,
    /// Its length, s.
    pub length_s: f64,
}

/// A shift with a standard error above this is not guided on, px; nor one above [`FEW_STARS_PX`] by fewer than three
/// stars.
const GREATEST_ERROR_PX: f64 = 0.5;
const FEW_STARS_PX: f64 = 5.0;

/// The last gate before the controller: only finite numbers with errors, of enough stars.
pub(crate) fn usable(shift: Shift) -> Result<Shift, NoShift> {
    let Shift { dx_px, dy_px, rotation_deg, covariance, stars, .. } = shift;
    let error_px = covariance[0][0].max(covariance[1][1]).sqrt();
    let numbers = [dx_px, dy_px, rotation_deg, covariance[2][2]];
    let is_finite = numbers.iter().chain(covariance[..2].iter().flatten()).all(|value| value.is_finite());
    let is_positive = covariance[0][0] >= 0.0 && covariance[1][1] >= 0.0 && error_px > 0.0;
    if !(is_finite && is_positive && error_px < GREATEST_ERROR_PX) {
        return Err(NoShift::Uncertain { error_px });
    }
    let by_stars = shift.method == Method::Stars;
    if by_stars && (stars == 0 || (stars < 3 && dx_px.hypot(dy_px) > FEW_STARS_PX)) {
        return Err(NoShift::NoMatch { matched: stars, dx_px, dy_px });
    }
    Ok(shift)
}
