//! The play of a Dec gear: which part of a pulse moves nothing.
//!
//! ```text
//!   Searching --a pulse took hold-----> Holding --pulse to the other side--> Turning --play used up--> Holding
//!       ^                                  '----- play not known -----> Searching
//! ```
//! Between the flanks of its gear the motor turns freely for the play (s of pulse). Where it stands is not known until
//! pulses are seen to take hold; what is missing until then is charged to the gear and not to the sky, so that no
//! drift is learnt that is none. A play that nobody measured is learnt at the first reversal; from then on reversals
//! are foreseen and made up for.

/// A gear has no more play than this, s of pulse.
const MOST_PLAY_S: f64 = 5.0;
/// A pulse that moved this share of what it could has reached the flank: the next ones take hold from the beginning.
const TOOK_HOLD: f64 = 0.25;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Gear {
    /// Pushed to a side (0: never yet), but where it takes hold is not known: lost so far, s; whether all of the
    /// play is being measured.
    Searching { side: f64, lost_s: f64, whole: bool },
    /// On the flank of a side.
    Holding { side: f64 },
    /// On its way to a side through a play that is known; way left, s.
    Turning { side: f64, left_s: f64 },
}

/// A gear's play, and where in it the motor stands.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Slack {
    /// The whole play, s of pulse; None until it is known.
    play_s: Option<f64>,
    gear: Gear,
}

impl Slack {
    /// A gear with this play, s of pulse, or one that is not known.
    pub(super) fn new(play_s: Option<f64>) -> Self {
        let play_s = play_s.filter(|play_s| play_s.is_finite()).map(|play_s| play_s.clamp(0.0, MOST_PLAY_S));
        Self { play_s, gear: Gear::Searching { side: 0.0, lost_s: 0.0, whole: false } }
    }

    /// Whether pulses must be long enough to be seen, because it is not known whether they take hold.
    pub(super) fn is_searching(&self) -> bool {
        self.play_s != Some(0.0) && matches!(self.gear, Gear::Searching { .. })
    }

    /// What a pulse to a side (1 North, -1 South) is known to lose, s.
    pub(super) fn before(&self, to: f64) -> f64 {
        let play_s = self.play_s.unwrap_or(0.0);
        match self.gear {
            Gear::Searching { .. } => 0.0,
            Gear::Holding { side } => {
                if side == to {
                    0.0
                } else {
                    play_s
                }
            }
            Gear::Turning { side, left_s } => {
                if side == to {
                    left_s
                } else {
                    play_s - left_s
                }
            }
        }
    }

    /// A pulse was given (s, North positive); answers the part that is believed to move the mount, s.
    pub(super) fn pulse(&mut self, pulse_s: f64) -> f64 {
        if pulse_s == 0.0 {
            return 0.0;
        }
        let to = pulse_s.signum();
        let free_s = self.before(to);
        let lost_s = free_s.min(pulse_s.abs());
        self.gear = match self.gear {
            same @ Gear::Searching { side, .. } if side == to => same,
            Gear::Searching { .. } => Gear::Searching { side: to, lost_s: 0.0, whole: false },
            Gear::Holding { side } if side != to && self.play_s.is_none() => {
                Gear::Searching { side: to, lost_s: 0.0, whole: true }
            }
            Gear::Holding { .. } | Gear::Turning { .. } if lost_s < free_s => {
                Gear::Turning { side: to, left_s: free_s - lost_s }
            }
            Gear::Holding { .. } | Gear::Turning { .. } => Gear::Holding { side: to },
        };
        pulse_s - to * lost_s
    }

    /// The last pulse (s, signed), believed to move all it could, was seen to move this share of that: answers what
    /// the gear has lost of it, s.
    pub(super) fn blame(&mut self, pulse_s: f64, share: f64) -> f64 {
        let Gear::Searching { side, lost_s, whole } = self.gear else { return 0.0 };
        if self.play_s == Some(0.0) || side != pulse_s.signum() {
            return 0.0;
        }
        let left_s = self.play_s.unwrap_or(MOST_PLAY_S) - lost_s;
        let now_s = ((1.0 - share.clamp(0.0, 1.0)) * pulse_s.abs()).min(left_s);
        let lost_s = lost_s + now_s;
        self.gear = if share >= TOOK_HOLD || now_s >= left_s {
            if whole {
                self.play_s = Some(lost_s);
            }
            Gear::Holding { side }
        } else {
            Gear::Searching { side, lost_s, whole }
        };
        now_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_flank_is_found_and_reversals_are_foreseen() {
        let mut slack = Slack::new(Some(2.0));
        assert_eq!((slack.before(1.0), slack.pulse(0.8)), (0.0, 0.8));
        assert_eq!(slack.blame(0.8, -0.2), 0.8, "no more than was given");
        assert_eq!(slack.pulse(1.0), 1.0);
        assert!(slack.is_searching());
        assert!((slack.blame(1.0, 0.6) - 0.4).abs() < 1e-12 && !slack.is_searching());
        assert_eq!((slack.before(1.0), slack.before(-1.0)), (0.0, 2.0), "North has taken hold");
        assert_eq!(slack.pulse(-1.5), 0.0);
        assert_eq!((slack.before(1.0), slack.before(-1.0)), (1.5, 0.5));
        assert!((slack.pulse(-1.0) + 0.5).abs() < 1e-12);
        assert_eq!(slack.blame(-1.0, 0.3), 0.0, "what is known is not blamed again");
    }

    #[test]
    fn a_play_that_nobody_measured_is_learnt_at_the_first_reversal() {
        let mut slack = Slack::new(None);
        slack.pulse(0.5);
        slack.blame(0.5, 1.0);
        assert!(!slack.is_searching());
        for (pulse_s, share) in [(-0.5, 0.0), (-0.8, 0.25), (-0.4, 1.0), (-0.4, 1.0)] {
            assert_eq!((slack.before(-1.0), slack.pulse(pulse_s)), (0.0, pulse_s));
            slack.blame(pulse_s, share);
        }
        assert!((slack.before(1.0) - 1.1).abs() < 1e-12);
        assert_eq!(slack.before(-1.0), 0.0);
    }

    #[test]
    fn a_gear_without_play_is_never_blamed() {
        let mut slack = Slack::new(Some(0.0));
        assert_eq!((slack.pulse(-0.5), slack.blame(-0.5, 0.0), slack.before(1.0)), (-0.5, 0.0, 0.0));
        assert!(!slack.is_searching());
        assert_eq!(Slack::new(Some(f64::NAN)), Slack::new(None));
    }
}
