//! The steps of each action in a forecast, with the time of each, as the observatory node executes them.

mod autofocus;
mod calibrate_guiding;
mod calibration;
mod close;
mod complete_headers;
mod cool_camera;
mod flats;
mod object;
mod open;
mod pointing_model;

use super::{Halt, SimulatedRun};
use crate::action::Action;

/// Follows an action in a forecast.
trait Foresee {
    /// Takes the steps, each with the time that it needs.
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt>;
}

/// Follows an action until it ends or is halted.
pub fn foresee(action: &Action, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
    match action {
        Action::Open(action) => action.foresee(run),
        Action::Close(action) => action.foresee(run),
        Action::CoolCamera(action) => action.foresee(run),
        Action::Object(action) => action.foresee(run),
        Action::Calibration(action) => action.foresee(run),
        Action::CalibrateGuiding(action) => action.foresee(run),
        Action::PointingModel(action) => action.foresee(run),
        Action::CompleteHeaders(action) => action.foresee(run),
        Action::Autofocus(action) => action.foresee(run),
        Action::Flats(action) => action.foresee(run),
    }
}
