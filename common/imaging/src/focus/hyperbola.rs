//! The size of stars against the focuser's position: `y^2 = c^2 + a^2 (x - x0)^2` (algorithms.md 6.5).
//!
//! Far from focus the size grows linearly with the defocus, near it seeing rounds the V off; the two meet about
//! c/a from focus, which is called the critical zone here.
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
    /// Points in the order given: whether each was used. Those without finite, positive numbers, and those far off
    /// the curve, are not.
    pub used: Vec<bool>,
}

/// Why no hyperbola goes through the points.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoHyperbola {
    /// Fewer than 4 usable points, or fewer than 4 different positions.
    #[error("{points} usable points at {positions} different positions, {FEWEST} of either are needed")]
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

impl Hyperbola {
    /// Size at a position, in the unit of the points.
    pub fn size_at(&self, position: f64) -> f64 {
        self.least_size.hypot(self.slope * (position - self.best_position))
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
        let start = scaled.start().ok_or(NoHyperbola::NoMinimum)?;
        let first = scaled.refine(start, &scaled.all()).ok_or(NoHyperbola::NoMinimum)?;
        let near = scaled.near(first.at);
        let enough = near.iter().filter(|n| **n).count() >= FEWEST;
        let (fit, used) = match scaled.refine(first.at, &near).filter(|_| enough) {
            Some(fit) => (fit, near),
            None => (first, scaled.all()),
        };
        scaled.unscaled(points, &fit, &used)
    }
}

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

    /// Fits (x0, c, a) to the points in use.
    fn refine(&self, start: [f64; 3], used: &[bool]) -> Option<Minimum<3>> {
        // beyond ten half widths of the run a minimum is not worth looking for
        let bounds = [(-11.0, 11.0), (0.1 * SHARPEST, f64::INFINITY), (1e-6, f64::INFINITY)];
        least_squares::minimise(start, bounds, |[x0, c, a], sums| {
            for (x, y, error) in self.points.iter().zip(used).filter(|(_, used)| **used).map(|(point, _)| point) {
                let dx = x - x0;
                let model = c.hypot(a * dx);
                let derivatives = [-a * a * dx / model, c / model, a * dx * dx / model];
                sums.add((model - y) / error, derivatives.map(|d| d / error), HUBER);
            }
        })
    }

    fn residuals(&self, [x0, c, a]: [f64; 3]) -> Vec<f64> {
        self.points.iter().map(|(x, y, error)| (c.hypot(a * (x - x0)) - y) / error).collect()
    }

    /// Which points lie within 4 sigma, sigma being the greater of their errors and of their scatter.
    fn near(&self, at: [f64; 3]) -> Vec<bool> {
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

    fn unscaled(&self, points: &[Size], fit: &Minimum<3>, used: &[bool]) -> Result<Hyperbola, NoHyperbola> {
        let [x0, c, a] = fit.at;
        let variance = fit.covariance.map_or(f64::NAN, |covariance| covariance[(0, 0)]);
        let error = variance.sqrt() * self.scatter(&self.residuals(fit.at), used) * self.half;
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
