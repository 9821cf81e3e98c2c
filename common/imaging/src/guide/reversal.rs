//! When Dec may turn round: each reversal costs the backlash, so noise must not cause one.
//!
//! The rule of PHD2's "resist switch" (its manual, "Guide Algorithms"): of the last ten errors beyond the dead band at
//! least three more lie on the new side than on the old, and the newest three sum to more than the oldest three; or the
//! error is beyond three dead bands, and no fluke: then at once.

use std::collections::VecDeque;

const REMEMBERED: usize = 10;
const NET_SIGNS: i32 = 3;
const NEWEST: usize = 3;
const AT_ONCE: f64 = 3.0;

/// Which way an axis is being pushed, and what speaks for turning round.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Reversal {
    /// Sign of the motions at present; 0 before the first.
    side: f64,
    errors_px: VecDeque<f64>,
}

impl Reversal {
    /// Remembers an error, px.
    pub(super) fn note(&mut self, error_px: f64) {
        self.errors_px.push_back(error_px);
        if self.errors_px.len() > REMEMBERED {
            self.errors_px.pop_front();
        }
    }

    /// Whether a star may be moved by `wanted_px`; a motion that is allowed makes its side the present one.
    pub(super) fn allows(&mut self, wanted_px: f64, dead_band_px: f64) -> bool {
        let side = wanted_px.signum();
        let allowed = side == self.side || self.is_due(side, dead_band_px);
        if allowed && side != self.side {
            self.side = side;
            // what spoke for this side must not speak against going back
            self.errors_px.clear();
        }
        allowed
    }

    /// Whether the errors ask for motions to this side.
    fn is_due(&self, side: f64, dead_band_px: f64) -> bool {
        // an error asks for a motion to the other side
        let asked = |error: &f64| -side * error;
        let newest = self.errors_px.back().map_or(0.0, asked);
        if newest > AT_ONCE * dead_band_px {
            return true;
        }
        let sign = |error: &f64| match asked(error) {
            asked if asked > dead_band_px => 1,
            asked if asked < -dead_band_px => -1,
            _ => 0,
        };
        let net: i32 = self.errors_px.iter().map(sign).sum();
        let newest: f64 = self.errors_px.iter().rev().take(NEWEST).map(asked).sum();
        let oldest: f64 = self.errors_px.iter().take(NEWEST).map(asked).sum();
        net >= NET_SIGNS && (self.errors_px.len() <= NEWEST || newest > oldest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(side: f64, errors: &[f64]) -> Reversal {
        Reversal { side, errors_px: errors.iter().copied().collect() }
    }

    #[test]
    fn noise_does_not_turn_it_round() {
        let mut held = after(1.0, &[0.2, -0.2, 0.25, -0.1, 0.3, -0.3, 0.1, 0.2]);
        assert!(!held.allows(-0.2, 0.15) && held.allows(0.2, 0.15));
    }

    #[test]
    fn errors_that_stay_on_one_side_and_grow_turn_it_round() {
        let mut growing = after(1.0, &[0.0, 0.05, 0.16, 0.2, 0.25, 0.3]);
        assert!(growing.allows(-0.3, 0.15));
        assert!(!growing.allows(0.1, 0.15), "and it stays turned round");
        assert!(!after(1.0, &[0.4, 0.3, 0.3, 0.2, 0.2, 0.2]).allows(-0.2, 0.15), "shrinking errors cure themselves");
    }

    #[test]
    fn a_great_error_turns_it_round_at_once_and_a_small_one_does_not_begin() {
        assert!(after(1.0, &[0.5]).allows(-0.5, 0.15));
        assert!(!after(1.0, &[-0.5]).allows(-0.5, 0.15), "against the error");
        assert!(!after(0.0, &[0.1]).allows(-0.1, 0.15));
        assert!(after(0.0, &[1.0]).allows(-1.0, 0.15));
    }
}
