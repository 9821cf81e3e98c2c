//! `cool_camera`: runs the cooler and waits until the sensor is cold.

use super::Foresee;
use crate::action::cool_camera::{CoolCamera, NOTHING_TO_COOL};
use crate::plan::{Course, Halt};

impl Foresee for CoolCamera {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        if course.camera().is_some_and(|camera| camera.temperature_c.is_none()) {
            course.tell(NOTHING_TO_COOL);
        }
        course.cool()
    }
}
