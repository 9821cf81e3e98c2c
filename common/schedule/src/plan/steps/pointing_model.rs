//! `pointing_model`: learns the pointing errors of the telescope over the whole sky.

use super::Foresee;
use crate::action::{ActionType as _, PointingModel};
use crate::plan::{Halt, SimulatedRun};
use crate::pointing_grid;
use crate::shot::fits;

impl Foresee for PointingModel {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        run.start_cooling();
        let filter_there = run.now.plus_seconds(run.turn_to(self.filter.as_deref()));
        run.open()?;
        run.wait_until(filter_there)?;
        run.cool()?;
        run.reads(&self.readout);
        if self.dark_subtraction {
            run.aside(self.exptime, false)?;
        }
        let limits = run.horizon_limits();
        let is_measured = run.overheads().frame(Self::NAME).measured > 0;
        while run.taken < self.n && fits(run.now, self.exptime, run.row.end) {
            let observer = run.observer(run.now)?;
            let Some(target) = pointing_grid::target(run.taken, self.n, &limits, &observer) else { break };
            if is_measured && run.taken > 0 {
                // The measured time between two frames includes the slew.
                run.reaches(&target)?;
            } else {
                run.slew(Some(&target))?;
            }
            if !fits(run.now, self.exptime, run.row.end) {
                break;
            }
            run.frame(self.exptime, true)?;
        }
        if run.taken < self.n {
            run.note(format!("{} of {} places", run.taken, self.n));
        }
        Ok(())
    }
}
