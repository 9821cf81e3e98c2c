//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use super::Foresee;
use crate::action::cool_camera::{CoolCamera, NOTHING_TO_COOL};
use crate::plan::{Halt, SimulatedRun};

impl Foresee for CoolCamera {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        if run.camera().is_some_and(|camera| camera.temperature_c.is_none()) {
            run.note(NOTHING_TO_COOL);
        }
        run.cool()
    }
}
