//! `pointing_model`: learns the pointing errors of the telescope over the whole sky.

use super::Foresee;
use crate::action::{ActionType as _, PointingModel};
use crate::plan::{Course, Halt};
use crate::pointing_grid;
use crate::shot::fits;

impl Foresee for PointingModel {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.start_cooling();
        let filter_there = course.now.plus_seconds(course.turn_to(self.filter.as_deref()));
        course.open()?;
        course.wait_until(filter_there)?;
        course.cool()?;
        course.reads(&self.readout);
        if self.dark_subtraction {
            course.aside(self.exptime, false)?;
        }
        let limits = course.horizon_limits();
        let is_measured = course.overheads().frame(Self::NAME).measured > 0;
        while course.taken < self.n && fits(course.now, self.exptime, course.row.end) {
            let observer = course.observer(course.now)?;
            let Some(target) = pointing_grid::target(course.taken, self.n, &limits, &observer) else { break };
            if is_measured && course.taken > 0 {
                // The measured time between two frames includes the slew.
                course.reaches(&target)?;
            } else {
                course.slew(Some(&target))?;
            }
            if !fits(course.now, self.exptime, course.row.end) {
                break;
            }
            course.frame(self.exptime, true)?;
        }
        if course.taken < self.n {
            course.tell(format!("{} of {} places", course.taken, self.n));
        }
        Ok(())
    }
}
