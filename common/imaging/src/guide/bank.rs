//! Where an axis would be without corrections, and where it will be: many Kalman filters, weighed by how well each
//! foretold what came.
//!
//! The noise of air, wind and gears differs from mount to mount and night to night, and a filter with the wrong
//! noise is slow or nervous. So a bank of filters runs side by side, each with another assumption ([`Assumption`]);
//! their predictions are averaged by their likelihood, older frames counting less (Magill 1965, IEEE Trans. Autom.
//! Control 10, 434). Those with a period learn a worm. A measurement that no weighty filter expected is left out.

use super::hypothesis::{Assumption, Hypothesis};

/// Grids of what is assumed.
const JITTERS_PX: [f64; 5] = [0.01, 0.05, 0.15, 0.4, 1.0];
const WALKS_PX: [f64; 5] = [0.002, 0.02, 0.07, 0.2, 0.7];
const DRIFT_WALKS_PX_S: [f64; 3] = [1e-6, 3e-4, 3e-3];
const PERIODIC_JITTERS_PX: [f64; 3] = [0.03, 0.12, 0.4];
const PERIODIC_WALKS_PX: [f64; 2] = [0.01, 0.1];
const PERIODIC_DRIFT_WALK_PX_S: f64 = 1e-5;
/// Worms turn in this time, s, and periods are tried in steps of this factor.
const PERIODS_S: (f64, f64) = (100.0, 2000.0);
const PERIOD_STEP: f64 = 1.025;
/// Periods that are tried around a known one.
const AROUND_KNOWN: [f64; 3] = [0.99, 1.0, 1.01];
/// A priori odds against a worm.
const WORM_IS_RARE: f64 = -5.0;
/// Weight of the past per frame: some 100 frames count.
const MEMORY: f64 = 0.99;
/// Measurements further off than this many standard deviations are left out; with each one left out the gate widens.
const GATE_SIGMA: f64 = 4.0;
/// So many in a row are no outliers any more, nor are two to the same side.
const MOST_REJECTED: u32 = 3;
/// Pauses longer than this make everything that was learned worthless, s.
const LONGEST_PAUSE_S: f64 = 1800.0;

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Learned {
    /// It was taken in.
    Taken,
    /// It was too surprising.
    Outlier,
    /// It does not come after the last one, or is not a number.
    Unusable,
}

/// The filters of one axis.
#[derive(Debug, Clone)]
pub(super) struct Bank {
    filters: Vec<(f64, Hypothesis)>,
    /// Known beforehand, s.
    worm_period_s: Option<f64>,
    /// Of the last frame, s.
    time_s: Option<f64>,
    /// Measurements that were taken in.
    frames: u32,
    /// Outliers in a row.
    rejected: u32,
    /// Side (sign) of the last outlier; 0 when there was none just before.
    outlier_side: f64,
}

impl Bank {
    /// A bank that knows nothing, except, perhaps, the period of the worm, s.
    pub(super) fn new(worm_period_s: Option<f64>) -> Self {
        let worm_period_s = worm_period_s.filter(|period| period.is_finite() && *period > 0.0);
        Self { filters: Vec::new(), worm_period_s, time_s: None, frames: 0, rejected: 0, outlier_side: 0.0 }
    }

    /// Time (s) of the last frame it took in.
    pub(super) fn time_s(&self) -> Option<f64> {
        self.time_s
    }

    /// Frames it has learned from.
    pub(super) fn frames(&self) -> u32 {
        self.frames
    }

    /// Lets time pass to a frame that showed nothing.
    pub(super) fn pass(&mut self, time_s: f64) {
        let Some(last_s) = self.time_s else { return };
        let dt_s = time_s - last_s;
        if dt_s.is_nan() || dt_s <= 0.0 {
            return;
        }
        if dt_s > LONGEST_PAUSE_S {
            *self = Self::new(self.worm_period_s);
            return;
        }
        self.time_s = Some(time_s);
        self.filters.iter_mut().for_each(|(_, filter)| filter.advance(dt_s));
    }

