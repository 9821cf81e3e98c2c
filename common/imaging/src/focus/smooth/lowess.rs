//! Locally weighted lines (Cleveland 1979), as statsmodels draws them.

/// Share of the points that each line is fitted to, and rounds that lower the weight of outliers.
const SHARE: f64 = 0.5;
const ROUNDS: usize = 3;

/// At the points' own positions. `points` are in order of position.
#[allow(clippy::unnecessary_wraps)] // all smoothers have one shape
pub(super) fn curve(points: &[(f64, f64)]) -> Option<Vec<(f64, f64)>> {
    let count = points.len();
    // a hair more, so that a share of exact halves is not cut off by rounding
    let near = ((SHARE * count as f64 + 1e-10) as usize).clamp(2, count);
    let mut trust = vec![1.0; count];
    let mut fitted = pass(points, near, &trust);
    for _ in 0..ROUNDS {
        trust = robust_weights(points, &fitted);
        fitted = pass(points, near, &trust);
    }
    Some(points.iter().zip(fitted).map(|((x, _), y)| (*x, y)).collect())
}

fn pass(points: &[(f64, f64)], near: usize, trust: &[f64]) -> Vec<f64> {
    let mut left = 0;
    let at = |(x, y): &(f64, f64)| {
        while left + near < points.len() && *x > 0.5 * (points[left].0 + points[left + near].0) {
            left += 1;
        }
        let window = left..left + near;
        line_at(*x, &points[window.clone()], &trust[window]).unwrap_or(*y)
    };
    points.iter().map(at).collect()
}

/// The weighted line's value at `x`; None with less than two weights that count.
fn line_at(x: f64, points: &[(f64, f64)], trust: &[f64]) -> Option<f64> {
    let radius = points.iter().map(|(px, _)| (px - x).abs()).fold(0.0, f64::max);
    let weight = |px: f64| if radius > 0.0 { (1.0 - ((px - x).abs() / radius).powi(3)).powi(3) } else { 1.0 };
    let weighted: Vec<(f64, f64, f64)> =
        points.iter().zip(trust).map(|((px, py), trust)| (*px - x, *py, trust * weight(*px))).collect();
    if weighted.iter().filter(|(_, _, w)| *w > 0.0).count() < 2 {
        return None;
    }
    let sum = |of: fn(&(f64, f64, f64)) -> f64| weighted.iter().map(of).sum::<f64>();
    let w = sum(|p| p.2);
    let (mean_x, mean_y) = (sum(|p| p.2 * p.0) / w, sum(|p| p.2 * p.1) / w);
    let spread: f64 = weighted.iter().map(|p| p.2 * (p.0 - mean_x).powi(2)).sum();
    let along: f64 = weighted.iter().map(|p| p.2 * (p.0 - mean_x) * (p.1 - mean_y)).sum();
    // all at one position: no slope
    let slope = if spread > 1e-12 * w * radius * radius { along / spread } else { 0.0 };
    Some(mean_y - slope * mean_x)
}

/// Bisquare of the residual over six times the median residual.
fn robust_weights(points: &[(f64, f64)], fitted: &[f64]) -> Vec<f64> {
    let residuals: Vec<f64> = points.iter().zip(fitted).map(|((_, y), fit)| (y - fit).abs()).collect();
    let limit = 6.0 * crate::focus::median(residuals.clone()).unwrap_or(0.0);
    let weight = |residual: &f64| match limit {
        0.0 => f64::from(u8::from(*residual == 0.0)),
        limit if *residual >= limit => 0.0,
        limit => (1.0 - (residual / limit).powi(2)).powi(2),
    };
    residuals.iter().map(weight).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::RUN;

    /// The golden numbers are from statsmodels 0.15.0.
    #[test]
    fn the_curve_agrees_with_the_golden_numbers() {
        let golden =
            [9.032_164, 7.144_761, 5.25, 3.3, 2.148_931, 1.942_765, 2.400_282, 3.791_145, 5.399_338, 7.012_588];
        let curve = super::curve(&RUN).unwrap();
        for ((x, y), expected) in curve.iter().zip(golden) {
            assert!((y - expected).abs() < 1e-6, "at {x}: {y}, golden {expected}");
        }
    }
}
