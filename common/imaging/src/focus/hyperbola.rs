//! The size of stars against the focuser's position: `y^2 = c^2 + a^2 (x - x0)^2`
//! (docs/formulae.md, "Size of stars against position").
//!
//! Far from focus the size grows linearly with the defocus, near it seeing rounds the V off; the two meet about
//! c/a from focus, which is called the critical zone here.
//!
//! Tilted or pinched optics have another slope on either side of focus: `a (1 - k)` below it and `a (1 + k)` above. A
//! curve with one slope puts the focus next to it then, and one with two knows it less well. Both are fitted,
//! and each counts as far as the points demand it (Bayesian averaging; an asymmetry of 0.15 is usual where there is
//! one). So the error grows where the points leave open which of them is true.
//!
//! First the parabola of y^2 that most points agree with is searched among those through three points each, so that
//! clouds and gusts cannot choose the start; then the hyperbola is fitted with Huber's loss, weighed with the errors;
//! then once more without what lies 4 sigma off.

use super::least_squares::{self, Minimum};

/// Size of stars at one position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Position of the focuser, steps.
    pub position: f64,
    /// Size of the stars (HFD, FWHM), px or any other unit; greater than zero.
    pub size: f64,
    /// Its standard error, same unit.
    pub error: f64,
}

/// A fitted hyperbola.
#[derive(Debug, Clone, PartialEq)]
pub struct Hyperbola {
    /// Position of the best focus x0, steps.
    pub best_position: f64,
    /// Standard error of `best_position`, steps, from the covariance; the scatter about the curve counts where it is
    /// greater than the errors of the points.
    pub best_position_error: f64,
    /// Size in focus c, in the unit of the points.
    pub least_size: f64,
    /// Slope far from focus a, unit of the points per step.
    pub slope: f64,
    /// By which share the slope is greater above the best position, and smaller below; 0 unless the points show it.
    pub asymmetry: f64,
    /// Points in the order given: whether each was used. Those without finite, positive numbers, and those far off
    /// the curve, are not.
    pub used: Vec<bool>,
}

/// Why no hyperbola goes through the points.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoHyperbola {
    /// Fewer than 4 usable points, or fewer than 4 different positions.
    #[error(
        "the stars have a size at {positions} different positions of the focuser, in {points} frames; {FEWEST} positions \
         are needed: take more frames, from one side of the focus to the other"
    )]
    TooFew {
        /// Points with finite, positive numbers.
        points: usize,
        /// Different positions among them.
        positions: usize,
    },
    /// The size does not fall towards a minimum anywhere.
    #[error("the sizes do not fall towards a minimum: the curve is flat or bends down")]
    NoMinimum,
}

const FEWEST: usize = 4;
/// Seeing changes from frame to frame: no size stands for its position better than to this share.
const SEEING: f64 = 0.02;
/// Residuals beyond this many sigma count linearly: 95 % efficient for Gaussian noise (Huber 1981).
const HUBER: f64 = 1.345;
/// Residuals beyond this many sigma do not count at all.
const FAR: f64 = 4.0;
/// Triples of points that are tried at most, so that long runs stay quick.
const TRIPLES: usize = 5000;
/// A start's least size, as a share of the smallest one measured.
const SHARPEST: f64 = 0.02;
/// How much slopes differ from their mean where they differ at all: standard deviations of the asymmetry, for a curve with
/// one slope and for one with two.
const ONE_SLOPE: f64 = 1e-5;
const TWO_SLOPES: f64 = 0.15;
/// Odds of two slopes before any point is seen: for the place few, so that points on one curve are not spread over two; for
/// its error many, so that what the points do not exclude is allowed for. Tried on drawn runs (tests).
const ODDS_OF_TWO: (f64, f64) = (0.2, 3.0);
const GREATEST_ASYMMETRY: f64 = 0.6;

impl Hyperbola {
    /// Size at a position, in the unit of the points.
    pub fn size_at(&self, position: f64) -> f64 {
        let off = position - self.best_position;
        self.least_size.hypot(self.slope * (1.0 + self.asymmetry * off.signum()) * off)
    }

