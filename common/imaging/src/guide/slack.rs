//! The play of a Dec gear: which part of a pulse moves nothing.
//!
//! ```text
//!   Searching --a pulse took hold-----> Holding --pulse to the other side--> Turning --play used up--> Holding
//!       ^                                  '----- play not known -----> Searching
//! ```
//! Between the flanks of its gear the motor turns freely for the play (s of pulse). Where it stands is not known until
//! pulses are seen to take hold; what is missing until then is charged to the gear and not to the sky, so that no
//! drift is learned that is none. A play that nobody measured is learned at the first two reversals; from then on they
//! are foreseen and made up for.
//!
//! What is made up for too much throws the star to the other side, and the next reversal throws it back: a play that is
//! believed too great keeps itself going. So each reversal is measured again, and the middle one of the last three
//! estimates holds: one bad frame teaches nothing, and a wrong play is gone after two reversals.

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
    /// The last estimates of the whole play, s of pulse, newest last.
    estimates_s: [Option<f64>; 3],
    /// A gear that has none, beyond doubt.
    is_fixed: bool,
    gear: Gear,
}

impl Slack {
    /// A gear with this play, s of pulse, or one that is not known.
    pub(super) fn new(play_s: Option<f64>) -> Self {
        let play_s = play_s.filter(|play_s| play_s.is_finite()).map(|play_s| play_s.clamp(0.0, MOST_PLAY_S));
        let gear = Gear::Searching { side: 0.0, lost_s: 0.0, whole: false };
        Self { estimates_s: [play_s; 3], is_fixed: play_s == Some(0.0), gear }
    }

    /// The same gear, of which nobody knows any more how much play it has, nor where the motor stands.
    pub(super) fn forgotten(&self) -> Self {
        let gear = Gear::Searching { side: 0.0, lost_s: 0.0, whole: false };
        Self { estimates_s: [None; 3], gear, ..*self }
    }

    /// The mount slewed: the motor stands anywhere in its play.
    pub(super) fn moved(&mut self) {
        self.gear = Gear::Searching { side: 0.0, lost_s: 0.0, whole: false };
    }

    /// The whole play, s of pulse; None until two reversals have shown it, the smaller one of two.
    fn play_s(&self) -> Option<f64> {
        let mut known_s: Vec<f64> = self.estimates_s.iter().flatten().copied().collect();
        known_s.sort_by(f64::total_cmp);
        (known_s.len() > 1).then(|| known_s.get((known_s.len() - 1) / 2).copied()).flatten()
    }

    fn estimate(&mut self, play_s: f64) {
        let [_, before_s, newest_s] = self.estimates_s;
        self.estimates_s = [before_s, newest_s, Some(play_s.clamp(0.0, MOST_PLAY_S))];
    }

    /// What was lost so far while it is not known where the gear takes hold, s.
    pub(super) fn lost_s(&self) -> f64 {
        if let Gear::Searching { lost_s, .. } = self.gear { lost_s } else { 0.0 }
    }

    /// Whether pulses must be long enough to be seen, because it is not known whether they take hold.
    pub(super) fn is_searching(&self) -> bool {
        !self.is_fixed && matches!(self.gear, Gear::Searching { .. })
    }

