//! `complete_headers`: waits until the archive has stored every frame of this night with a complete header.

use super::Foresee;
use crate::action::CompleteHeaders;
use crate::plan::{Course, Halt};

impl Foresee for CompleteHeaders {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        match course.headers_whole() {
            Some(whole) => course.wait_until(whole.min(course.row.end)),
            None => Ok(()),
        }
    }
}
