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

/// A cooler with no more power than this, percent, has nothing to do.
const IDLE_PERCENT: f64 = 1.0;

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
        if cools_already(&fields, set_c, self.config.temperature_tolerance_c) {
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
            is_cold(&received.sample.body.fields, set_c, tolerance_k).then_some(())
        };
        self.instrument.until(most, "cold", cold).await.map_err(|_| ActionError::Cooling {
            device: self.instrument.device.to_string(),
            set_c,
            tolerance_k,
            minutes,
            sensor: self
                .instrument
                .fresh()
                .map_or_else(|| "unknown temperature".to_owned(), |state| cooler(&state.fields)),
        })
    }

    /// An error for an exposure that the camera cannot take, before anything is moved for it. What the camera does not
    /// report is no limit.
    pub async fn takes(&self, exposures_s: impl Iterator<Item = f64> + Send) -> Result<(), ActionError> {
        let can = self.instrument.capabilities().await?;
        for exposure_s in exposures_s {
            can.exposure_s(exposure_s)
                .map_err(|why| ActionError::Impossible(format!("{}: {why}", self.instrument.device)))?;
        }
        Ok(())
    }

    /// What a good flat is, with exposures that the camera can take.
    pub fn flats(&self) -> Result<config::Flats, ActionError> {
        let can = self.instrument.can().unwrap_or_default();
        within_limits(self.config.flats, &can)
            .map_err(|why| ActionError::Impossible(format!("flats of {}: {why}", self.instrument.device)))
    }

    /// The size of its sensor, unbinned pixels; waits for it where the camera could not be read yet.
    pub async fn sensor_px(&self) -> Result<(u32, u32), ActionError> {
        let can = self.instrument.capabilities_with(&["CameraXSize", "CameraYSize"]).await?;
        if can.width_px > 0 && can.height_px > 0 {
            return Ok((can.width_px, can.height_px));
        }
        let (device, verb) = (self.instrument.device.to_string(), "choose a part of its sensor".to_owned());
        Err(ActionError::Failed { device, verb, reason: "it does not report how large its sensor is".to_owned() })
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

/// Does the camera cool towards this set point already? Where it does not report whether its cooler runs, the sensor's
/// temperature shows it.
fn cools_already(fields: &camera::Fields, set_c: f64, tolerance_k: f64) -> bool {
    let near = |c: Option<&f64>| c.is_some_and(|c| (c - set_c).abs() <= tolerance_k);
    let runs = fields.cooler_on.known().copied();
    near(fields.set_c.known()) && (runs == Some(true) || (runs.is_none() && near(fields.ccd_c.known())))
}

/// Is the sensor at its set point, or colder while its cooler, which cannot heat, has nothing to do?
fn is_cold(fields: &camera::Fields, set_c: f64, tolerance_k: f64) -> bool {
    let idles = fields.cooler_on.known() == Some(&true)
        && fields.cooler_percent.known().is_some_and(|percent| *percent <= IDLE_PERCENT);
    fields.ccd_c.known().is_some_and(|sensor_c| (sensor_c - set_c).abs() <= tolerance_k || (*sensor_c < set_c && idles))
}

/// Flats with exposures within what the camera reports.
fn within_limits(flats: config::Flats, can: &camera::Capabilities) -> Result<config::Flats, String> {
    let (low, high) = (flats.exposure_min_s, flats.exposure_max_s);
    let exposure_min_s = can.exposure_min_s.map_or(low, |least| low.max(least));
    // A camera whose longest exposure is 0 states none.
    let exposure_max_s = can.exposure_max_s.filter(|most| *most > 0.0).map_or(high, |most| high.min(most));
    if exposure_min_s > exposure_max_s {
        let takes = format!("{exposure_min_s} to {exposure_max_s} s are left");
        return Err(format!(
            "flats.exposure_min_s = {low} and .exposure_max_s = {high}: {takes} by the camera's limits"
        ));
    }
    Ok(config::Flats { exposure_min_s, exposure_max_s, ..flats })
}

/// The sensor and its cooler in words.
fn cooler(fields: &camera::Fields) -> String {
    let celsius = |datum: &contract::Datum<f64>| {
        datum.as_result().map_or_else(ToString::to_string, |celsius| format!("{celsius:.1} C"))
    };
    let runs = match fields.cooler_on.known() {
        Some(true) => String::new(),
        Some(false) => ", CoolerOn is false".to_owned(),
        None => ", CoolerOn is not known".to_owned(),
    };
    format!("{}, set point {}{runs}", celsius(&fields.ccd_c), celsius(&fields.set_c))
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
    use contract::Datum;

    use super::*;

    fn fields(set: Option<f64>, sensor: Option<f64>, runs: Option<bool>) -> camera::Fields {
        let celsius = |c: Option<f64>| c.map_or_else(Datum::default, Datum::Known);
        let cooler_on = runs.map_or_else(Datum::default, Datum::Known);
        camera::Fields { set_c: celsius(set), ccd_c: celsius(sensor), cooler_on, ..Default::default() }
    }

    #[test]
    fn a_cooler_that_does_not_report_whether_it_runs_is_judged_by_the_sensor() {
        let rows = [
            (Some(-20.0), Some(15.0), Some(true), true),
            // The camera rounds set points to half a degree.
            (Some(-19.5), Some(15.0), Some(true), true),
            (Some(-20.0), Some(-19.7), None, true),
            (Some(-20.0), Some(15.0), None, false),
            (Some(-20.0), Some(-20.0), Some(false), false),
            (None, Some(-20.0), None, false),
            (Some(10.0), Some(-20.0), Some(true), false),
        ];
        for (set, sensor, runs, cools) in rows {
            assert_eq!(cools_already(&fields(set, sensor, runs), -20.0, 1.0), cools, "{set:?} {sensor:?} {runs:?}");
        }
        let words = cooler(&fields(Some(-20.0), Some(15.0), Some(false)));
        assert_eq!(words, "15.0 C, set point -20.0 C, CoolerOn is false");
    }

    #[test]
    fn a_sensor_that_is_colder_than_its_set_point_is_cold_once_its_cooler_has_nothing_to_do() {
        for (sensor, runs, percent, expected) in [
            (-10.4, Some(true), Some(40.0), true),
            (-18.0, Some(true), Some(0.0), true),
            // It drifts towards a set point that was raised.
            (-18.0, Some(true), Some(15.0), false),
            (-18.0, Some(false), Some(0.0), false),
            (-18.0, Some(true), None, false),
            (-5.0, Some(true), Some(0.0), false),
            (f64::NAN, Some(true), Some(0.0), false),
        ] {
            let mut fields = fields(Some(-10.0), Some(sensor), runs);
            fields.cooler_percent = percent.map_or_else(Datum::default, Datum::Known);
            assert_eq!(is_cold(&fields, -10.0, 0.5), expected, "{sensor} {runs:?} {percent:?}");
        }
    }

    #[test]
    fn flats_are_exposed_within_the_limits_of_the_camera() {
        let can = |least: Option<f64>, most: Option<f64>| camera::Capabilities {
            exposure_min_s: least,
            exposure_max_s: most,
            ..Default::default()
        };
        let flats = config::Flats { exposure_min_s: 1.0, exposure_max_s: 60.0, ..Default::default() };
        let range = |can| within_limits(flats, &can).map(|flats| (flats.exposure_min_s, flats.exposure_max_s));
        assert_eq!(range(can(None, None)), Ok((1.0, 60.0)));
        assert_eq!(range(can(Some(0.0), Some(0.0))), Ok((1.0, 60.0)), "it states no limit");
        assert_eq!(range(can(Some(2.0), Some(30.0))), Ok((2.0, 30.0)));
        assert_eq!(range(can(Some(0.001), Some(3600.0))), Ok((1.0, 60.0)));
        assert!(range(can(None, Some(0.5))).unwrap_err().contains("1 to 0.5 s are left"));
    }

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
