//! A focus run, one step at a time: where to go, when to expose, and what came of it.
//!
//! ```text
//!  Coarse --focus inside--> Fine --believable--> Verification --sharp--> Done(Focused)
//!   |  ^                     | ^                  | ^     |
//!   |  +-- focus beyond an   | +-- uncertain:     | +-----+ up to 3 frames
//!   |      end: half a range |     once more      |
//!   |      more, 3 times     |                    |
//!   +------------------------+--------------------+--> back to the start --> Done(Failed)
//! ```
//!
//! The caller does what [`Sweep::next`] says, in order, and reports each frame's value with [`Sweep::measured`]. All
//! positions are approached from one side. The run needs 16 to 20 frames.

mod judge;
mod plan;

use std::collections::VecDeque;

pub use plan::{ApproachSide, BadPlan, Curve, Plan};

use super::hyperbola::Hyperbola;
use super::operator::Better;
use crate::quality::Estimate;

/// Times the range is moved on when the focus lies beyond an end.
const EXTENSIONS: usize = 3;
/// Rounds of fine positions.
const FINE_ROUNDS: usize = 3;
/// Frames that verify the focus, at most.
const VERIFICATIONS: usize = 3;

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum FocusStep {
    /// Move the focuser there, and wait until it stands.
    Move(i32),
    /// Take a frame, measure it, and report the value.
    Expose(Pass),
    /// The run is over; the focuser stands where the result says.
    Done(Result<Focused, Failed>),
}

/// What a frame is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pass {
    /// To see where the focus is.
    Coarse,
    /// To measure it.
    Fine,
    /// To see whether it is.
    Verification,
}

/// What was measured at a position.
#[derive(Debug, Clone, PartialEq)]
pub struct FocusMeasurement {
    /// Position of the focuser, steps.
    pub position: i32,
    /// What the frame was for.
    pub pass: Pass,
    /// Size or sharpness; None when the frame had no value.
    pub value: Option<Estimate>,
}

/// The curve through a run.
#[derive(Debug, Clone, PartialEq)]
pub enum FocusFit {
    /// Through star sizes.
    Hyperbola(Hyperbola),
    /// Through the values of another operator.
    Smoothed {
        /// The smoother's name.
        smoother: &'static str,
        /// Which way is better.
        better: Better,
        /// Position and value, in order of position.
        curve: Vec<(f64, f64)>,
        /// The best of them.
        best: (f64, f64),
    },
}

impl FocusFit {
    /// Where the curve is best, steps.
    pub fn best_position(&self) -> f64 {
        match self {
            Self::Hyperbola(curve) => curve.best_position,
            Self::Smoothed { best, .. } => best.0,
        }
    }

    /// Its value there.
    pub fn best_value(&self) -> f64 {
        match self {
            Self::Hyperbola(curve) => curve.least_size,
            Self::Smoothed { best, .. } => best.1,
        }
    }

    /// Standard error of the best position, steps; None for smoothed curves, which know none.
    pub fn best_position_error(&self) -> Option<f64> {
        match self {
            Self::Hyperbola(curve) => Some(curve.best_position_error),
            Self::Smoothed { .. } => None,
        }
    }

    /// Half width of the bottom, steps; None for smoothed curves.
    pub fn critical_zone(&self) -> Option<f64> {
        match self {
            Self::Hyperbola(curve) => Some(curve.critical_zone()),
            Self::Smoothed { .. } => None,
        }
    }
}

/// A focus that was found and verified.
#[derive(Debug, Clone, PartialEq)]
pub struct Focused {
    /// Where the focuser stands, steps.
    pub position: i32,
    /// The curve, with the exact position and its error.
    pub fit: FocusFit,
    /// Median value of the verification frames.
    pub verified: f64,
}

/// A run without a focus.
#[derive(Debug, Clone, PartialEq)]
pub struct Failed {
    /// Why.
    pub reason: NoFocus,
    /// Where the focuser stands: where it stood at the start.
    pub position: i32,
}

