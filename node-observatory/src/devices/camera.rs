//! The camera: cooling it, and exposing with nothing between two frames.

use std::time::Duration;

use contract::device::camera::{self, Command, Subframe};
use contract::{CommandId, Device};
use units::seconds;

use super::instrument::{CommandSender, Instrument};
use crate::action_error::ActionError;
use crate::command_timeout::command_timeout;

/// A camera.
pub struct Camera {
    /// The device.
    pub instrument: Instrument<camera::Camera>,
    /// Its configuration.
    pub config: config::Camera,
}

/// Readout, download and spool of the largest sensors, sky s, on top of the exposure.
const READOUT: Duration = Duration::from_secs(120);

/// The longest that a cooler may take to accept its set point and to switch on, sky s: the device node's own timeout
/// for that command.
const COOLER: Duration = Duration::from_secs(60);

impl Camera {
    /// Subscribes to a camera.
    pub async fn listen(
        command_sender: &CommandSender,
        device: Device,
        config: config::Camera,
    ) -> anyhow::Result<Self> {
        Ok(Self { instrument: Instrument::listen(command_sender, device).await?, config })
    }

    /// Starts the cooler towards the configured set point, unless it runs there already; no cooler, nothing to do. An
    /// error when it refuses.
    pub async fn start_cooling(&self) -> Result<(), ActionError> {
        let Some(set_c) = self.config.temperature_c else { return Ok(()) };
        let fields = self.instrument.fresh().map(|state| state.fields).unwrap_or_default();
        let set_already = fields.set_c.known().is_some_and(|now_c| (now_c - set_c).abs() < 0.01);
        if set_already && fields.cooler_on.known() == Some(&true) {
            return Ok(());
        }
        // A cooler that refuses is found out now, not when the sensor is still warm half an hour later.
        self.instrument.execute(Command::Cool { set_c }, COOLER).await.map(|_| ())
    }

    /// Waits until the sensor is as cold as configured.
    pub async fn wait_until_cold(&self) -> Result<(), ActionError> {
        let Some(set_c) = self.config.temperature_c else { return Ok(()) };
        let tolerance_k = self.config.temperature_tolerance_c;
        let minutes = self.config.cooling_timeout_min;
        let most = command_timeout(self.instrument.clock(), seconds(minutes * 60.0));
        let cold = |received: &bus::Received<contract::DeviceState<camera::Fields>>| {
            let sensor_c = received.sample.body.fields.ccd_c.known()?;
            ((sensor_c - set_c).abs() <= tolerance_k).then_some(())
        };
        self.instrument.until(most, "cold", cold).await.map_err(|_| ActionError::Cooling {
            device: self.instrument.device.to_string(),
            set_c,
            tolerance_k,
            minutes,
            sensor: match self.instrument.fresh().map(|state| state.fields.ccd_c) {
                None => "unknown temperature".to_owned(),
                Some(ccd) => ccd.as_result().map_or_else(ToString::to_string, |celsius| format!("{celsius:.1} C")),
            },
        })
    }

    /// Waits until an exposure is over and the camera free.
    pub async fn exposed(&self, id: &CommandId, exposure_s: f64) -> Result<(), ActionError> {
        let most = command_timeout(self.instrument.clock(), seconds(exposure_s) + READOUT);
        self.instrument.done(id, "expose", most).await.map(|_| ())
    }

    /// Stops an exposure and throws it away.
    pub async fn abort(&self) -> Result<(), ActionError> {
        self.instrument.ask(Command::Abort).await.map(|_| ())
    }
}

/// The part of a sensor of `width` x `height` unbinned pixels that a row asks for: its size in binned pixels and
/// its centre from 0 (left, top edge) to 1; the part never reaches over the edge.
pub fn subframe(sensor_px: (u32, u32), bin: u32, size_px: (u32, u32), centre: (f64, f64)) -> Subframe {
    let along = |sensor: u32, size: u32, centre: f64| -> (u32, u32) {
        let binned = sensor / bin.max(1);
        let size = size.min(binned);
        let room = f64::from(binned - size);
        // `as` saturates, and the centre was checked to lie within 0 to 1.
        ((room * centre.clamp(0.0, 1.0)).floor() as u32, size)
    };
    let (x_px, width_px) = along(sensor_px.0, size_px.0, centre.0);
    let (y_px, height_px) = along(sensor_px.1, size_px.1, centre.1);
    Subframe { x_px, y_px, width_px, height_px }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subframe_lies_around_its_centre_and_within_the_sensor() {
        let part = |bin, size, centre| {
            let s = subframe((2000, 1000), bin, size, centre);
            (s.x_px, s.y_px, s.width_px, s.height_px)
        };
        assert_eq!(part(1, (100, 100), (0.5, 0.5)), (950, 450, 100, 100));
        assert_eq!(part(2, (100, 100), (0.5, 0.5)), (450, 200, 100, 100));
        assert_eq!(part(1, (100, 100), (0.0, 1.0)), (0, 900, 100, 100));
        assert_eq!(part(1, (5000, 100), (1.0, 0.0)), (0, 0, 2000, 100));
    }
}
