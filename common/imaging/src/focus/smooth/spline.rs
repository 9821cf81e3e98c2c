//! The quadratic smoothing spline of Dierckx ("Curve and Surface Fitting with Splines", 1993, chapter 5; scipy's
//! `UnivariateSpline` draws the same): as few knots as the data ask for, then the smoothest curve on them whose
//! squared residuals add up to the number of points. The sum has the units of the measure, so the curve depends on
//! them; that is how the predecessor did it.

use nalgebra::{DMatrix, DVector};

/// Degree of the pieces.
const DEGREE: usize = 2;
/// The sum of squares is met to this share.
const CLOSE: f64 = 1e-3;
/// Trials to meet it.
const TRIALS: usize = 20;

/// At 100 evenly spaced positions. `points` are in order of position.
pub(super) fn curve(points: &[(f64, f64)]) -> Option<Vec<(f64, f64)>> {
    let data = Data::merged(points);
    let spline = data.smooth(points.len() as f64)?;
    Some(super::samples(points).map(|x| (x, spline.value(x))).collect())
}

/// Points at increasing positions, several at one position having become their mean.
struct Data {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Square root of the number of points.
    weight: Vec<f64>,
}

struct Spline {
    /// With the ends `DEGREE + 1` times.
    knots: Vec<f64>,
    coefficients: DVector<f64>,
}

/// A fit on given knots.
struct SplineFit {
    spline: Spline,
    /// Squared weighted residual of each point, and their sum.
    squares: Vec<f64>,
    sum: f64,
    /// Trace of the triangular factor.
    trace: f64,
}

impl Data {
    fn merged(points: &[(f64, f64)]) -> Self {
        let mut data = Self { x: Vec::new(), y: Vec::new(), weight: Vec::new() };
        for group in points.chunk_by(|a, b| a.0 == b.0) {
            let count = group.len() as f64;
            data.x.push(group[0].0);
            data.y.push(group.iter().map(|(_, y)| y).sum::<f64>() / count);
            data.weight.push(count.sqrt());
        }
        data
    }

    /// The smoothest curve with this sum of squares.
    fn smooth(&self, sum: f64) -> Option<Spline> {
        let most = self.x.len().checked_sub(DEGREE + 1)?;
        let mut sections = Sections::whole(self.x.len());
        let (mut adding, mut before) = (1, None);
        let parabola = self.fit(&[], None)?;
        let first_excess = parabola.sum - sum;
        let mut fit = parabola;
        let mut knots: Vec<f64> = Vec::new();
        loop {
            let excess = fit.sum - sum;
            if !excess.is_finite() {
                return None;
            }
            // an exact parabola leaves nothing over
            if excess.abs() < CLOSE * sum || (excess < 0.0 && knots.is_empty()) || (excess > 0.0 && knots.len() == most)
            {
                return Some(fit.spline);
            }
            if excess < 0.0 {
                return self.on_knots(&knots, sum, first_excess, fit);
            }
            if let Some(before) = before {
                let gained: f64 = before - fit.sum;
                let wanted = if gained > CLOSE * sum { (adding as f64 * excess / gained) as usize } else { 2 * adding };
                adding = (2 * adding).min(wanted.max(adding / 2).max(1));
            }
            before = Some(fit.sum);
            sections.share(&fit.squares);
            for _ in 0..adding {
                if knots.len() + 1 >= most || !sections.split() {
                    knots = self.interpolating_knots();
                    break;
                }
                knots = sections.knots(&self.x);
            }
            fit = self.fit(&knots, None)?;
        }
    }

    /// The knots of the curve through all points: half-way between them.
    fn interpolating_knots(&self) -> Vec<f64> {
        let middles: Vec<f64> = self.x.windows(2).map(|two| 0.5 * (two[0] + two[1])).collect();
        middles[1..middles.len() - 1].to_vec()
    }

