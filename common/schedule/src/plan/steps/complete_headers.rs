//! `complete_headers`: waits until the archive has stored every frame of this night with a complete header.

use super::Foresee;
use crate::action::CompleteHeaders;
use crate::plan::{Halt, SimulatedRun};

impl Foresee for CompleteHeaders {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        match run.headers_whole() {
            Some(whole) => run.wait_until(whole.min(run.row.end)),
            None => Ok(()),
        }
    }
}
