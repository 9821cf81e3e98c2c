//! `close`: parks the mount, closes roof and covers, and waits until that is verified.

use super::Foresee;
use crate::action::close::{Close, TOO_LATE};
use crate::plan::{Course, Halt};

impl Foresee for Close {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        course.ends_at(course.row.end, Halt::Failed(TOO_LATE.to_owned()));
        course.close()
    }
}
