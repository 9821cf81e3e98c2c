//! `autofocus`: finds the focus with a run of frames near the zenith, and stores it.

use sky::Horizontal;
use units::Angle;

use super::Foresee;
use crate::action::Autofocus;
use crate::plan::{Halt, SimulatedRun};
use crate::shot::fits;

impl Foresee for Autofocus {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        let up = Horizontal { altitude: Angle::from_degrees(90.0), azimuth: Angle::default() };
        let zenith = run.observer(run.now)?.to_icrs(&up);
        let place = self.field.place().unwrap_or(zenith);
        run.begin(Some(Some(&place)), self.filter.as_deref())?;
        run.reads(&self.readout);
        let ((coarse, fine), (first, closer)) = (self.search.positions(), self.search.frames());
        // At the end one more frame is taken at the focus that was found.
        let positions = std::iter::repeat_n(first, coarse).chain(std::iter::repeat_n(closer, fine.saturating_add(1)));
        for count in positions {
            if !fits(run.now, self.exptime * f64::from(count), run.row.end) {
                return Err(Halt::Failed("the row's window is over before the focus is found".to_owned()));
            }
            for _ in 0..count {
                run.frame(self.exptime, true)?;
            }
        }
        Ok(())
    }
}
