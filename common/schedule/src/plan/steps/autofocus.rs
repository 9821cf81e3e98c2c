//! `autofocus`: finds the focus with a run of frames near the zenith, and stores it.

use sky::Horizontal;
use units::Angle;

use super::Foresee;
use crate::action::Autofocus;
use crate::plan::{Course, Halt};
use crate::shot::fits;

impl Foresee for Autofocus {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        let up = Horizontal { altitude: Angle::from_degrees(90.0), azimuth: Angle::default() };
        let zenith = course.observer(course.now)?.to_icrs(&up);
        let place = self.field.place().unwrap_or(zenith);
        course.begin(Some(Some(&place)), self.filter.as_deref())?;
        course.reads(&self.readout);
        let ((coarse, fine), (first, closer)) = (self.search.positions(), self.search.frames());
        // At the end one more frame is taken at the focus that was found.
        let positions = std::iter::repeat_n(first, coarse).chain(std::iter::repeat_n(closer, fine.saturating_add(1)));
        for count in positions {
            if !fits(course.now, self.exptime * f64::from(count), course.row.end) {
                return Err(Halt::Failed("the row's window is over before the focus is found".to_owned()));
            }
            for _ in 0..count {
                course.frame(self.exptime, true)?;
            }
        }
        Ok(())
    }
}