/// Why a run found no focus.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoFocus {
    /// Hardly a frame had a value: no stars, clouds, a closed cover.
    #[error("{valid} frames had a value, {needed} are needed: look for clouds, a cover, a focus far off")]
    TooFewValues {
        /// Frames with a value.
        valid: usize,
        /// Frames needed.
        needed: usize,
    },
    /// The values have no minimum.
    #[error("the values have no best position: the curve is flat or its ends are better than its middle")]
    NoMinimum,
    /// The focus lies further out than the range could be moved.
    #[error("the focus lies beyond {position} still, after the range was moved {moved} times")]
    TooFar {
        /// Last position at that end, steps.
        position: i32,
        /// Times the range was moved.
        moved: usize,
    },
    /// The focus lies beyond the focuser's travel.
    #[error("the focus lies beyond the end of the focuser's travel at {position}")]
    AtLimit {
        /// The end, steps.
        position: i32,
    },
    /// Too few points on one side.
    #[error("{below} points below the focus and {above} above it; at least 2 are needed on either side, 5 in all")]
    OneSided {
        /// Points below.
        below: usize,
        /// Points above.
        above: usize,
    },
    /// The position is not known well enough.
    #[error("the focus is known to {error_steps:.1} steps only, its critical zone being {critical_zone_steps:.1}")]
    Uncertain {
        /// Standard error of the position, steps.
        error_steps: f64,
        /// Half width of the bottom of the curve, steps.
        critical_zone_steps: f64,
    },
    /// Frames at the focus are worse than the curve.
    #[error("at {position} frames show {}, the curve promised {promised:.2}", value.map_or("nothing".to_owned(), |value| format!("{value:.2}")))]
    NotVerified {
        /// The position that the curve gave, steps.
        position: i32,
        /// Median of what was measured there.
        value: Option<f64>,
        /// What the curve promised.
        promised: f64,
    },
    /// The caller ended the run.
    #[error("ended: {0}")]
    Ended(String),
}

/// A value that was reported although no frame was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no frame was asked for: ask for the next step first")]
pub struct NotAsked;

enum Order {
    Move(i32),
    Expose(Pass),
}

/// A run.
pub struct Sweep {
    plan: Plan,
    points: Vec<FocusMeasurement>,
    orders: VecDeque<Order>,
    /// Where the focuser will stand after the orders that were given.
    at: i32,
    asked: Option<Pass>,
    stage: Pass,
    /// Distance of the coarse positions, steps.
    spacing: f64,
    extensions: usize,
    has_narrowed: bool,
    fine_rounds: usize,
    chosen: Option<FocusFit>,
    outcome: Option<Result<Focused, Failed>>,
}

impl Sweep {
    /// Checks the plan.
    ///
    /// # Errors
    /// [`BadPlan`] when it cannot be carried out.
    pub fn new(plan: Plan) -> Result<Self, BadPlan> {
        plan.check()?;
        let (centre, half) = (f64::from(plan.centre), f64::from(plan.half_range));
        let first = plan.spread(centre - half, centre + half, plan.coarse);
        let width = first.iter().max().zip(first.iter().min()).map_or(0.0, |(high, low)| f64::from(high - low));
        let mut sweep = Self {
            at: plan.start,
            plan,
            points: Vec::new(),
            orders: VecDeque::new(),
            asked: None,
            stage: Pass::Coarse,
            spacing: (width / (first.len().max(2) - 1) as f64).max(1.0),
            extensions: 0,
            has_narrowed: false,
            fine_rounds: 0,
            chosen: None,
            outcome: None,
        };
        sweep.visit(&first, Pass::Coarse);
        Ok(sweep)
    }

    /// What to do next. A move is given once; a frame is asked for until its value is reported; the end stays the end.
    #[allow(clippy::should_implement_trait)] // it has no end, and needs answers in between
    pub fn next(&mut self) -> FocusStep {
        loop {
            if let Some(pass) = self.asked {
                return FocusStep::Expose(pass);
            }
            match (self.orders.pop_front(), &self.outcome) {
                (Some(Order::Move(position)), _) => {
                    self.at = position;
                    return FocusStep::Move(position);
                }
                (Some(Order::Expose(pass)), _) => self.asked = Some(pass),
                (None, Some(outcome)) => return FocusStep::Done(outcome.clone()),
                (None, None) => self.decide(),
            }
        }
    }

    /// Takes in the value of the frame that was asked for; None when it shows nothing. What is not a finite number, and
    /// sizes that are not positive, count as nothing.
    ///
    /// # Errors
    /// [`NotAsked`] when no frame was asked for.
    pub fn measured(&mut self, value: Option<Estimate>) -> Result<(), NotAsked> {
        let pass = self.asked.take().ok_or(NotAsked)?;
        let is_size = matches!(self.plan.curve, Curve::Hyperbola);
        let is_good = |value: &Estimate| value.value.is_finite() && (value.value > 0.0 || !is_size);
        self.points.push(FocusMeasurement { position: self.at, pass, value: value.filter(is_good) });
        Ok(())
    }

    /// Ends the run: the focuser goes back to where it stood.
    pub fn end(&mut self, why: &str) {
        if self.outcome.is_none() {
            self.asked = None;
            self.fail(NoFocus::Ended(why.to_owned()));
        }
    }

    /// What was measured so far.
    pub fn points(&self) -> &[FocusMeasurement] {
        &self.points
    }

    /// The curve through the points so far, verification frames left out.
    pub fn fit(&self) -> Option<FocusFit> {
        self.chosen.clone().or_else(|| judge::fit(&self.plan, &self.curve_points()))
    }

    fn curve_points(&self) -> Vec<FocusMeasurement> {
        self.points.iter().filter(|point| point.pass != Pass::Verification).cloned().collect()
    }

