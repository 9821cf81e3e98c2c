//! What of a star's way is the pulses', what the mount's drift, and what the gear swallowed.
//!
//! ```text
//! place = start of the axis + drift of the axis * time + speed * (pulses so far - what was lost in the gear)
//! ```
//! Both axes go out and come back, so pulses and time do not run together and can be distinguished. It is fitted by
//! least squares with Huber's loss (1964), so that one gust does not spoil it; the play by searching for its best
//! value.

use crate::least_squares::LeastSquares;

/// A frame of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CalibrationFrame {
    /// Middle of the exposure, s.
    pub(super) mid_s: f64,
    /// Pulses on this axis since its first step, s; East and North positive.
    pub(super) pulse_s: f64,
    /// The star (x, y).
    pub(super) place_px: [f64; 2],
}

/// An axis' steps out and back.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Way {
    pub(super) out: Vec<CalibrationFrame>,
    /// Begins with the last step out.
    pub(super) back: Vec<CalibrationFrame>,
}

impl Way {
    /// The pulses (s, signed) that moved the star, for each step, the way back having lost `play_s`.
    fn steps(&self, play_s: f64) -> impl Iterator<Item = (CalibrationFrame, f64)> {
        let far_s = self.back.first().map_or(0.0, |step| step.pulse_s);
        let back = self.back.iter().skip(1).map(move |step| {
            let way_s = step.pulse_s - far_s;
            (*step, far_s + way_s.signum() * (way_s.abs() - play_s).max(0.0))
        });
        self.out.iter().map(|step| (*step, step.pulse_s)).chain(back)
    }

    /// Pulses on the way back, s.
    pub(super) fn back_s(&self) -> f64 {
        self.back.first().zip(self.back.last()).map_or(0.0, |(from, to)| (to.pulse_s - from.pulse_s).abs())
    }

    fn fewest_pulses(&self) -> usize {
        self.out.len().min(self.back.len()).saturating_sub(1)
    }
}

/// What moves a star.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StarMotion {
    /// By East and by North pulses (x, y), px/s; North is zero while Dec was not pushed.
    pub(super) speeds_px_s: [[f64; 2]; 2],
    /// By itself, while right ascension and while declination were pushed, px/s.
    pub(super) drifts_px_s: [[f64; 2]; 2],
    /// Lost when Dec turned round, s; zero where that explains nothing.
    pub(super) play_s: f64,
}

/// Residuals beyond this many standard errors count less and less (Huber 1964; 95 % efficient for a Gaussian).
const HUBER: f64 = 1.345;
/// Rounds of weighing; a residual's weight has settled by then.
const ROUNDS: usize = 12;
/// Places are not better than this, px: the seeing alone moves a field by as much.
const LEAST_PX: f64 = 0.02;
/// An axis' drift is fitted on its own from this many pulses each way on; else there is one for both. A right ascension
/// that sticks looks as if it drifted: one drift for both would tilt declination and hide it. A true drift and a worm are
/// taken off as well in either way.
const OWN_DRIFT_PULSES: usize = 4;
/// Places on which the play is sought, per pulse.
const PLACES_PER_PULSE: usize = 4;
/// Times that the range between two such places is cut by a third, to a thousandth of it.
const CUTS: usize = 17;
/// Play is believed when it lowers the sum of squares by this many variances: three standard errors.
const BELIEVED: f64 = 9.0;
/// Weight of equations that fix what no step shows; against weights of 1, on unknowns that are scaled.
const FIXED: f64 = 1e6;

/// Start and drift of either axis, then the speeds by East and by North pulses.
const UNKNOWNS: usize = 6;

/// The steps, and the scales on which the unknowns are of similar size.
struct MotionModel<'a> {
    ra: &'a Way,
    dec: &'a Way,
    from_s: f64,
    length_s: f64,
    pulse_s: f64,
}

/// Unknowns of x and y, and for each step how far off it is, px.
type Solved = ([[f64; UNKNOWNS]; 2], Vec<[f64; 2]>);

