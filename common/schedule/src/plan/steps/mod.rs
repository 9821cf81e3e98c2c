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

use super::{Course, Halt};
use crate::action::Action;

/// Follows an action in a forecast.
trait Foresee {
    /// Takes the steps, each with the time that it needs.
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt>;
}

/// Follows an action until it ends or is halted.
pub fn foresee(action: &Action, course: &mut Course<'_>) -> Result<(), Halt> {
    match action {
        Action::Open(action) => action.foresee(course),
        Action::Close(action) => action.foresee(course),
        Action::CoolCamera(action) => action.foresee(course),
        Action::Object(action) => action.foresee(course),
        Action::Calibration(action) => action.foresee(course),
        Action::CalibrateGuiding(action) => action.foresee(course),
        Action::PointingModel(action) => action.foresee(course),
        Action::CompleteHeaders(action) => action.foresee(course),
        Action::Autofocus(action) => action.foresee(course),
        Action::Flats(action) => action.foresee(course),
    }
}
