//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use super::Foresee;
use crate::action::Open;
use crate::plan::{Halt, SimulatedRun};

impl Foresee for Open {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        run.start_cooling();
        run.open()
    }
}
