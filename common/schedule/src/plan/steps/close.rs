//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use super::Foresee;
use crate::action::close::{Close, TOO_LATE};
use crate::plan::{Halt, SimulatedRun};

impl Foresee for Close {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        run.ends_at(run.row.end, Halt::Failed(TOO_LATE.to_owned()));
        run.close()
    }
}
