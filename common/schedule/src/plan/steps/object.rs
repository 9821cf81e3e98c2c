//! `object`: points at a target and takes frames until the window ends or there are enough.

use super::Foresee;
use crate::action::{Object, Parameters as _};
use crate::moving_target::up_until;
use crate::plan::{Course, Halt};

impl Foresee for Object {
    fn foresee(&self, course: &mut Course<'_>) -> Result<(), Halt> {
        self.not_done().into_iter().for_each(|word| course.tell(word));
        let target = match self.looks_at().filter(|_| self.moves()) {
            Some(place) => Some(course.place(&place)?),
            None => None,
        };
        if let Some(name) = self.lookup_name() {
            course.tell(format!("where {name} stands is looked up when the row is near: no altitude here"));
        }
        course.begin(self.moves().then_some(target.as_ref()), self.filter.as_deref())?;
        course.reads(&self.readout);
        let mut end = course.row.end;
        if let Some(body) = self.body().filter(|_| self.moves()) {
            let (from, lead_s) = (course.now, self.nonsidereal_start_lead_time_seconds.unwrap_or(0.0));
            let limits = course.horizon_limits();
            end = up_until(&body, (from, end), &limits, |at| course.observer(at), Halt::Failed)?;
            course.pass(lead_s)?;
        } else if let Some(target) = &target {
            course.ends_out_of_reach(target)?;
        }
        let can_turn = target.filter(|_| self.body().is_none());
        loop {
            if self.pointing && self.moves() {
                course.acquire()?;
            }
            course.expose(|course| match &can_turn {
                Some(target) if course.flip_is_due(target, self.exptime) => None,
                _ => self.shot(course.taken, course.now, end),
            })?;
            if self.shot(course.taken, course.now, end).is_none() {
                break;
            }
            course.turn_over()?;
        }
        course.tell(self.told(course.taken));
        Ok(())
    }
}
