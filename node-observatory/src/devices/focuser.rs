//! The focuser: absolute positions, shifts from the best one, and filter offsets.

use std::sync::OnceLock;
use std::time::Duration;

use config::Approach;
use contract::device::focuser::{self, Command};
use contract::{CommandId, Device};
use schedule::action::parameters::FocusWanted;
use tokio::sync::watch;

use super::instrument::{CommandSender, Instrument};
use crate::action_error::ActionError;
use crate::focus_learned::LearnedFocus;

/// A focuser.
pub struct Focuser {
    /// The device.
    pub instrument: Instrument<focuser::Focuser>,
    /// Its configuration.
    pub config: config::Focuser,
    learned: watch::Receiver<LearnedFocus>,
    found_at_start: OnceLock<i64>,
}

/// A focuser that does not report its last position has at least so many steps beyond the present one.
const LEAST_TRAVEL: i64 = 5000;
/// The slowest focuser needs less for its whole range, sky time.
const TRAVEL: Duration = Duration::from_secs(180);

impl Focuser {
    /// Subscribes to a focuser.
    pub async fn listen(
        command_sender: &CommandSender,
        device: Device,
        config: config::Focuser,
        learned: watch::Receiver<LearnedFocus>,
    ) -> anyhow::Result<Self> {
        let instrument = Instrument::listen(command_sender, device).await?;
        Ok(Self { instrument, config, learned, found_at_start: OnceLock::new() })
    }

    /// Its configured name.
    pub fn name(&self) -> &str {
        self.config.common.name.as_str()
    }

    /// The best position without a filter's offset: as learned, at the present temperature; else as configured, or
    /// where the focuser was first seen.
    pub fn best(&self) -> Option<i64> {
        let learned = self.learned.borrow().best(self.name(), self.temperature_c());
        // Saturates; positions are far below.
        if let Some(best) = learned.filter(|best| best.is_finite()) {
            return Some(best.round() as i64);
        }
        if self.config.best_position.is_some() {
            return self.config.best_position;
        }
        if let Some(position) = self.position() {
            let _ = self.found_at_start.set(position);
        }
        self.found_at_start.get().copied()
    }

    /// Offset of a filter, steps: as learned, else the wheel's value.
    pub fn offset(&self, filter: &str, wheel_offset: i64) -> i64 {
        self.learned.borrow().offset(self.name(), filter, wheel_offset)
    }

    /// Temperature at the focuser, degrees Celsius, where it knows one.
    pub fn temperature_c(&self) -> Option<f64> {
        self.instrument.fresh().and_then(|state| state.fields.temperature_c.known().copied()).filter(|c| c.is_finite())
    }

    /// Its last position, steps; as a focus run that begins at `start` takes it, where the focuser does not report it: no
    /// run drives far into what nobody knows.
    pub fn travel(can: &focuser::Capabilities, start: i64) -> i64 {
        can.last_position().unwrap_or_else(|| start.saturating_mul(2).max(start.saturating_add(LEAST_TRAVEL)))
    }

    /// Its position, steps, if it is known.
    pub fn position(&self) -> Option<i64> {
        self.instrument.fresh().and_then(|state| state.fields.position.known().copied())
    }

    /// Whether a row can do with the present focus: it asks for nothing of its own, and as far as is known the
    /// focuser is where it belongs.
    pub fn may_stay(&self, wanted: FocusWanted) -> bool {
        let last_received =
            self.instrument.newest().and_then(|received| received.sample.body.fields.position.known().copied());
        stays(wanted, self.best(), last_received, self.config.tolerance_steps)
    }

    /// Moves to where a row wants it, and settles.
    pub async fn focus(&self, wanted: FocusWanted) -> Result<(), ActionError> {
        let can = self.instrument.capabilities().await?;
        let last = can.last_position();
        if !can.absolute {
            return match wanted {
                FocusWanted { position: None, shift: None, .. } => Ok(()),
                _ => Err(ActionError::Impossible(format!("{} does not know its position", self.instrument.device))),
            };
        }
        let best = self.best();
        if best.is_none() && wanted.position.is_none() {
            // It may only be away for a while.
            let (device, verb) = (self.instrument.device.to_string(), "focus".to_owned());
            return Err(ActionError::Failed { device, verb, reason: "its position is not known".to_owned() });
        }
        let target = target(wanted, best, last)?;
        if self.position().is_some_and(|now| near(now, target, self.config.tolerance_steps)) {
            return Ok(());
        }
        self.approach(target, last).await
    }

    /// Where the focuser belongs for a row, steps.
    pub fn target(&self, wanted: FocusWanted) -> Result<i64, ActionError> {
        target(wanted, self.best(), self.instrument.can().and_then(|can| can.last_position()))
    }

    /// Goes to a position from the side that positions are approached from; `last` is the focuser's last position, where
    /// it is known.
    pub async fn approach(&self, target: i64, last: Option<i64>) -> Result<(), ActionError> {
        let (backlash, side) = (self.config.backlash_steps, self.config.approach);
        if let Some(from) = overshoot(self.position(), target, backlash, side, last) {
            self.go(from).await?;
        }
        self.go(target).await
    }

    /// Goes to a position from the present one; returns when it has settled there, for which its device node waits.
    pub async fn go(&self, position: i64) -> Result<(), ActionError> {
        self.instrument.execute(Command::Move { position }, TRAVEL).await.map(|_| ())
    }

