//! Least squares for a few parameters: Levenberg and Marquardt's damped steps, with bounds and with Huber's loss.

use nalgebra::{SMatrix, SVector};

/// Steps that are tried at most, the refused ones included.
const STEPS: usize = 400;
/// Done when a step lowers the cost by less than this share of it.
const CLOSE: f64 = 1e-14;

/// What one pass over the data adds up to.
#[derive(Debug, Clone)]
pub(super) struct FitSums<const N: usize> {
    cost: f64,
    curvature: SMatrix<f64, N, N>,
    slope: SVector<f64, N>,
}

impl<const N: usize> FitSums<N> {
    /// One residual, in units of its error, with its derivatives. Residuals beyond `huber` count linearly.
    pub(super) fn add(&mut self, residual: f64, derivatives: [f64; N], huber: f64) {
        let size = residual.abs();
        let weight = if size <= huber { 1.0 } else { huber / size };
        self.cost += if size <= huber { 0.5 * size * size } else { huber * (size - 0.5 * huber) };
        for (row, a) in derivatives.iter().enumerate() {
            self.slope[row] += weight * residual * a;
            derivatives.iter().enumerate().for_each(|(column, b)| self.curvature[(row, column)] += weight * a * b);
        }
    }

    fn of(terms: &impl Fn(&[f64; N], &mut Self), at: &[f64; N]) -> Self {
        let mut sums = Self { cost: 0.0, curvature: SMatrix::zeros(), slope: SVector::zeros() };
        terms(at, &mut sums);
        sums
    }
}

/// A minimum.
#[derive(Debug, Clone)]
pub(super) struct Minimum<const N: usize> {
    pub(super) at: [f64; N],
    /// Half of the sum of the squared residuals, large ones counting less.
    pub(super) cost: f64,
    /// Covariance of the parameters for residuals of unit variance; None when the data leave one of them open.
    pub(super) covariance: Option<SMatrix<f64, N, N>>,
}

/// Goes down from `start`, staying within `bounds` (lowest, highest). `terms(parameters, sums)` adds all residuals
/// (model - measured). None when the cost is not finite at the start.
pub(super) fn minimise<const N: usize>(
    start: [f64; N],
    bounds: [(f64, f64); N],
    terms: impl Fn(&[f64; N], &mut FitSums<N>),
) -> Option<Minimum<N>> {
    let mut at = start;
    let mut sums = FitSums::of(&terms, &at);
    if !sums.cost.is_finite() {
        return None;
    }
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let Some(step) = step(&sums, &at, &bounds, damping) else {
            damping *= 10.0;
            continue;
        };
        let next: [f64; N] = std::array::from_fn(|n| (at[n] + step[n]).clamp(bounds[n].0, bounds[n].1));
        let new = FitSums::of(&terms, &next);
        if new.cost <= sums.cost {
            let gained = sums.cost - new.cost;
            (at, sums) = (next, new);
            if gained <= CLOSE * sums.cost {
                break;
            }
            damping = (0.2 * damping).max(1e-12);
        } else {
            damping *= 5.0;
            if damping > 1e14 {
                break;
            }
        }
    }
    let covariance = sums.curvature.try_inverse().filter(|matrix| matrix.iter().all(|value| value.is_finite()));
    Some(Minimum { at, cost: sums.cost, covariance })
}

/// The damped step; a parameter that stands at its bound and wants to go further keeps its place.
fn step<const N: usize>(
    sums: &FitSums<N>,
    at: &[f64; N],
    bounds: &[(f64, f64); N],
    damping: f64,
) -> Option<SVector<f64, N>> {
    let (mut curvature, mut slope) = (sums.curvature, -sums.slope);
    for n in 0..N {
        if (at[n] <= bounds[n].0 && slope[n] < 0.0) || (at[n] >= bounds[n].1 && slope[n] > 0.0) {
            curvature.row_mut(n).fill(0.0);
            curvature.column_mut(n).fill(0.0);
            slope[n] = 0.0;
        }
        // a parameter without influence has no scale of its own
        let scale = if curvature[(n, n)] > 0.0 { curvature[(n, n)] } else { 1.0 };
        curvature[(n, n)] += damping * scale;
    }
    curvature.cholesky().map(|factors| factors.solve(&slope)).filter(|step| step.iter().all(|v| v.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponential_is_found_and_an_outlier_hardly_moves_it() {
        let data: Vec<(f64, f64)> = (0..20).map(|n| f64::from(n) * 0.2).map(|x| (x, 5.0 * (-0.7 * x).exp())).collect();
        let fit = |data: &[(f64, f64)], huber: f64| {
            minimise([1.0, 0.1], [(0.0, 100.0), (0.0, 10.0)], |p, sums| {
                for (x, y) in data {
                    let shape = (-p[1] * x).exp();
                    sums.add((p[0] * shape - y) / 0.1, [shape / 0.1, -x * p[0] * shape / 0.1], huber);
                }
            })
            .unwrap()
        };
        let exact = fit(&data, f64::INFINITY);
        assert!((exact.at[0] - 5.0).abs() < 1e-6 && (exact.at[1] - 0.7).abs() < 1e-6, "{exact:?}");
        let mut spoilt = data.clone();
        spoilt[10].1 += 3.0;
        let (plain, robust) = (fit(&spoilt, f64::INFINITY), fit(&spoilt, 1.3));
        let off = |fit: &Minimum<2>| (fit.at[0] - 5.0).abs() + (fit.at[1] - 0.7).abs();
        assert!(off(&robust) < 0.1 && off(&robust) < 0.25 * off(&plain), "{robust:?} {plain:?}");
    }

    #[test]
    fn a_bound_holds_and_an_open_parameter_has_no_covariance() {
        let fit =
            minimise([0.0, 0.0], [(-1.0, 1.0), (-1.0, 1.0)], |p, sums| sums.add(p[0] - 3.0, [1.0, 0.0], 9.0)).unwrap();
        assert_eq!(fit.at, [1.0, 0.0]);
        assert!(fit.covariance.is_none());
        assert!(minimise([f64::NAN], [(0.0, 1.0)], |p, sums| sums.add(p[0], [1.0], 1.0)).is_none());
    }
}