    /// Learns where the axis was (px, variance in px^2) at a time (s). With `gated` outliers are left out.
    pub(super) fn learn(&mut self, time_s: f64, place_px: f64, variance: f64, gated: bool) -> Learned {
        let is_number = time_s.is_finite() && place_px.is_finite() && variance.is_finite() && variance >= 0.0;
        if !is_number || self.time_s.is_some_and(|last_s| time_s <= last_s) {
            return Learned::Unusable;
        }
        let dt_s = self.time_s.map_or(0.0, |last_s| time_s - last_s);
        self.pass(time_s);
        if self.time_s.is_none() {
            self.filters = assumptions(self.worm_period_s)
                .map(|(weight, assumption)| (weight, Hypothesis::new(assumption, place_px)))
                .collect();
            self.time_s = Some(time_s);
        }
        let (expected_px, spread_px) = self.expected(0.0, variance);
        let surprise = (place_px - expected_px).abs();
        if surprise > GATE_SIGMA * spread_px * f64::from(1 + self.rejected) {
            let side = (place_px - expected_px).signum();
            let again = self.outlier_side == side;
            self.outlier_side = side;
            if gated && !again && self.rejected < MOST_REJECTED {
                self.rejected += 1;
                return Learned::Outlier;
            }
            // twice to the same side: it moved by a way that is not the sky's; only then it may be a drift
            let within_s = if again { dt_s } else { 0.0 };
            self.filters.iter_mut().for_each(|(_, filter)| filter.forget(surprise, within_s));
        }
        self.frames += 1;
        (self.rejected, self.outlier_side) = (0, 0.0);
        for (weight, filter) in &mut self.filters {
            *weight = MEMORY * *weight + filter.learn(place_px, variance);
            if !(weight.is_finite() && filter.is_finite()) {
                *filter = Hypothesis::new(filter.assumption(), place_px);
                *weight = f64::MIN;
            }
        }
        Learned::Taken
    }

    /// Where the axis is expected in `ahead_s` from the last frame, px, and the standard deviation of a measurement
    /// of this variance (px^2) at the last frame. Nothing is foreseen further than what was learned holds.
    pub(super) fn expected(&self, ahead_s: f64, variance: f64) -> (f64, f64) {
        let ahead_s = ahead_s.clamp(-LONGEST_PAUSE_S, LONGEST_PAUSE_S);
        let mean = self.weighed(|filter| filter.expected_px(ahead_s));
        let now = self.weighed(|filter| filter.expected_px(0.0));
        let spread = self.weighed(|filter| filter.variance(variance) + (filter.expected_px(0.0) - now).powi(2));
        (mean, spread.sqrt())
    }

    /// Drift, px/s, and its standard error.
    pub(super) fn drift_px_s(&self) -> (f64, f64) {
        let drift = self.weighed(|filter| filter.drift_px_s().0);
        let variance = self.weighed(|filter| filter.drift_px_s().1 + (filter.drift_px_s().0 - drift).powi(2));
        (drift, variance.sqrt())
    }

    /// The period of the worm, s, if one is believed in.
    pub(super) fn worm_period_s(&self) -> Option<f64> {
        let share = self.weighed(|filter| f64::from(u8::from(filter.assumption().period_s.is_some())));
        let best = self.filters.iter().filter(|(_, filter)| filter.assumption().period_s.is_some());
        let best = best.max_by(|(a, _), (b, _)| a.total_cmp(b)).and_then(|(_, filter)| filter.assumption().period_s);
        best.filter(|_| share > 0.5)
    }

    /// The place changed by an unknown way, up to `spread_px`; drift and worm go on.
    pub(super) fn forget_place(&mut self, spread_px: f64) {
        self.filters.iter_mut().for_each(|(_, filter)| filter.forget(spread_px, 0.0));
    }

    /// What was believed of place and drift was wrong: the axis is there now, px.
    pub(super) fn begin_anew(&mut self, place_px: f64) {
        self.filters.iter_mut().for_each(|(_, filter)| filter.begin_anew(place_px));
        (self.rejected, self.outlier_side) = (0, 0.0);
    }

    /// Mean over the filters by their likelihood; 0 before the first frame.
    fn weighed(&self, of: impl Fn(&Hypothesis) -> f64) -> f64 {
        let best = self.filters.iter().fold(f64::NEG_INFINITY, |best, (weight, _)| best.max(*weight));
        let (mut sum, mut all) = (0.0, 0.0);
        for (weight, filter) in &self.filters {
            // what is a million times less likely does not count
            if *weight > best - 14.0 {
                let share = (weight - best).exp();
                sum += share * of(filter);
                all += share;
            }
        }
        if all > 0.0 { sum / all } else { 0.0 }
    }
}