    /// Half width of the bottom c/a, steps: so far from focus the size is 1.41 of the least.
    pub fn critical_zone(&self) -> f64 {
        self.least_size / self.slope
    }

    /// Fits the points, which come in any order.
    ///
    /// # Errors
    /// [`NoHyperbola`] when the points have no curve with a minimum. Where the minimum lies is for the caller to judge:
    /// it may be outside of the run.
    pub fn fit(points: &[Size]) -> Result<Self, NoHyperbola> {
        let scaled = Scaled::of(points)?;
        let [x0, c, a] = scaled.start().ok_or(NoHyperbola::NoMinimum)?;
        let start = [x0, c, a, 0.0];
        let curves = |used: &[bool], inflation: f64| {
            let fit = |asymmetry| scaled.refine(start, used, inflation, asymmetry);
            [fit(ONE_SLOPE), fit(TWO_SLOPES)].map(|fit| fit.filter(|fit| fit.covariance.is_some()))
        };
        let near = curves(&scaled.all(), 1.0).into_iter().flatten().map(|first| scaled.near(first.at));
        // a point far from the one curve may lie on the other
        let count = |used: &[bool]| used.iter().filter(|n| **n).count();
        let used = near.reduce(|one, two| if count(&two) > count(&one) { two } else { one });
        let used = used.filter(|used| count(used) >= FEWEST).unwrap_or(scaled.all());
        let scatters =
            curves(&used, 1.0).into_iter().flatten().map(|fit| scaled.scatter(&scaled.residuals(fit.at), &used));
        let inflation = scatters.reduce(f64::min).ok_or(NoHyperbola::NoMinimum)?;
        let [one, two] = curves(&used, inflation);
        scaled.unscaled(points, &Mixture::of(one, two).ok_or(NoHyperbola::NoMinimum)?, &used)
    }
}

/// What the curves with one slope and with two say together.
struct Mixture {
    x0: f64,
    variance: f64,
    /// The more probable one.
    at: [f64; 4],
}

impl Mixture {
    fn of(one: Option<Minimum<4>>, two: Option<Minimum<4>>) -> Option<Self> {
        let part = |fit: Option<Minimum<4>>, asymmetry: f64| {
            let fit = fit?;
            let covariance = fit.covariance?;
            let [x0, c, a, k] = fit.at;
            let k = if asymmetry == ONE_SLOPE { 0.0 } else { k };
            // Laplace's integral over all parameters
            Some(([x0, c, a, k], covariance[(0, 0)], 0.5 * covariance.determinant().ln() - fit.cost - asymmetry.ln()))
        };
        let parts = [part(one, ONE_SLOPE), part(two, TWO_SLOPES)];
        let parts: Vec<_> = parts.into_iter().flatten().filter(|part| part.2.is_finite()).collect();
        let best = parts.iter().copied().reduce(|a, b| if b.2 > a.2 { b } else { a })?;
        // `odds` of two slopes before any point is seen
        let mean = |odds: f64, of: &dyn Fn(&Part) -> f64| {
            let weight = |part: &Part| if part.0[3] == 0.0 { 1.0 } else { odds } * (part.2 - best.2).exp();
            let weights: f64 = parts.iter().map(weight).sum();
            parts.iter().map(|part| weight(part) * of(part)).sum::<f64>() / weights
        };
        let x0 = mean(ODDS_OF_TWO.0, &|part| part.0[0]);
        Some(Self { x0, variance: mean(ODDS_OF_TWO.1, &|part| part.1 + (part.0[0] - x0).powi(2)), at: best.0 })
    }
}

/// Of one curve: its parameters, the variance of the focus, and the logarithm of its evidence.
type Part = ([f64; 4], f64, f64);

