//! `object`: points at a target and takes frames until the window ends or there are enough.

use super::Foresee;
use crate::action::{Object, Parameters as _};
use crate::moving_target::up_until;
use crate::plan::{Halt, SimulatedRun};

impl Foresee for Object {
    fn foresee(&self, run: &mut SimulatedRun<'_>) -> Result<(), Halt> {
        self.not_done().into_iter().for_each(|word| run.note(word));
        let target = match self.looks_at().filter(|_| self.moves()) {
            Some(place) => Some(run.place(&place)?),
            None => None,
        };
        if let Some(name) = self.lookup_name() {
            run.note(format!("where {name} stands is looked up when the row is near: no altitude here"));
        }
        run.begin(self.moves().then_some(target.as_ref()), self.filter.as_deref())?;
        run.reads(&self.readout);
        let mut end = run.row.end;
        if let Some(body) = self.body().filter(|_| self.moves()) {
            let (from, lead_s) = (run.now, self.nonsidereal_start_lead_time_seconds.unwrap_or(0.0));
            let limits = run.horizon_limits();
            end = up_until(&body, (from, end), &limits, |at| run.observer(at), Halt::Failed)?;
            run.pass(lead_s)?;
        } else if let Some(target) = &target {
            run.ends_out_of_reach(target)?;
        }
        let can_turn = target.filter(|_| self.body().is_none());
        loop {
            if self.pointing && self.moves() {
                run.acquire()?;
            }
            run.expose(|run| match &can_turn {
                Some(target) if run.flip_is_due(target, self.exptime) => None,
                _ => self.shot(run.taken, run.now, end),
            })?;
            if self.shot(run.taken, run.now, end).is_none() {
                break;
            }
            run.turn_over()?;
        }
        run.note(self.summary(run.taken));
        Ok(())
    }
}
