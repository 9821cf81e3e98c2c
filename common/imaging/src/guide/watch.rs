//! Whether pulses do what they are given for: looks at errors and pulses alone, whatever the filters believe.
//!
//! A guider that believes something wrong of the mount can keep its own errors going: by a play that it makes up for too
//! much, by a drift that is none, by a calibration whose sign is wrong. Errors that pulses should have taken away, and did
//! not, show that; what was believed is then forgotten.

use std::collections::VecDeque;

use super::decision::Unstable;

/// Frames that are looked at.
const FRAMES: usize = 8;
/// Errors count beyond this, px, and beyond so many standard errors.
const LEAST_PX: f64 = 0.75;
const LEAST_SIGMA: f64 = 5.0;
/// So many changes of side among them, driven by pulses of at least this share of the error, are an oscillation.
const CHANGES: usize = 3;
const DRIVEN: f64 = 0.5;
/// So many errors in a row on one side, against which less than this share of them was pulsed, are a false belief.
const LEFT_FRAMES: usize = 5;
const LEFT_SHARE: f64 = 0.5;
/// Errors that shrink to this share over those frames cure themselves.
const SHRINKING: f64 = 0.8;
/// So many in a row beyond this, px: pulses do not help.
const NOT_HELD_FRAMES: u32 = 12;
const NOT_HELD_PX: f64 = 2.0;
/// So many pulses in a row that moved the star to the other side by these shares of what they should: a wrong sign.
const BACKWARDS: u32 = 3;
const BACKWARDS_SHARE: std::ops::Range<f64> = -1.5..-0.6;
/// A pulse shows that if it moves the star by this, px, and so many standard errors.
const CLEAR_PX: f64 = 1.0;
const CLEAR_SIGMA: f64 = 8.0;
/// After so many quiet frames the loop is held again.
const QUIET_FRAMES: u32 = 10;

/// Errors and pulses of one axis.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Watch {
    /// Of frames that count: error, and the motion that was asked for after it, px; newest last.
    recent: VecDeque<(f64, f64)>,
    /// Frames in a row: beyond what pulses should leave, within it.
    beyond: u32,
    quiet: u32,
    /// Pulses in a row that went to the wrong side.
    backwards: u32,
    unstable: Option<Unstable>,
}

impl Watch {
    /// Why the axis is not held, if it is not.
    pub(super) fn unstable(&self) -> Option<Unstable> {
        self.unstable
    }

    /// The star moved by `seen_px` where pulses should have moved it by `motion_px`; standard error of a place, px.
    pub(super) fn moved(&mut self, seen_px: f64, motion_px: f64, sigma_px: f64) {
        if motion_px.abs() > CLEAR_PX.max(CLEAR_SIGMA * sigma_px) {
            let is_backwards = BACKWARDS_SHARE.contains(&(seen_px / motion_px));
            self.backwards = if is_backwards { self.backwards + 1 } else { 0 };
        }
    }

    /// A measured error; answers what it shows for the first time.
    pub(super) fn observe(&mut self, error_px: f64, sigma_px: f64) -> Option<Unstable> {
        let least_px = LEAST_PX.max(LEAST_SIGMA * sigma_px);
        self.quiet = if error_px.abs() > least_px { 0 } else { self.quiet + 1 };
        self.beyond = if error_px.abs() > NOT_HELD_PX.max(least_px) { self.beyond + 1 } else { 0 };
        if self.quiet >= QUIET_FRAMES {
            self.unstable = None;
        }
        let found = if self.backwards >= BACKWARDS {
            Unstable::WrongWay
        } else if self.oscillates(error_px, least_px) {
            Unstable::Oscillates
        } else if self.beyond >= NOT_HELD_FRAMES || self.is_left(error_px, least_px) {
            Unstable::NotHeld
        } else {
            self.recent.push_back((error_px, 0.0));
            if self.recent.len() > FRAMES {
                self.recent.pop_front();
            }
            return None;
        };
        *self = Self { unstable: Some(found), ..Self::default() };
        Some(found)
    }