    fn decide(&mut self) {
        match self.stage {
            Pass::Coarse => self.after_coarse(),
            Pass::Fine => self.after_fine(),
            Pass::Verification => self.after_verification(),
        }
    }

    fn after_coarse(&mut self) {
        match judge::advice(&self.plan, &self.points, self.spacing) {
            judge::Advice::Fine { low, high } => self.look_closely(low, high),
            judge::Advice::Lower => self.extend(-1),
            judge::Advice::Higher => self.extend(1),
            judge::Advice::Narrow(centre) if !self.has_narrowed => {
                self.has_narrowed = true;
                let (centre, reach) = (f64::from(centre), 1.5 * self.spacing);
                let positions = self.plan.spread(centre - reach, centre + reach, self.plan.coarse);
                self.spacing = (2.0 * reach / (self.plan.coarse - 1) as f64).max(1.0);
                self.visit(&positions, Pass::Coarse);
            }
            judge::Advice::Narrow(_) | judge::Advice::Lost => {
                let valid = self.points.iter().filter(|point| point.value.is_some()).count();
                self.fail(NoFocus::TooFewValues { valid, needed: 5 });
            }
            judge::Advice::NoMinimum => self.fail(NoFocus::NoMinimum),
        }
    }

    /// Half a range more at the lower (-1) or upper (1) end.
    fn extend(&mut self, side: i32) {
        let positions = self.points.iter().map(|point| point.position);
        let end = if side < 0 { positions.min() } else { positions.max() }.unwrap_or(self.plan.centre);
        if self.extensions == EXTENSIONS {
            return self.fail(NoFocus::TooFar { position: end, moved: EXTENSIONS });
        }
        self.extensions += 1;
        let usable = self.plan.usable();
        let beyond = (1..=self.plan.coarse / 2).map(|n| f64::from(end) + f64::from(side) * self.spacing * n as f64);
        let beyond: Vec<i32> =
            beyond.map(|place| place.round() as i32).filter(|position| usable.contains(position)).collect();
        if beyond.is_empty() {
            return self.fail(NoFocus::AtLimit { position: end });
        }
        let positions = self.plan.ordered(beyond);
        self.visit(&positions, Pass::Coarse);
    }

    fn look_closely(&mut self, low: f64, high: f64) {
        self.stage = Pass::Fine;
        self.fine_rounds += 1;
        let positions = self.plan.spread(low, high, self.plan.fine);
        self.visit(&positions, Pass::Fine);
    }

    fn after_fine(&mut self) {
        let points = self.curve_points();
        match judge::accept(&self.plan, &points) {
            Ok(fit) => {
                self.stage = Pass::Verification;
                let position =
                    (fit.best_position().round() as i32).clamp(*self.plan.limits.start(), *self.plan.limits.end());
                self.chosen = Some(fit);
                self.visit(&[position], Pass::Verification);
            }
            // spoilt frames may have led astray: about the place that all points show now it will be seen
            Err(failure) => match judge::about_the_focus(&self.plan, &points, self.spacing) {
                Some((low, high)) if self.fine_rounds < FINE_ROUNDS => self.look_closely(low, high),
                _ => self.fail(failure),
            },
        }
    }

    fn after_verification(&mut self) {
        let Some(fit) = self.chosen.clone() else { return self.fail(NoFocus::NoMinimum) };
        let frames: Vec<&FocusMeasurement> =
            self.points.iter().filter(|point| point.pass == Pass::Verification).collect();
        let values: Vec<f64> = frames.iter().filter_map(|point| point.value).map(|value| value.value).collect();
        let (taken, valid) = (frames.len(), values.len());
        let median = super::median(values);
        // one good frame is enough; of three the middle one decides, frames without a value being bad
        let is_good = median.is_some_and(|value| judge::is_verified(&fit, value)) && 2 * valid > taken;
        match median.filter(|_| is_good && taken != 2) {
            Some(verified) => self.outcome = Some(Ok(Focused { position: self.at, fit, verified })),
            None if taken < VERIFICATIONS => self.orders.push_back(Order::Expose(Pass::Verification)),
            None => {
                let promised = fit.best_value();
                self.fail(NoFocus::NotVerified { position: self.at, value: median, promised });
            }
        }
    }

    fn visit(&mut self, positions: &[i32], pass: Pass) {
        if let Some(first) = positions.first() {
            self.orders.extend(self.plan.overshoot(self.at, *first).map(Order::Move));
        }
        for position in positions {
            self.orders.extend([Order::Move(*position), Order::Expose(pass)]);
        }
    }

    fn fail(&mut self, reason: NoFocus) {
        let start = self.plan.start;
        self.orders.clear();
        self.orders.extend(self.plan.overshoot(self.at, start).map(Order::Move));
        self.orders.push_back(Order::Move(start));
        self.outcome = Some(Err(Failed { reason, position: start }));
    }
}

#[cfg(test)]
mod tests;
