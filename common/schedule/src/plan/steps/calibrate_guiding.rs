//! `calibrate_guiding`: learns from pulses how they move the stars of a camera, and how much play declination has.

use imaging::guide::calibration::pulses::{self, Next, Run};

use super::Foresee;
use crate::action::calibrate_guiding::{CalibrateGuiding, STEPS, TOO_LATE};
use crate::plan::{Course, Halt};
use crate::shot::fits;

/// Half of the sky's speed, to which mounts are usually set, deg/s; for plans, which do not ask the mount.
const USUAL_RATE_DEG_S: f64 = 0.5 * 15.041_067 / 3600.0;

impl Foresee for CalibrateGuiding {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        let observer = course.observer(course.now)?;
        let target = self.target(&observer).map_err(Halt::Failed)?;
        course.begin(Some(Some(&target)), self.filter.as_deref())?;
        course.reads(&self.readout);
        let scale = course.camera().and_then(|camera| camera.scale_arcsec_px).map(|scale| scale * self.bin());
        let settings = self.settings_of(scale.map(|scale| ([USUAL_RATE_DEG_S; 2], scale)), None, None, &target);
        let [east, north] = settings.expected_px_s.unwrap_or([settings.distance_px / STEPS / 0.75; 2]);
        let mut run = Run::new(settings);
        let (mut place, began) = ([0.0, 0.0], course.now);
        let late = || Halt::Failed(TOO_LATE.to_owned());
        loop {
            if !fits(course.now, self.exptime, course.row.end) {
                return Err(late());
            }
            let middle_s = course.now.seconds_since(began) + 0.5 * self.exptime;
            course.frame(self.exptime, true)?;
            match run.next(middle_s, Some(place)) {
                Next::Pulse { direction, length_ms } => {
                    let length_s = f64::from(length_ms) / 1000.0;
                    let [x, y] = &mut place;
                    match direction {
                        pulses::Direction::East => *x += east * length_s,
                        pulses::Direction::West => *x -= east * length_s,
                        pulses::Direction::North => *y += north * length_s,
                        pulses::Direction::South => *y -= north * length_s,
                    }
                    course.pass(length_s + self.settle_time)?;
                }
                Next::Measure => course.pass(self.settle_time)?,
                Next::Done { .. } => return Ok(()),
                Next::Failed(why) => return Err(Halt::Failed(why.to_string())),
            }
        }
    }
}