    /// A motion that was asked for after the last error, px.
    pub(super) fn asked(&mut self, motion_px: f64) {
        if let Some((_, asked_px)) = self.recent.back_mut() {
            *asked_px = motion_px;
        }
    }

    /// The field was moved on purpose: what it shows before says nothing of what it shows after.
    pub(super) fn forget(&mut self) {
        *self = Self { unstable: self.unstable, ..Self::default() };
    }

    fn oscillates(&self, error_px: f64, least_px: f64) -> bool {
        let (mut changes, mut side, mut asked_px) = (0, 0.0, 0.0_f64);
        for (error_px, asked) in self.recent.iter().copied().chain([(error_px, 0.0)]) {
            if error_px.abs() > least_px {
                let is_driven = asked_px * error_px > 0.0 && asked_px.abs() > DRIVEN * error_px.abs();
                changes += usize::from(side * error_px < 0.0 && is_driven);
                side = error_px.signum();
                asked_px = 0.0;
            }
            asked_px += asked;
        }
        changes >= CHANGES
    }

    /// Errors stay on one side, and next to nothing is done against them.
    fn is_left(&self, error_px: f64, least_px: f64) -> bool {
        let before = self.recent.iter().rev().take(LEFT_FRAMES - 1);
        let is_beyond = |(other_px, _): &(f64, f64)| other_px * error_px.signum() > least_px;
        let (errors_px, asked_px) = before.clone().fold((0.0, 0.0), |(e, a), (error, asked)| (e + error, a + asked));
        let oldest_px = before.clone().next_back().map_or(f64::INFINITY, |(oldest_px, _)| oldest_px.abs());
        self.recent.len() >= LEFT_FRAMES - 1
            && error_px.abs() > least_px.max(SHRINKING * oldest_px)
            && before.clone().all(is_beyond)
            && -asked_px * error_px.signum() < LEFT_SHARE * errors_px.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found in errors, each answered by a share of it.
    fn found(errors_px: &[f64], share: f64) -> Option<Unstable> {
        let mut watch = Watch::default();
        errors_px.iter().find_map(|error_px| {
            let found = watch.observe(*error_px, 0.05);
            watch.asked(-share * error_px);
            found
        })
    }

    #[test]
    fn errors_that_pulses_throw_to_and_fro_are_an_oscillation_and_wind_is_none() {
        let errors_px = [2.0, 2.4, -2.0, -2.2, 2.0, 2.4, -2.0, -2.3];
        assert_eq!(found(&errors_px, 1.0), Some(Unstable::Oscillates));
        assert_eq!(found(&errors_px, 0.2), None, "they are not by pulses");
        assert_eq!(found(&[0.3, -0.3, 0.3, -0.3, 0.3, -0.3, 0.3, -0.3], 1.0), None);
        assert_eq!(found(&[8.0, -3.0, 1.0, -0.2, 0.1, 0.0, 0.0], 1.0), None, "a jump that is taken back");
    }

    #[test]
    fn errors_that_nothing_is_done_against_are_found_and_a_drift_that_is_held_is_not() {
        assert_eq!(found(&[2.0, 2.0, 2.1, 2.1, 2.2], 0.1), Some(Unstable::NotHeld));
        assert_eq!(found(&[2.0, 2.0, 2.1, 2.1, 2.2], 1.5), None);
        assert_eq!(found(&[3.0; 20], 1.5), Some(Unstable::NotHeld), "pulses do nothing");
    }

    #[test]
    fn pulses_that_go_to_the_wrong_side_are_found_at_the_third_and_a_gust_is_none() {
        let mut watch = Watch::default();
        for (seen_px, expected) in [(-2.0, None), (-2.0, None), (0.0, None), (-2.0, None), (-2.2, None)] {
            watch.moved(seen_px, 2.0, 0.05);
            assert_eq!(watch.observe(0.1, 0.05), expected);
        }
        watch.moved(-1.8, 2.0, 0.05);
        assert_eq!(watch.observe(0.1, 0.05), Some(Unstable::WrongWay));
        (0..QUIET_FRAMES).for_each(|_| assert_eq!(watch.observe(0.1, 0.05), None));
        assert_eq!(watch.unstable(), None);
    }
}