    /// What a pulse to a side (1 North, -1 South) is known to lose, s.
    pub(super) fn before(&self, to: f64) -> f64 {
        let play_s = self.play_s().unwrap_or(0.0);
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

    /// Whether a pulse to this side would turn the gear round.
    pub(super) fn turns(&self, to: f64) -> bool {
        match self.gear {
            Gear::Searching { side, .. } | Gear::Holding { side } | Gear::Turning { side, .. } => {
                !self.is_fixed && side == -to
            }
        }
    }

    /// A pulse was given (s, North positive); answers the part that is believed to move the mount, s.
    pub(super) fn pulse(&mut self, pulse_s: f64) -> f64 {
        if pulse_s == 0.0 || self.is_fixed {
            return pulse_s;
        }
        let to = pulse_s.signum();
        let free_s = self.before(to);
        let lost_s = free_s.min(pulse_s.abs());
        self.gear = match self.gear {
            same @ (Gear::Searching { side, .. } | Gear::Holding { side }) if side == to => same,
            Gear::Searching { .. } => Gear::Searching { side: to, lost_s: 0.0, whole: false },
            Gear::Holding { .. } | Gear::Turning { .. } if lost_s < free_s => {
                Gear::Turning { side: to, left_s: free_s - lost_s }
            }
            Gear::Holding { .. } => Gear::Searching { side: to, lost_s: free_s, whole: true },
            Gear::Turning { side, .. } if side == to => {
                Gear::Searching { side: to, lost_s: self.play_s().unwrap_or(0.0), whole: true }
            }
            Gear::Turning { .. } => Gear::Searching { side: to, lost_s: 0.0, whole: false },
        };
        pulse_s - to * lost_s
    }

    /// A pulse that was believed to move the mount for `moved_s` (signed) was seen to move it by this share of that:
    /// answers what the gear has lost of it, s; less than nothing where it lost less than was believed.
    pub(super) fn blame(&mut self, moved_s: f64, share: f64) -> f64 {
        let side = moved_s.signum();
        let (lost_s, whole) = match self.gear {
            _ if self.is_fixed => return 0.0,
            Gear::Searching { side: to, lost_s, whole } if side == to => (lost_s, whole),
            // it held, and does not any more: nobody knows where the motor stands
            Gear::Holding { side: to } if side == to && share < TOOK_HOLD => (0.0, false),
            _ => return 0.0,
        };
        let now_s = ((1.0 - share.max(0.0)) * moved_s.abs()).clamp(-lost_s, MOST_PLAY_S - lost_s);
        let lost_s = lost_s + now_s;
        self.gear = if share >= TOOK_HOLD || lost_s >= MOST_PLAY_S {
            if whole {
                self.estimate(lost_s);
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
        assert!(slack.is_searching(), "nobody has seen yet that it took hold");
        assert_eq!((slack.blame(-0.5, 1.0), slack.is_searching()), (0.0, false));
    }

    /// A reversal that is seen to take hold with so much more motion than was believed, s.
    fn reversal(slack: &mut Slack, to: f64, more_s: f64) {
        let moved_s = slack.pulse(to * (slack.before(to) + 0.5));
        assert!((moved_s - to * 0.5).abs() < 1e-12);
        slack.blame(moved_s, 1.0 + more_s / 0.5);
        while slack.is_searching() {
            let moved_s = slack.pulse(to * 0.5);
            slack.blame(moved_s, 1.0);
        }
    }

    #[test]
    fn a_play_that_nobody_measured_is_learned_at_two_reversals() {
        let mut slack = Slack::new(None);
        slack.pulse(0.5);
        slack.blame(0.5, 1.0);
        assert!(!slack.is_searching());
        for side in [-1.0, 1.0] {
            assert_eq!(slack.before(side), 0.0, "one reversal is not believed");
            for (pulse_s, share) in [(0.5, 0.0), (0.8, 0.25), (0.4, 1.0), (0.4, 1.0)] {
                assert_eq!((slack.before(side), slack.pulse(side * pulse_s)), (0.0, side * pulse_s));
                slack.blame(side * pulse_s, share);
            }
        }
        assert!((slack.before(-1.0) - 1.1).abs() < 1e-12);
        assert_eq!(slack.before(1.0), 0.0);
    }

    #[test]
    fn one_reversal_changes_no_play_that_is_known_and_two_do() {
        let mut slack = Slack::new(Some(2.0));
        slack.pulse(0.5);
        slack.blame(0.5, 1.0);
        for (to, more_s, next_s) in [(-1.0, 1.5, 2.0), (1.0, 0.0, 2.0), (-1.0, 1.5, 0.5), (1.0, 9.0, 0.5)] {
            reversal(&mut slack, to, more_s);
            assert!((slack.before(-to) - next_s).abs() < 1e-12, "{to} {more_s}: {slack:?}");
        }
    }

    #[test]
    fn a_gear_that_held_and_does_not_any_more_is_looked_for() {
        let mut slack = Slack::new(Some(1.0));
        slack.pulse(0.5);
        slack.blame(0.5, 1.0);
        assert_eq!((slack.pulse(0.5), slack.blame(0.5, 0.0), slack.is_searching()), (0.5, 0.5, true));
        let forgotten = slack.forgotten();
        assert_eq!((forgotten.before(-1.0), forgotten.is_searching()), (0.0, true));
    }

    #[test]
    fn a_gear_without_play_is_never_blamed() {
        let mut slack = Slack::new(Some(0.0));
        assert_eq!((slack.pulse(-0.5), slack.blame(-0.5, 0.0), slack.before(1.0)), (-0.5, 0.0, 0.0));
        assert!(!slack.is_searching() && !slack.forgotten().is_searching());
        assert_eq!(Slack::new(Some(f64::NAN)), Slack::new(None));
    }
}
