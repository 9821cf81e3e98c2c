//! The focuser: absolute positions, shifts from the best one, and filter offsets.

use std::sync::OnceLock;
use std::time::Duration;

use contract::Device;
use contract::device::focuser::{self, Command};

use super::instrument::{Instrument, Voice};
use crate::patience::seconds;
use crate::trouble::Trouble;

/// A focuser.
pub struct Focuser {
    /// The device.
    pub instrument: Instrument<focuser::Focuser>,
    /// Its configuration.
    pub config: config::Focuser,
    found_at_start: OnceLock<i64>,
}

/// What a row asks of the focus, steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wanted {
    /// An absolute position; wins over the shift.
    pub position: Option<i64>,
    /// From the best position.
    pub shift: Option<i64>,
    /// Of the filter in the beam.
    pub filter_offset: i64,
}

/// The slowest focuser needs less for its whole range, sky time.
const TRAVEL: Duration = Duration::from_secs(180);

impl Focuser {
    /// Begins to hear a focuser.
    pub async fn listen(voice: &Voice, device: Device, config: config::Focuser) -> anyhow::Result<Self> {
        let instrument = Instrument::listen(voice, device).await?;
        Ok(Self { instrument, config, found_at_start: OnceLock::new() })
    }

    /// The best position: as configured, or where the focuser was first seen.
    pub fn best(&self) -> Option<i64> {
        if self.config.best_position.is_some() {
            return self.config.best_position;
        }
        if let Some(position) = self.position() {
            let _ = self.found_at_start.set(position);
        }
        self.found_at_start.get().copied()
    }

    fn position(&self) -> Option<i64> {
        self.instrument.fresh().and_then(|state| state.fields.position.known().copied())
    }

    /// Moves to where a row wants it, and settles.
    pub async fn focus(&self, wanted: Wanted) -> Result<(), Trouble> {
        let can = self.instrument.capabilities().await?;
        if !can.absolute {
            return match wanted {
                Wanted { position: None, shift: None, .. } => Ok(()),
                _ => Err(Trouble::Impossible(format!("{} does not know its position", self.instrument.device))),
            };
        }
        let best = self.best();
        if best.is_none() && wanted.position.is_none() {
            // it may only be away for a while
            let (device, verb) = (self.instrument.device.to_string(), "focus".to_owned());
            return Err(Trouble::Failed { device, verb, reason: "its position is not known".to_owned() });
        }
        let target = target(wanted, best, can.max_step)?;
        let near =
            self.position().is_some_and(|now| now.abs_diff(target) <= self.config.tolerance_steps.unsigned_abs());
        if near {
            return Ok(());
        }
        self.instrument.obey(Command::Move { position: target }, TRAVEL).await?;
        self.instrument.clock().sleep_sky(seconds(self.config.settle_s)).await;
        Ok(())
    }
}

fn target(wanted: Wanted, best: Option<i64>, max_step: i64) -> Result<i64, Trouble> {
    let from = match (wanted.position, best) {
        (Some(position), _) => position,
        (None, Some(best)) => best.saturating_add(wanted.shift.unwrap_or(0)),
        (None, None) => return Err(Trouble::Impossible("the focuser's best position is not known".to_owned())),
    };
    let target = from.saturating_add(wanted.filter_offset);
    if (0..=max_step).contains(&target) {
        Ok(target)
    } else {
        Err(Trouble::Impossible(format!("focus position {target} is outside the focuser's 0 to {max_step}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_wins_over_a_shift_and_the_filter_adds_its_offset() {
        let wanted = |position, shift, filter_offset| Wanted { position, shift, filter_offset };
        assert_eq!(target(wanted(Some(100), Some(50), 7), Some(1000), 5000).unwrap(), 107);
        assert_eq!(target(wanted(None, Some(-50), 7), Some(1000), 5000).unwrap(), 957);
        assert_eq!(target(wanted(None, None, 0), Some(1000), 5000).unwrap(), 1000);
        assert!(target(wanted(None, Some(1), 0), None, 5000).is_err());
        assert!(target(wanted(Some(6000), None, 0), None, 5000).is_err());
    }
}