/// What is assumed, each with the logarithm of its a-priori weight.
fn assumptions(worm_period_s: Option<f64>) -> impl Iterator<Item = (f64, Assumption)> {
    let plain = JITTERS_PX.into_iter().flat_map(|jitter_px| {
        WALKS_PX.into_iter().flat_map(move |walk_px| {
            DRIFT_WALKS_PX_S
                .into_iter()
                .map(move |drift_walk_px_s| (0.0, Assumption { jitter_px, walk_px, drift_walk_px_s, period_s: None }))
        })
    });
    let steps = ((PERIODS_S.1 / PERIODS_S.0).ln() / PERIOD_STEP.ln()) as i32;
    let (periods, rare): (Vec<f64>, f64) = match worm_period_s {
        Some(known_s) => (AROUND_KNOWN.iter().map(|factor| factor * known_s).collect(), 0.0),
        None => ((0..=steps).map(|n| PERIODS_S.0 * PERIOD_STEP.powi(n)).collect(), WORM_IS_RARE),
    };
    let periodic = periods.into_iter().flat_map(move |period_s| {
        PERIODIC_JITTERS_PX.into_iter().flat_map(move |jitter_px| {
            PERIODIC_WALKS_PX.into_iter().map(move |walk_px| {
                let drift_walk_px_s = PERIODIC_DRIFT_WALK_PX_S;
                (rare, Assumption { jitter_px, walk_px, drift_walk_px_s, period_s: Some(period_s) })
            })
        })
    });
    plain.chain(periodic)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bank that saw a drift and a worm every `step_s`, and what it expects one step ahead, less the truth.
    fn after(frames: usize, step_s: f64, truth: impl Fn(f64) -> f64) -> (Bank, f64) {
        let mut bank = Bank::new(None);
        for n in 0..frames {
            let time_s = n as f64 * step_s;
            let noise = 0.03 * ((n * 7919 % 101) as f64 / 50.0 - 1.0);
            bank.learn(time_s, truth(time_s) + noise, 4e-4, true);
        }
        let off_px = bank.expected(step_s, 0.0).0 - truth(frames as f64 * step_s);
        (bank, off_px)
    }

    #[test]
    fn a_drift_is_foreseen_and_no_worm_is_made_up() {
        let (bank, off_px) = after(60, 30.0, |t| 3.0 - 0.05 * t);
        assert!(off_px.abs() < 0.05 && (bank.drift_px_s().0 + 0.05).abs() < 1e-3, "{off_px} {:?}", bank.drift_px_s());
        assert_eq!(bank.worm_period_s(), None);
    }

    #[test]
    fn a_worm_is_foreseen_and_its_period_found() {
        let (bank, off_px) = after(80, 30.0, |t| 0.01 * t + 8.0 * (std::f64::consts::TAU * t / 480.0).sin());
        let period_s = bank.worm_period_s().unwrap();
        assert!(off_px.abs() < 0.4 && (period_s / 480.0 - 1.0).abs() < 0.04, "{off_px} {period_s}");
    }

    #[test]
    fn one_outlier_is_left_out_and_two_to_a_side_are_believed() {
        let (mut bank, _) = after(60, 30.0, |_| 0.0);
        assert_eq!(bank.learn(1800.0, 5.0, 4e-4, true), Learned::Outlier);
        assert!(bank.expected(30.0, 0.0).0.abs() < 0.1);
        assert_eq!(bank.learn(1830.0, 5.0, 4e-4, true), Learned::Taken);
        assert!((bank.expected(0.0, 0.0).0 - 5.0).abs() < 0.5);
        assert_eq!(bank.learn(1830.0, 5.0, 4e-4, true), Learned::Unusable);
        assert_eq!(bank.learn(1900.0, f64::NAN, 4e-4, true), Learned::Unusable);
    }

    #[test]
    fn a_time_that_no_clock_shows_gives_a_place_all_the_same() {
        let (bank, _) = after(80, 30.0, |t| 0.01 * t + 8.0 * (std::f64::consts::TAU * t / 480.0).sin());
        let furthest = bank.expected(LONGEST_PAUSE_S, 0.0);
        for ahead_s in [1e300, f64::MAX, f64::INFINITY] {
            assert_eq!(bank.expected(ahead_s, 0.0), furthest);
            let back = bank.expected(-ahead_s, 0.0);
            assert!(back.0.is_finite() && back.1.is_finite(), "{back:?}");
        }
    }
}
