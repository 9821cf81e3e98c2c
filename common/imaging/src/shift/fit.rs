//! Shift and rotation by weighted least squares that outliers cannot pull.

use crate::star::Star;

/// Residuals beyond this many standard errors count less and less (Huber 1964; 95 % efficient for a Gaussian).
const HUBER: f64 = 1.345;
const ROUNDS: usize = 10;
/// A rotation needs at least this many stars ...
const ROTATION_STARS: usize = 3;
/// ... with this rms distance from their middle, px.
const ROTATION_ARM_PX: f64 = 20.0;

type Matrix = [[f64; 3]; 3];

/// A shift (px) and a small rotation (rad) about a centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct FieldMotion {
    pub(super) dx: f64,
    pub(super) dy: f64,
    pub(super) rotation: f64,
    /// Of dx, dy (px) and rotation (rad).
    pub(super) covariance: Matrix,
    centre: (f64, f64),
}

impl FieldMotion {
    pub(super) fn shifted(by: (f64, f64), centre: (f64, f64)) -> Self {
        Self { dx: by.0, dy: by.1, rotation: 0.0, covariance: [[0.0; 3]; 3], centre }
    }

    pub(super) fn apply(&self, x: f64, y: f64) -> (f64, f64) {
        let (sin, cos) = self.rotation.sin_cos();
        let (u, v) = (x - self.centre.0, y - self.centre.1);
        (self.centre.0 + cos * u - sin * v + self.dx, self.centre.1 + sin * u + cos * v + self.dy)
    }

    /// Whether a pair agrees with it within five standard errors and a tenth of a pixel.
    pub(super) fn explains(&self, (reference, check): &(&Star, &Star)) -> bool {
        let (x, y) = self.apply(reference.x_px, reference.y_px);
        let error = |a: f64, b: f64| 0.1 + 5.0 * a.hypot(b);
        (check.x_px - x).abs() <= error(reference.x_error_px, check.x_error_px)
            && (check.y_px - y).abs() <= error(reference.y_error_px, check.y_error_px)
    }

    pub(super) fn covariance_in_degrees(&self) -> Matrix {
        let unit = |n: usize| if n == 2 { 1_f64.to_degrees() } else { 1.0 };
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j] * unit(i) * unit(j)))
    }
}

/// The motion that takes the first star of each pair to the second. None when there are no pairs.
pub(super) fn fit(pairs: &[(&Star, &Star)], centre: (f64, f64)) -> Option<FieldMotion> {
    let rotates = can_rotate(pairs);
    let mut motion = FieldMotion::shifted(start(pairs)?, centre);
    for _ in 0..ROUNDS {
        // normal equations of the corrections to dx, dy and rotation
        let (mut normal, mut right): (Matrix, [f64; 3]) = ([[0.0; 3]; 3], [0.0; 3]);
        for (r, c) in pairs {
            let (x, y) = motion.apply(r.x_px, r.y_px);
            let (u, v) = (x - centre.0 - motion.dx, y - centre.1 - motion.dy);
            let arm = if rotates { 1.0 } else { 0.0 };
            let variance_x = r.x_error_px.powi(2) + c.x_error_px.powi(2);
            let variance_y = r.y_error_px.powi(2) + c.y_error_px.powi(2);
            let (ex, ey) = (c.x_px - x, c.y_px - y);
            let pull = (ex * ex / variance_x + ey * ey / variance_y).sqrt() / std::f64::consts::SQRT_2;
            let huber = if pull > HUBER { HUBER / pull } else { 1.0 };
            for (row, e, variance) in [([1.0, 0.0, -v * arm], ex, variance_x), ([0.0, 1.0, u * arm], ey, variance_y)] {
                let weight = huber / variance;
                for i in 0..3 {
                    right[i] += weight * row[i] * e;
                    for j in 0..3 {
                        normal[i][j] += weight * row[i] * row[j];
                    }
                }
            }
        }
        if !rotates {
            normal[2][2] = 1.0;
        }
        let inverse = inverse(&normal)?;
        let step: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| inverse[i][j] * right[j]).sum());
        motion.dx += step[0];
        motion.dy += step[1];
        motion.rotation += step[2];
        motion.covariance = inverse;
        if step[0].hypot(step[1]) < 1e-6 && step[2].abs() < 1e-9 {
            break;
        }
    }
    if !rotates {
        (0..3).for_each(|n| (motion.covariance[n][2], motion.covariance[2][n]) = (0.0, 0.0));
    }
    Some(motion)
}

/// Median differences: a start that half of the pairs cannot spoil.
fn start(pairs: &[(&Star, &Star)]) -> Option<(f64, f64)> {
    let median = |of: fn(&Star) -> f64| {
        let mut values: Vec<f32> = pairs.iter().map(|(r, c)| (of(c) - of(r)) as f32).collect();
        crate::background::median_in_place(&mut values).map(f64::from)
    };
    Some((median(|star| star.x_px)?, median(|star| star.y_px)?))
}

fn can_rotate(pairs: &[(&Star, &Star)]) -> bool {
    let n = pairs.len() as f64;
    let mean = |of: fn(&Star) -> f64| pairs.iter().map(|(r, _)| of(r)).sum::<f64>() / n;
    let (x, y) = (mean(|star| star.x_px), mean(|star| star.y_px));
    let squares: f64 = pairs.iter().map(|(r, _)| (r.x_px - x).powi(2) + (r.y_px - y).powi(2)).sum();
    pairs.len() >= ROTATION_STARS && squares / n > ROTATION_ARM_PX.powi(2)
}

/// By cofactors; None for a singular matrix.
fn inverse(m: &Matrix) -> Option<Matrix> {
    let cofactor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * cofactor(0, j)).sum();
    (determinant.is_finite() && determinant > 0.0)
        .then(|| std::array::from_fn(|i| std::array::from_fn(|j| cofactor(j, i) / determinant)))
}