    /// Finds the stiffness that gives the sum of squares, between a parabola (excess `first`) and the free fit.
    fn on_knots(&self, knots: &[f64], sum: f64, first: f64, free: SplineFit) -> Option<Spline> {
        let coefficients = free.spline.coefficients.len();
        let (mut low, mut high) = ((0.0, first), (f64::INFINITY, free.sum - sum));
        let mut softness = coefficients as f64 / free.trace;
        let (mut low_is_sure, mut high_is_sure) = (false, false);
        let mut last = free.spline;
        for _ in 0..TRIALS {
            let fit = self.fit(knots, Some(softness))?;
            let here = (softness, fit.sum - sum);
            last = fit.spline;
            if here.1.abs() < CLOSE * sum {
                break;
            }
            if !high_is_sure {
                if here.1 - high.1 > CLOSE * sum {
                    high_is_sure = here.1 < 0.0;
                } else {
                    // too soft to differ from the free fit
                    high = here;
                    softness *= 0.04;
                    if softness <= low.0 {
                        softness = 0.9 * low.0 + 0.1 * here.0;
                    }
                    continue;
                }
            }
            if !low_is_sure {
                if low.1 - here.1 > CLOSE * sum {
                    low_is_sure = here.1 > 0.0;
                } else {
                    // too stiff to differ from the parabola
                    low = here;
                    softness /= 0.04;
                    if softness >= high.0 {
                        softness = 0.1 * here.0 + 0.9 * high.0;
                    }
                    continue;
                }
            }
            if here.1 >= low.1 || here.1 <= high.1 {
                break;
            }
            softness = between(low, here, high);
            if here.1 < 0.0 {
                high = here;
            } else {
                low = here;
            }
        }
        Some(last)
    }

    /// Least squares on knots, with the jumps of the second derivative kept down unless the curve is free.
    fn fit(&self, interior: &[f64], softness: Option<f64>) -> Option<SplineFit> {
        let (first, last) = (*self.x.first()?, *self.x.last()?);
        let ends = |at: f64| std::iter::repeat_n(at, DEGREE + 1);
        let knots: Vec<f64> = ends(first).chain(interior.iter().copied()).chain(ends(last)).collect();
        let (points, columns) = (self.x.len(), interior.len() + DEGREE + 1);
        let stiff = softness.map_or(0, |_| interior.len());
        let mut matrix = DMatrix::zeros(points + stiff, columns);
        for (row, (x, weight)) in self.x.iter().zip(&self.weight).enumerate() {
            let (start, values) = basis(&knots, *x);
            values.iter().enumerate().for_each(|(n, value)| matrix[(row, start + n)] = weight * value);
        }
        if let Some(softness) = softness {
            for row in 0..stiff {
                let jumps = jumps(&knots, row);
                jumps.iter().enumerate().for_each(|(n, jump)| matrix[(points + row, row + n)] = jump / softness);
            }
        }
        let mut right = DVector::zeros(points + stiff);
        (0..points).for_each(|n| right[n] = self.weight[n] * self.y[n]);
        let factors = matrix.qr();
        factors.q_tr_mul(&mut right);
        let triangle = factors.r();
        let coefficients = triangle.solve_upper_triangular(&right.rows(0, columns).into_owned())?;
        let spline = Spline { knots, coefficients };
        let square = |n: usize| (self.weight[n] * (spline.value(self.x[n]) - self.y[n])).powi(2);
        let squares: Vec<f64> = (0..points).map(square).collect();
        let (sum, trace) = (squares.iter().sum(), triangle.diagonal().iter().map(|value: &f64| value.abs()).sum());
        Some(SplineFit { spline, squares, sum, trace })
    }
}

/// Where a curve (c + d p) / (e + p) through three (p, excess) vanishes; the last one may lie at infinity.
fn between(low: (f64, f64), here: (f64, f64), high: (f64, f64)) -> f64 {
    let ((p1, f1), (p2, f2), (p3, f3)) = (low, here, high);
    if p3.is_infinite() {
        return (p1 * (f1 - f3) * f2 - p2 * (f2 - f3) * f1) / ((f1 - f2) * f3);
    }
    let (h1, h2, h3) = (f1 * (f2 - f3), f2 * (f3 - f1), f3 * (f1 - f2));
    -(p1 * p2 * h3 + p2 * p3 * h1 + p3 * p1 * h2) / (p1 * h1 + p2 * h2 + p3 * h3)
}

impl Spline {
    fn value(&self, x: f64) -> f64 {
        let (start, values) = basis(&self.knots, x);
        values.iter().enumerate().map(|(n, value)| value * self.coefficients[start + n]).sum()
    }
}

/// The pieces between knots, each with the points inside of it.
struct Sections {
    /// Points strictly inside.
    inside: Vec<usize>,
    misfit: Vec<f64>,
}

impl Sections {
    fn whole(points: usize) -> Self {
        Self { inside: vec![points.saturating_sub(2)], misfit: vec![0.0] }
    }

    /// Adds up the squares of each section; a point on a knot counts half for either side.
    fn share(&mut self, squares: &[f64]) {
        let mut first = 0;
        for (inside, misfit) in self.inside.iter().zip(&mut self.misfit) {
            let end = first + inside + 1;
            let inner: f64 = squares[first + 1..end].iter().sum();
            let share = |at: usize| if at == 0 || at == squares.len() - 1 { squares[at] } else { 0.5 * squares[at] };
            *misfit = share(first) + inner + share(end);
            first = end;
        }
    }

