//! `calibration`: bias and dark frames, at any state of the sky.

use super::Foresee;
use crate::action::Calibration;
use crate::plan::{Halt, SimulatedRun};

impl Foresee for Calibration {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        run.begin(None, self.filter.as_deref())?;
        run.reads(&self.readout);
        let end = run.row.end;
        run.expose(|run| self.shot_within(run.taken, run.now, end))?;
        run.note(self.summary(run.taken));
        Ok(())
    }
}
