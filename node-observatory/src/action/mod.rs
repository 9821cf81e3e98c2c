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
mod dark;
mod flats;
mod object;
mod open;
mod pointing_model;

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use contract::device::camera::Subframe;
use schedule::action::Action;
use schedule::action::parameters::Readout;
use schedule::names::KnownNames;
use tokio::sync::watch;

pub use answer::serve;

use crate::action_error::ActionError;
use crate::devices::camera::{Camera, subframe};
use crate::flats::panel;
use crate::focus::FocusData;
use crate::guiding::GuidingData;
use crate::opening::Opener;
use crate::pointing::PointingData;
use crate::row_context::RowContext;

/// What actions use in addition to the context of their row.
pub struct Techniques {
    /// The pointing.
    pub pointing: Arc<PointingData>,
    /// Guiding.
    pub guiding: Arc<GuidingData>,
    /// The focus.
    pub focus: Arc<FocusData>,
    /// Opening.
    pub opener: Opener,
    /// The looked-up names of targets.
    pub names: watch::Receiver<KnownNames>,
}

/// Executes one type of action.
trait Execute {
    /// Executes the action; returns a summary of how it went.
    fn run(
        &self,
        context: &RowContext,
        techniques: &Techniques,
    ) -> impl Future<Output = Result<String, ActionError>> + Send;
}

/// Executes the action of a row; returns a summary of how it went.
pub fn run<'a>(
    action: &'a Action,
    context: &'a RowContext,
    techniques: &'a Techniques,
) -> Pin<Box<dyn Future<Output = Result<String, ActionError>> + Send + 'a>> {
    Box::pin(async move {
        let exposures = action.exposures();
        if !exposures.is_empty() {
            context.chain()?.camera.takes(exposures.iter().map(|exposures| exposures.exposure_s)).await?;
        }
        run_action(action, context, techniques).await
    })
}

fn run_action<'a>(
    action: &'a Action,
    context: &'a RowContext,
    techniques: &'a Techniques,
) -> Pin<Box<dyn Future<Output = Result<String, ActionError>> + Send + 'a>> {
    match action {
        Action::Open(action) => Box::pin(action.run(context, techniques)),
        Action::Close(action) => Box::pin(action.run(context, techniques)),
        Action::CoolCamera(action) => Box::pin(action.run(context, techniques)),
        Action::Object(action) => Box::pin(action.run(context, techniques)),
        Action::Calibration(action) => Box::pin(action.run(context, techniques)),
        Action::CalibrateGuiding(action) => Box::pin(action.run(context, techniques)),
        Action::PointingModel(action) => Box::pin(action.run(context, techniques)),
        Action::CompleteHeaders(action) => Box::pin(action.run(context, techniques)),
        Action::Autofocus(action) => Box::pin(action.run(context, techniques)),
        Action::Flats(action) => Box::pin(action.run(context, techniques)),
    }
}

/// After the action was dropped: stops what it left running. Mount and roof are the closing's.
pub async fn settle(context: &RowContext) {
    context.stop_exposing().await;
    context.stop_following().await;
    if let Err(error) = panel::put_back(context).await {
        tracing::warn!(%error, "the flat panel was not left as it was found");
    }
    context.restore_focus().await;
}

/// The pixels that a row reads, once the sensor is known; `None` is the whole sensor.
async fn read_out(readout: &Readout, camera: &Camera) -> Result<Option<Subframe>, ActionError> {
    let (Some(width), Some(height)) = (readout.subframe_width, readout.subframe_height) else { return Ok(None) };
    let centre = (readout.subframe_center_x, readout.subframe_center_y);
    Ok(Some(subframe(camera.sensor_px().await?, readout.bin, (width, height), centre)))
}