/// The usable points, with positions and sizes brought to the order of 1.
struct Scaled {
    /// Position, size, error.
    points: Vec<(f64, f64, f64)>,
    /// Number of each in what was given.
    number: Vec<usize>,
    middle: f64,
    half: f64,
    unit: f64,
}

impl Scaled {
    fn of(points: &[Size]) -> Result<Self, NoHyperbola> {
        let usable = |p: &Size| p.position.is_finite() && p.size.is_finite() && p.size > 0.0;
        let number: Vec<usize> = (0..points.len()).filter(|n| usable(&points[*n])).collect();
        let mut positions: Vec<f64> = number.iter().map(|n| points[*n].position).collect();
        positions.sort_by(f64::total_cmp);
        positions.dedup();
        if number.len() < FEWEST || positions.len() < FEWEST {
            return Err(NoHyperbola::TooFew { points: number.len(), positions: positions.len() });
        }
        let (low, high) = (positions[0], positions[positions.len() - 1]);
        let unit = number.iter().map(|n| points[*n].size).fold(f64::INFINITY, f64::min);
        let (middle, half) = (0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low);
        let scaled = |n: &usize| {
            let p = &points[*n];
            let error = if p.error.is_finite() { p.error.abs() } else { p.size };
            ((p.position - middle) / half, p.size / unit, error.hypot(SEEING * p.size) / unit)
        };
        Ok(Self { points: number.iter().map(scaled).collect(), number, middle, half, unit })
    }

    fn all(&self) -> Vec<bool> {
        vec![true; self.points.len()]
    }

