//! `calibration`: bias and dark frames, at any state of the sky.

use super::Foresee;
use crate::action::Calibration;
use crate::plan::{Course, Halt};

impl Foresee for Calibration {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.begin(None, self.filter.as_deref())?;
        course.reads(&self.readout);
        let end = course.row.end;
        course.expose(|course| self.shot_within(course.taken, course.now, end))?;
        course.tell(self.told(course.taken));
        Ok(())
    }
}
