//! What a run must know before it starts, and which positions follow from it.

use std::ops::RangeInclusive;

use crate::focus::operator::Better;
use crate::focus::smooth::Smoother;

/// From which side every position is approached, so that the play of the gears is always taken up in the same way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ApproachSide {
    /// From lower numbers.
    #[default]
    Upward,
    /// From higher numbers.
    Downward,
}

/// What is drawn through the measured values.
#[derive(Debug, Clone, Copy, Default)]
pub enum Curve {
    /// A hyperbola: values are star sizes.
    #[default]
    Hyperbola,
    /// A smoothed curve: values of any operator, smaller or larger being better.
    Smoothed(&'static Smoother, Better),
}

/// A run, before it starts. Positions and lengths are the focuser's steps.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Where the focuser stands; a run that fails goes back there.
    pub start: i32,
    /// Middle of the first positions: the last focus known.
    pub centre: i32,
    /// First and last position are so far from the middle. Four critical zones are good.
    pub half_range: i32,
    /// Number of first positions, 5 to 50; 7 to 9 are good.
    pub coarse: usize,
    /// Number of positions about the focus that the first ones show, 5 to 50.
    pub fine: usize,
    /// How much of the first range these cover, 1 to 100 percent; three critical zones to either side where absent.
    pub closer_percent: Option<u32>,
    /// Lowest and highest position of the focuser.
    pub limits: RangeInclusive<i32>,
    /// Play of the gears, steps: so far positions are overshot before they are approached.
    pub backlash: i32,
    /// The side positions are approached from.
    pub approach: ApproachSide,
    /// What is drawn through the values.
    pub curve: Curve,
}

/// A run that cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadPlan {
    /// A number of positions is out of range.
    #[error("{what} positions: {count}; give 5 to 50")]
    Count {
        /// Which pass.
        what: &'static str,
        /// The number.
        count: usize,
    },
    /// The closer look would cover nothing, or more than the first.
    #[error("the closer look covers {percent} % of the range; give 1 to 100")]
    Closer {
        /// Of the first range.
        percent: u32,
    },
    /// The range or the backlash is not a length.
    #[error("{what} is {steps} steps; give {least} or more")]
    Length {
        /// Which length.
        what: &'static str,
        /// What was given, steps.
        steps: i32,
        /// The least it can be, steps.
        least: i32,
    },
    /// The focuser's travel leaves no room.
    #[error("between {low} and {high}, with {backlash} steps of backlash, there is no room for {count} positions")]
    NoRoom {
        /// Lowest position.
        low: i32,
        /// Highest position.
        high: i32,
        /// Steps of backlash.
        backlash: i32,
        /// Positions wanted.
        count: usize,
    },
}

impl Plan {
    /// The usual run about a position: 9 coarse and 7 fine positions, no backlash.
    pub fn about(centre: i32, half_range: i32, limits: RangeInclusive<i32>) -> Self {
        Self {
            start: centre,
            centre,
            half_range,
            coarse: 9,
            fine: 7,
            closer_percent: None,
            limits,
            backlash: 0,
            approach: ApproachSide::Upward,
            curve: Curve::Hyperbola,
        }
    }

    pub(super) fn check(&self) -> Result<(), BadPlan> {
        for (what, count) in [("coarse", self.coarse), ("fine", self.fine)] {
            if !(5..=50).contains(&count) {
                return Err(BadPlan::Count { what, count });
            }
        }
        if let Some(percent) = self.closer_percent.filter(|percent| !(1..=100).contains(percent)) {
            return Err(BadPlan::Closer { percent });
        }
        for (what, steps, least) in [("half range", self.half_range, 2), ("backlash", self.backlash, 0)] {
            if steps < least {
                return Err(BadPlan::Length { what, steps, least });
            }
        }
        let (low, high) = (*self.limits.start(), *self.limits.end());
        let room = self.usable();
        if i64::from(*room.end()) - i64::from(*room.start()) < self.coarse as i64 - 1 {
            return Err(BadPlan::NoRoom { low, high, backlash: self.backlash, count: self.coarse });
        }
        Ok(())
    }

    /// Positions that can be approached from the right side over the whole backlash.
    pub(super) fn usable(&self) -> RangeInclusive<i32> {
        let (low, high) = (*self.limits.start(), *self.limits.end());
        match self.approach {
            ApproachSide::Upward => low.saturating_add(self.backlash)..=high,
            ApproachSide::Downward => low..=high.saturating_sub(self.backlash),
        }
    }

    /// Evenly spaced positions between two places (moved or cut to what is usable), in order of approach, each once.
    pub(super) fn spread(&self, low: f64, high: f64, count: usize) -> Vec<i32> {
        let usable = self.usable();
        let (least, most) = (f64::from(*usable.start()), f64::from(*usable.end()));
        let width = (high - low).min(most - least);
        let low = low.clamp(least, (most - width).max(least));
        let step = width / (count.max(2) - 1) as f64;
        let mut positions: Vec<i32> = (0..count).map(|n| (low + step * n as f64).round() as i32).collect();
        positions.dedup();
        self.ordered(positions)
    }

    /// In order of approach.
    pub(super) fn ordered(&self, mut positions: Vec<i32>) -> Vec<i32> {
        positions.sort_unstable();
        if self.approach == ApproachSide::Downward {
            positions.reverse();
        }
        positions
    }

    /// From where a position is approached, when the focuser stands `at`; None when it stands on the right side, far
    /// enough away.
    pub(super) fn overshoot(&self, at: i32, position: i32) -> Option<i32> {
        let (low, high) = (*self.limits.start(), *self.limits.end());
        let (from, is_needed) = match self.approach {
            ApproachSide::Upward => {
                let from = position.saturating_sub(self.backlash);
                (from, at > from)
            }
            ApproachSide::Downward => {
                let from = position.saturating_add(self.backlash);
                (from, at < from)
            }
        };
        let from = from.clamp(low, high);
        (is_needed && from != position && from != at).then_some(from)
    }
}