    /// Puts a knot on the middle point of the section that fits worst; false when no section can be parted.
    fn split(&mut self) -> bool {
        let mut worst: Option<usize> = None;
        for n in 0..self.inside.len() {
            if self.inside[n] > 0 && self.misfit[n] > worst.map_or(0.0, |worst| self.misfit[worst]) {
                worst = Some(n);
            }
        }
        let Some(worst) = worst else { return false };
        let (points, misfit) = (self.inside[worst], self.misfit[worst]);
        let left = points / 2;
        let right = points - left - 1;
        self.inside.splice(worst..=worst, [left, right]);
        let share = |part: usize| misfit * part as f64 / points as f64;
        self.misfit.splice(worst..=worst, [share(left), share(right)]);
        true
    }

    fn knots(&self, x: &[f64]) -> Vec<f64> {
        let ends = self.inside.iter().scan(0, |at, inside| {
            *at += inside + 1;
            Some(x[*at])
        });
        ends.take(self.inside.len() - 1).collect()
    }
}

/// The three B-splines that do not vanish at `x`, and the number of the first.
fn basis(knots: &[f64], x: f64) -> (usize, [f64; DEGREE + 1]) {
    let last = knots.len() - DEGREE - 2;
    let at = (DEGREE..=last).rev().find(|n| knots[*n] <= x).unwrap_or(DEGREE);
    let mut values = [1.0, 0.0, 0.0];
    for degree in 1..=DEGREE {
        let mut carried = 0.0;
        for n in 0..degree {
            let (left, right) = (knots[at + n + 1 - degree], knots[at + n + 1]);
            let share = values[n] / (right - left);
            values[n] = carried + (right - x) * share;
            carried = (x - left) * share;
        }
        values[degree] = carried;
    }
    (at - DEGREE, values)
}

/// Jumps of the second derivative of the B-splines at the interior knot of this number, to a common factor; in units
/// of the mean distance of knots.
fn jumps(knots: &[f64], number: usize) -> [f64; DEGREE + 2] {
    let sections = knots.len() - 2 * DEGREE - 1;
    let unit = (knots[knots.len() - 1] - knots[0]) / sections as f64;
    let at = knots[number + DEGREE + 1];
    std::array::from_fn(|n| {
        let own = number + n..number + n + DEGREE + 2;
        // the knot itself is left out of the product; so is one factor of length, which the numerator has
        let product: f64 = own.clone().filter(|k| *k != number + DEGREE + 1).map(|k| (at - knots[k]) / unit).product();
        (knots[own.end - 1] - knots[own.start]) / unit / product
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_followed_exactly() {
        let points: Vec<(f64, f64)> = (0..12).map(|n| f64::from(n * n)).map(|x| (x, 3.0 - x + 0.25 * x * x)).collect();
        for (x, y) in curve(&points).unwrap() {
            assert!((y - (3.0 - x + 0.25 * x * x)).abs() < 1e-8 * (1.0 + y.abs()), "{x} {y}");
        }
    }

    #[test]
    fn great_values_are_passed_through_and_squares_add_up_to_the_number_of_points() {
        let shape = |x: f64| 1e6 / (1.0 + (x - 6.3).powi(2));
        let points: Vec<(f64, f64)> = (0..15).map(f64::from).map(|x| (x, shape(x))).collect();
        let data = Data::merged(&points);
        let spline = data.smooth(15.0).unwrap();
        assert!(points.iter().all(|(x, y)| (spline.value(*x) - y).abs() < 4.0));
        let rough: Vec<(f64, f64)> =
            (0..30).map(f64::from).map(|x| (x, 40.0 * (x * 0.4).sin() + (x * 7.1).cos())).collect();
        let spline = Data::merged(&rough).smooth(30.0).unwrap();
        let sum: f64 = rough.iter().map(|(x, y)| (spline.value(*x) - y).powi(2)).sum();
        assert!((sum - 30.0).abs() < 0.05, "{sum}");
    }

    #[test]
    fn b_splines_add_up_to_one() {
        let knots = [0.0, 0.0, 0.0, 1.0, 2.5, 3.0, 4.0, 4.0, 4.0];
        for n in 0..=40 {
            let (_, values) = basis(&knots, 0.1 * f64::from(n));
            assert!(
                (values.iter().sum::<f64>() - 1.0).abs() < 1e-12 && values.iter().all(|v| *v >= -1e-12),
                "{values:?}"
            );
        }
    }
}
