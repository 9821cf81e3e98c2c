//! The predecessor's two formulae for star sizes (docs/formulae.md, "The predecessor's curves"), by least squares on
//! the plain points. They know no outliers and no errors; [`super::hyperbola`] does.

use super::least_squares;

const FEWEST: usize = 5;

/// (position, value).
type FocusValues = Vec<(f64, f64)>;

/// Bottom of the V whose sides have slopes of their own, which may lie at any position of the run; None with fewer
/// than 5 points or positions that are all the same. (position, value) in any order.
pub fn v_curve(points: &[(f64, f64)]) -> Option<f64> {
    let (points, low, high) = sorted(points)?;
    let step = (high - low) / 400.0;
    let cost = |x0: f64| v_cost(&points, x0);
    let coarse = (0..=400).map(|n| low + step * f64::from(n)).min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
    // golden section within one step to either side
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut left, mut right) = ((coarse - step).max(low), (coarse + step).min(high));
    for _ in 0..60 {
        let (a, b) = (right - ratio * (right - left), left + ratio * (right - left));
        if cost(a) <= cost(b) { right = b } else { left = a }
    }
    Some(0.5 * (left + right))
}

/// Centre of `y = y0 + b sqrt(1 + ((x - x0) / a)^2)`; None with fewer than 5 points or positions that are all the
/// same, or when there is no minimum within the run.
pub fn raised_hyperbola(points: &[(f64, f64)]) -> Option<f64> {
    let (points, low, high) = sorted(points)?;
    let start = v_curve(&points)?;
    let half = 0.5 * (high - low);
    let (bottom, top) = points.iter().fold((f64::MAX, f64::MIN), |(low, high), (_, y)| (low.min(*y), high.max(*y)));
    // in units of the half range: centre, slope of the asymptotes, rounding, floor
    let start = [(start - low) / half - 1.0, top - bottom, 0.1, 0.0];
    let free = (f64::NEG_INFINITY, f64::INFINITY);
    let fit = least_squares::minimise(start, [(-1.0, 1.0), (0.0, f64::INFINITY), (1e-6, 1e3), free], |p, sums| {
        for (x, y) in &points {
            let dx = (x - low) / half - 1.0 - p[0];
            let root = dx.hypot(p[2]);
            let derivatives = [-p[1] * dx / root, root, p[1] * p[2] / root, 1.0];
            sums.add(p[3] + p[1] * root - (y - bottom), derivatives, f64::INFINITY);
        }
    })?;
    (fit.at[1] > 0.0 && fit.at[0].abs() < 1.0).then(|| low + half * (1.0 + fit.at[0]))
}

/// The usable points in order of position, and the first and the last position.
fn sorted(points: &[(f64, f64)]) -> Option<(FocusValues, f64, f64)> {
    let mut points: FocusValues = points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (low, high) = (points.first()?.0, points.last()?.0);
    (points.len() >= FEWEST && high > low).then_some((points, low, high))
}

/// Least sum of squares of a V with its bottom at `x0`: linear in both slopes and the floor.
fn v_cost(points: &[(f64, f64)], x0: f64) -> f64 {
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    let scale = (points[points.len() - 1].0 - points[0].0).max(f64::MIN_POSITIVE);
    let sides = |x: f64| nalgebra::Vector3::new(((x - x0) / scale).min(0.0), ((x - x0) / scale).max(0.0), 1.0);
    for (x, y) in points {
        normal += sides(*x) * sides(*x).transpose();
        right += sides(*x) * *y;
    }
    // a side without a point is open: the smallest of its slopes will do
    let best = normal.svd(true, true).solve(&right, 1e-12).unwrap_or_default();
    points.iter().map(|(x, y)| (sides(*x).dot(&best) - y).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_find_the_centre_of_their_own_curve() {
        let at = |shape: fn(f64) -> f64| -> Vec<(f64, f64)> {
            (0..15).map(|n| f64::from(n) * 40.0).map(|x| (x, shape(x))).collect()
        };
        let v = at(|x| if x < 271.0 { 5.0 + 0.02 * (271.0 - x) } else { 5.0 + 0.03 * (x - 271.0) });
        assert!((v_curve(&v).unwrap() - 271.0).abs() < 1e-4, "{:?}", v_curve(&v));
        let rounded = at(|x| 40.0 + 3.0 * (1.0 + ((x - 271.0) / 55.0).powi(2)).sqrt());
        assert!((raised_hyperbola(&rounded).unwrap() - 271.0).abs() < 1e-3, "{:?}", raised_hyperbola(&rounded));
    }

    #[test]
    fn too_little_has_no_centre() {
        for points in [vec![], vec![(1.0, 2.0)], vec![(3.0, 1.0); 8], vec![(f64::NAN, 1.0); 8]] {
            assert_eq!((v_curve(&points), raised_hyperbola(&points)), (None, None));
        }
    }
}