    /// The (x0, c, a) that most points agree with.
    fn start(&self) -> Option<[f64; 3]> {
        let count = self.points.len();
        let triples = count * (count - 1) * (count - 2) / 6;
        let every = triples.div_ceil(TRIPLES).max(1);
        let all = (0..count).flat_map(|i| (i + 1..count).flat_map(move |j| (j + 1..count).map(move |k| [i, j, k])));
        let parabolas = all.step_by(every).filter_map(|triple| self.through(triple)).chain(self.plain_parabola());
        let rated = parabolas.map(|start| (self.disagreement(start), start));
        rated.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start)
    }

    /// Sum over the points of squared residuals, each at most 9 sigma^2.
    fn disagreement(&self, [x0, c, a]: [f64; 3]) -> f64 {
        let square = |(x, y, error): &(f64, f64, f64)| ((c.hypot(a * (x - x0)) - y) / error).powi(2).min(9.0);
        self.points.iter().map(square).sum()
    }

    /// The parabola of y^2 through three points.
    fn through(&self, triple: [usize; 3]) -> Option<[f64; 3]> {
        let [(x1, y1, _), (x2, y2, _), (x3, y3, _)] = triple.map(|n| self.points[n]);
        let (s1, s2, s3) = (y1 * y1, y2 * y2, y3 * y3);
        let (d12, d13) = ((s2 - s1) / (x2 - x1), (s3 - s1) / (x3 - x1));
        let bend = (d13 - d12) / (x3 - x2);
        let slope = d12 - bend * (x1 + x2);
        vertex(s1 - x1 * (slope + bend * x1), slope, bend)
    }

    /// The parabola of y^2 by linear least squares; a size of relative error e has a square of error 2 e y^2.
    fn plain_parabola(&self) -> Option<[f64; 3]> {
        let fit = least_squares::minimise([1.0, 0.0, 1.0], [(f64::NEG_INFINITY, f64::INFINITY); 3], |p, sums| {
            for (x, y, error) in &self.points {
                let error = 2.0 * error * y;
                let model = p[0] + x * (p[1] + p[2] * x);
                sums.add((model - y * y) / error, [1.0 / error, x / error, x * x / error], f64::INFINITY);
            }
        })?;
        vertex(fit.at[0], fit.at[1], fit.at[2])
    }

    /// Fits (x0, c, a, k) to the points in use, their errors inflated; `asymmetry` is how great k usually is.
    fn refine(&self, start: [f64; 4], used: &[bool], inflation: f64, asymmetry: f64) -> Option<Minimum<4>> {
        // beyond ten half widths of the run a minimum is not worth looking for
        let most = GREATEST_ASYMMETRY;
        let bounds = [(-11.0, 11.0), (0.1 * SHARPEST, f64::INFINITY), (1e-6, f64::INFINITY), (-most, most)];
        least_squares::minimise(start, bounds, |[x0, c, a, k], sums| {
            sums.add(k / asymmetry, [0.0, 0.0, 0.0, 1.0 / asymmetry], f64::INFINITY);
            for (x, y, error) in self.points.iter().zip(used).filter(|(_, used)| **used).map(|(point, _)| point) {
                let (dx, error) = (x - x0, error * inflation);
                let side = 1.0 + k * dx.signum();
                let slope = a * side;
                let model = c.hypot(slope * dx);
                let (along, square) = (slope * slope * dx / model, slope * dx * dx / model);
                let derivatives = [-along, c / model, square * side, square * a * dx.signum()];
                sums.add((model - y) / error, derivatives.map(|d| d / error), HUBER);
            }
        })
    }

    fn residuals(&self, [x0, c, a, k]: [f64; 4]) -> Vec<f64> {
        let model = |x: f64| c.hypot(a * (1.0 + k * (x - x0).signum()) * (x - x0));
        self.points.iter().map(|(x, y, error)| (model(*x) - y) / error).collect()
    }

    /// Which points lie within 4 sigma, sigma being the greater of their errors and of their scatter.
    fn near(&self, at: [f64; 4]) -> Vec<bool> {
        let residuals = self.residuals(at);
        let limit = FAR * self.scatter(&residuals, &self.all());
        residuals.iter().map(|residual| residual.abs() <= limit).collect()
    }

    /// Scatter of the residuals in units of their errors, from the median so that outliers do not enter; at least 1.
    fn scatter(&self, residuals: &[f64], used: &[bool]) -> f64 {
        let sizes: Vec<f64> = residuals.iter().zip(used).filter(|(_, used)| **used).map(|(r, _)| r.abs()).collect();
        let count = sizes.len() as f64;
        // three parameters have taken their share
        let share = (count / (count - 3.0).max(1.0)).sqrt();
        (1.4826 * share * super::median(sizes).unwrap_or(0.0)).max(1.0)
    }

    fn unscaled(&self, points: &[Size], fit: &Mixture, used: &[bool]) -> Result<Hyperbola, NoHyperbola> {
        let (x0, [_, c, a, k]) = (fit.x0, fit.at);
        let error = fit.variance.sqrt() * self.half;
        // a slope that no point shows is none
        let steepest = self.points.iter().map(|(x, ..)| (a * (x - x0)).abs() / c).fold(0.0, f64::max);
        let (least_size, slope) = (c * self.unit, a * self.unit / self.half);
        // numbers of the size of 1e-300 may end as zero
        let is_real = error.is_finite() && least_size > 0.0 && slope > 0.0;
        if !is_real || x0.abs() > 10.0 || steepest < SEEING {
            return Err(NoHyperbola::NoMinimum);
        }
        let mut used_of_all = vec![false; points.len()];
        self.number.iter().zip(used).for_each(|(number, used)| used_of_all[*number] = *used);
        Ok(Hyperbola {
            best_position: self.middle + self.half * x0,
            best_position_error: error,
            least_size,
            slope,
            asymmetry: k,
            used: used_of_all,
        })
    }
}

/// (x0, c, a) of `y^2 = level + slope x + bend x^2`; a minimum at or below zero is a very sharp V.
fn vertex(level: f64, slope: f64, bend: f64) -> Option<[f64; 3]> {
    let x0 = -slope / (2.0 * bend);
    let least = (level - 0.25 * slope * slope / bend).max(SHARPEST * SHARPEST);
    (bend > 0.0 && x0.abs() <= 10.0 && least.is_finite()).then(|| [x0, least.sqrt(), bend.sqrt()])
}

#[cfg(test)]
mod tests;
