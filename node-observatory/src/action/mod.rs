//! Executes the actions of a schedule. Each file holds one action and describes its steps in an observer's order.
//!
//! `schedule::action` defines the parameters of each action. The runner does the waiting, safety checks, retries and
//! settling: it may drop an action at any `.await`.

mod answer;
mod autofocus;
mod calibrate_guiding;
mod calibration;
mod close;
mod complete_headers;
mod cool_camera;
pub mod expose;
mod flats;
mod object;
mod open;
mod pointing_model;
mod spooled;
mod stage;

use std::future::Future;
use std::pin::Pin;

use contract::device::camera::Subframe;
use schedule::action::Action;
use schedule::action::parameters::Readout;

pub use answer::serve;
pub use stage::{Stage, took_s};

use crate::rig::camera::{Camera, subframe};
use crate::trouble::Trouble;

/// Executes one type of action.
trait Execute {
    /// Executes the action; returns a summary of how it went.
    fn run(&self, stage: &Stage) -> impl Future<Output = Result<String, Trouble>> + Send;
}

/// Executes the action of a row; returns a summary of how it went.
pub fn run<'a>(
    action: &'a Action,
    stage: &'a Stage,
) -> Pin<Box<dyn Future<Output = Result<String, Trouble>> + Send + 'a>> {
    match action {
        Action::Open(action) => Box::pin(action.run(stage)),
        Action::Close(action) => Box::pin(action.run(stage)),
        Action::CoolCamera(action) => Box::pin(action.run(stage)),
        Action::Object(action) => Box::pin(action.run(stage)),
        Action::Calibration(action) => Box::pin(action.run(stage)),
        Action::CalibrateGuiding(action) => Box::pin(action.run(stage)),
        Action::PointingModel(action) => Box::pin(action.run(stage)),
        Action::CompleteHeaders(action) => Box::pin(action.run(stage)),
        Action::Autofocus(action) => Box::pin(action.run(stage)),
        Action::Flats(action) => Box::pin(action.run(stage)),
    }
}

/// The pixels that a row reads, once the sensor is known; `None` is the whole sensor.
async fn read_out(readout: &Readout, camera: &Camera) -> Result<Option<Subframe>, Trouble> {
    let (Some(width), Some(height)) = (readout.subframe_width, readout.subframe_height) else { return Ok(None) };
    let can = camera.instrument.capabilities().await?;
    let centre = (readout.subframe_center_x, readout.subframe_center_y);
    Ok(Some(subframe((can.width_px, can.height_px), readout.bin, (width, height), centre)))
}
