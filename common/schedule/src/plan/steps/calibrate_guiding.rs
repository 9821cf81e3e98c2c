//! `calibrate_guiding`: learns from pulses how they move the stars of a camera, and how much play declination has.

use imaging::guide::calibration::pulses::{self, CalibrationRun, Next};

use super::Foresee;
use crate::action::calibrate_guiding::{CalibrateGuiding, STEPS, TOO_LATE};
use crate::plan::{Halt, SimulatedRun};
use crate::shot::fits;

/// Half of the sky's speed, to which mounts are usually set, deg/s; for plans, which do not ask the mount.
const USUAL_RATE_DEG_S: f64 = 0.5 * 15.041_067 / 3600.0;

impl Foresee for CalibrateGuiding {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        let observer = run.observer(run.now)?;
        let target = self.target(&observer).map_err(Halt::Failed)?;
        run.begin(Some(Some(&target)), self.filter.as_deref())?;
        run.reads(&self.readout);
        let scale = run.camera().and_then(|camera| camera.scale_arcsec_px).map(|scale| scale * self.bin());
        let settings = self.settings_of(scale.map(|scale| ([USUAL_RATE_DEG_S; 2], scale)), None, None, &target);
        let [east, north] = settings.expected_px_s.unwrap_or([settings.distance_px / STEPS / 0.75; 2]);
        let mut calibration = CalibrationRun::new(settings);
        let (mut place, began) = ([0.0, 0.0], run.now);
        let late = || Halt::Failed(TOO_LATE.to_owned());
        loop {
            if !fits(run.now, self.exptime, run.row.end) {
                return Err(late());
            }
            let middle_s = run.now.seconds_since(began) + 0.5 * self.exptime;
            run.frame(self.exptime, true)?;
            match calibration.next(middle_s, Some(place)) {
                Next::Pulse { direction, length_ms } => {
                    let length_s = f64::from(length_ms) / 1000.0;
                    let [x, y] = &mut place;
                    match direction {
                        pulses::Direction::East => *x += east * length_s,
                        pulses::Direction::West => *x -= east * length_s,
                        pulses::Direction::North => *y += north * length_s,
                        pulses::Direction::South => *y -= north * length_s,
                    }
                    run.pass(length_s + self.settle_time)?;
                }
                Next::Measure => run.pass(self.settle_time)?,
                Next::Done { .. } => return Ok(()),
                Next::Failed(why) => return Err(Halt::Failed(why.to_string())),
            }
        }
    }
}