    /// Sends it to a position, and does not wait until it is there.
    pub async fn send(&self, position: i64) -> Result<(), ActionError> {
        self.instrument.ask_in_turn(&CommandId::fresh(), Command::Move { position }).await
    }
}

/// From where a position is approached, unless the focuser comes from that side anyway; within its travel.
fn overshoot(now: Option<i64>, target: i64, backlash: i64, side: Approach, last: Option<i64>) -> Option<i64> {
    let from = match side {
        Approach::Upward => target.saturating_sub(backlash),
        Approach::Downward => target.saturating_add(backlash),
    };
    let comes_from_there = now.is_some_and(|now| match side {
        Approach::Upward => now <= from,
        Approach::Downward => now >= from,
    });
    let from = from.clamp(0, last.unwrap_or(i64::MAX));
    (backlash > 0 && !comes_from_there && from != target).then_some(from)
}

fn near(position: i64, target: i64, tolerance_steps: i64) -> bool {
    position.abs_diff(target) <= tolerance_steps.unsigned_abs()
}

fn stays(wanted: FocusWanted, best: Option<i64>, last_received: Option<i64>, tolerance_steps: i64) -> bool {
    let is_away = best.zip(last_received).is_some_and(|(best, position)| !near(position, best, tolerance_steps));
    wanted == FocusWanted::default() && !is_away
}

fn target(wanted: FocusWanted, best: Option<i64>, last: Option<i64>) -> Result<i64, ActionError> {
    let from = match (wanted.position, best) {
        (Some(position), _) => position,
        (None, Some(best)) => best.saturating_add(wanted.shift.unwrap_or(0)),
        (None, None) => return Err(ActionError::Impossible("the focuser's best position is not known".to_owned())),
    };
    let target = from.saturating_add(wanted.filter_offset);
    // Where the last position is not known, the driver decides.
    if (0..=last.unwrap_or(i64::MAX)).contains(&target) {
        Ok(target)
    } else {
        let last = last.map_or_else(|| "last position".to_owned(), |last| last.to_string());
        Err(ActionError::Impossible(format!("focus position {target} is outside the focuser's 0 to {last}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_asks_nothing_needs_no_focuser_that_stands_where_it_belongs_or_reports_nothing() {
        let nothing = FocusWanted::default();
        assert!(stays(nothing, Some(1000), Some(1003), 5));
        assert!(stays(nothing, Some(1000), None, 5));
        assert!(stays(nothing, None, None, 5));
        assert!(!stays(nothing, Some(1000), Some(1500), 5), "left defocused by another row");
        for wanted in [
            FocusWanted { shift: Some(0), ..nothing },
            FocusWanted { position: Some(1000), ..nothing },
            FocusWanted { filter_offset: 12, ..nothing },
        ] {
            assert!(!stays(wanted, Some(1000), Some(1000), 5), "{wanted:?}");
        }
    }

    #[test]
    fn the_play_of_the_gears_is_always_taken_up_from_the_same_side() {
        let over = |now, target, side| overshoot(now, target, 60, side, Some(5000));
        assert_eq!(over(Some(1000), 900, Approach::Upward), Some(840));
        assert_eq!(over(Some(1000), 1030, Approach::Upward), Some(970), "not far enough below");
        assert_eq!(over(Some(1000), 1060, Approach::Upward), None);
        assert_eq!(over(None, 1060, Approach::Upward), Some(1000), "nobody knows where it comes from");
        assert_eq!(over(Some(1000), 1100, Approach::Downward), Some(1160));
        assert_eq!(over(Some(1000), 4990, Approach::Downward), Some(5000), "the end of its travel");
        assert_eq!(over(Some(1000), 30, Approach::Upward), Some(0));
        assert_eq!(overshoot(Some(1000), 900, 0, Approach::Upward, None), None);
    }

    #[test]
    fn a_position_wins_over_a_shift_and_the_filter_adds_its_offset() {
        let wanted = |position, shift, filter_offset| FocusWanted { position, shift, filter_offset };
        assert_eq!(target(wanted(Some(100), Some(50), 7), Some(1000), Some(5000)).unwrap(), 107);
        assert_eq!(target(wanted(None, Some(-50), 7), Some(1000), Some(5000)).unwrap(), 957);
        assert_eq!(target(wanted(None, None, 0), Some(1000), Some(5000)).unwrap(), 1000);
        assert!(target(wanted(None, Some(1), 0), None, Some(5000)).is_err());
        let beyond = target(wanted(Some(6000), None, 0), None, Some(5000)).unwrap_err().to_string();
        assert_eq!(beyond, "focus position 6000 is outside the focuser's 0 to 5000");
        // A focuser that does not report its last position.
        let can = |max_step| focuser::Capabilities { max_step, ..Default::default() };
        let travels = [(50_000, 10_000), (0, 10_000), (0, 100)].map(|(last, start)| Focuser::travel(&can(last), start));
        assert_eq!(travels, [50_000, 20_000, 5100]);
        assert_eq!(target(wanted(Some(6000), None, 0), None, None).unwrap(), 6000);
        assert!(target(wanted(Some(-1), None, 0), None, None).is_err());
        assert_eq!(overshoot(Some(0), 900, 60, Approach::Downward, None), Some(960));
    }
}