/// Speeds, drifts and play; None when the steps do not fix them. `dec` may be empty.
pub(super) fn motion(ra: &Way, dec: &Way) -> Option<StarMotion> {
    let all = || ra.steps(0.0).chain(dec.steps(0.0)).map(|(step, _)| step);
    let from_s = all().map(|step| step.mid_s).fold(f64::INFINITY, f64::min);
    let length_s = all().map(|step| step.mid_s - from_s).fold(0.0, f64::max);
    let pulse_s = all().map(|step| step.pulse_s.abs()).fold(0.0, f64::max);
    if !(length_s > 0.0 && length_s.is_finite() && pulse_s > 0.0) {
        return None;
    }
    let model = MotionModel { ra, dec, from_s, length_s, pulse_s };
    let mut weights = vec![1.0; all().count()];
    let (mut play_s, mut scale_px) = (0.0, LEAST_PX);
    for _ in 0..ROUNDS {
        play_s = model.best_play_s(&weights)?;
        let (_, residuals) = model.solve(play_s, &weights)?;
        scale_px = spread_px(&residuals);
        for (weight, [x, y]) in weights.iter_mut().zip(&residuals) {
            let pull = x.hypot(*y) / scale_px;
            *weight = if pull > HUBER { HUBER / pull } else { 1.0 };
        }
    }
    let explained = model.squares(0.0, &weights) - model.squares(play_s, &weights);
    let play_s = if explained > BELIEVED * scale_px.powi(2) { play_s } else { 0.0 };
    let (unknowns, _) = model.solve(play_s, &weights)?;
    let of = |index: usize, unit: f64| unknowns.map(|of_axis| of_axis[index] / unit);
    Some(StarMotion {
        speeds_px_s: [of(4, pulse_s), of(5, pulse_s)],
        drifts_px_s: [of(2, length_s), of(3, length_s)],
        play_s,
    })
}

impl MotionModel<'_> {
    fn rows(&self, play_s: f64) -> impl Iterator<Item = ([f64; UNKNOWNS], [f64; 2])> {
        let time = |step: &CalibrationFrame| (step.mid_s - self.from_s) / self.length_s;
        let ra = self
            .ra
            .steps(0.0)
            .map(move |(step, moved_s)| ([1.0, 0.0, time(&step), 0.0, moved_s / self.pulse_s, 0.0], step.place_px));
        let dec = self
            .dec
            .steps(play_s)
            .map(move |(step, moved_s)| ([0.0, 1.0, 0.0, time(&step), 0.0, moved_s / self.pulse_s], step.place_px));
        ra.chain(dec)
    }

    fn solve(&self, play_s: f64, weights: &[f64]) -> Option<Solved> {
        let mut sums = [LeastSquares::<UNKNOWNS>::new(), LeastSquares::new()];
        for ((row, place_px), weight) in self.rows(play_s).zip(weights) {
            sums.iter_mut().zip(place_px).for_each(|(sums, place_px)| sums.add(row, place_px, *weight));
        }
        for sums in &mut sums {
            if self.ra.fewest_pulses().min(self.dec.fewest_pulses()) < OWN_DRIFT_PULSES {
                sums.add([0.0, 0.0, 1.0, -1.0, 0.0, 0.0], 0.0, FIXED);
            }
            if self.dec.out.is_empty() {
                sums.add([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 0.0, FIXED);
                sums.add([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 0.0, FIXED);
            }
        }
        let unknowns = [sums[0].solve()?, sums[1].solve()?];
        let model_px = |row: &[f64; UNKNOWNS], n: usize| row.iter().zip(&unknowns[n]).map(|(a, b)| a * b).sum::<f64>();
        let residuals =
            self.rows(play_s).map(|(row, place_px)| [0, 1].map(|n| place_px[n] - model_px(&row, n))).collect();
        Some((unknowns, residuals))
    }

    /// Weighted sum of the squares that are left, px^2.
    fn squares(&self, play_s: f64, weights: &[f64]) -> f64 {
        self.solve(play_s, weights).map_or(f64::INFINITY, |(_, residuals)| {
            residuals.iter().zip(weights).map(|([x, y], weight)| weight * (x * x + y * y)).sum()
        })
    }

    /// The play that leaves least: the best of a grid, then between its neighbours. None when nothing can be fitted.
    fn best_play_s(&self, weights: &[f64]) -> Option<f64> {
        let most_s = self.dec.back_s();
        let places = PLACES_PER_PULSE * self.dec.back.len().saturating_sub(1);
        let play_s = |place: usize| if places == 0 { 0.0 } else { most_s * place as f64 / places as f64 };
        let left = (0..=places).map(|place| (place, self.squares(play_s(place), weights)));
        let (best, least) = left.min_by(|a, b| a.1.total_cmp(&b.1))?;
        if !least.is_finite() {
            return None;
        }
        let (mut low_s, mut high_s) = (play_s(best.saturating_sub(1)), play_s((best + 1).min(places)));
        for _ in 0..CUTS {
            let (a_s, b_s) = (low_s + (high_s - low_s) / 3.0, high_s - (high_s - low_s) / 3.0);
            if self.squares(a_s, weights) <= self.squares(b_s, weights) {
                high_s = b_s;
            } else {
                low_s = a_s;
            }
        }
        Some(0.5 * (low_s + high_s))
    }
}

/// Standard error of a place along x or y, from the median so that gusts do not enter, px.
fn spread_px(residuals: &[[f64; 2]]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().flatten().map(|residual| residual.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median_px = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    // unknowns swallow their part of the scatter
    let free = residuals.len().saturating_sub(UNKNOWNS).max(1) as f64;
    (1.4826 * median_px * (residuals.len() as f64 / free).sqrt()).max(LEAST_PX)
}
