//! `open`: opens roof and covers, takes the mount out of its park position, and starts the cooler.

use super::Foresee;
use crate::action::Open;
use crate::plan::{Course, Halt};

impl Foresee for Open {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.start_cooling();
        course.open()
    }
}
