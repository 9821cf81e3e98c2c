//! Weighted linear least squares with few unknowns, by normal equations and Cholesky's factors.

/// Sums of the normal equations of `N` unknowns.
#[derive(Debug, Clone)]
pub(crate) struct LeastSquares<const N: usize> {
    normal: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> LeastSquares<N> {
    pub(crate) fn new() -> Self {
        Self { normal: [[0.0; N]; N], right: [0.0; N] }
    }

    /// Adds the equation `row . unknowns = value`.
    pub(crate) fn add(&mut self, row: [f64; N], value: f64, weight: f64) {
        for i in 0..N {
            self.right[i] += weight * row[i] * value;
            for j in 0..=i {
                self.normal[i][j] += weight * row[i] * row[j];
            }
        }
    }

    /// The unknowns; None when the equations do not fix them. Unknowns should be scaled to be of similar size.
    pub(crate) fn solve(&self) -> Option<[f64; N]> {
        let mut lower = self.normal;
        for i in 0..N {
            for j in 0..=i {
                let rest = (0..j).fold(lower[i][j], |rest, k| rest - lower[i][k] * lower[j][k]);
                if i != j {
                    lower[i][j] = rest / lower[j][j];
                } else if rest > 1e-13 * self.normal[i][i] {
                    lower[i][i] = rest.sqrt();
                } else {
                    return None;
                }
            }
        }
        let mut unknowns = self.right;
        for i in 0..N {
            unknowns[i] = (0..i).fold(unknowns[i], |rest, k| rest - lower[i][k] * unknowns[k]) / lower[i][i];
        }
        for i in (0..N).rev() {
            unknowns[i] = (i + 1..N).fold(unknowns[i], |rest, k| rest - lower[k][i] * unknowns[k]) / lower[i][i];
        }
        unknowns.iter().all(|value| value.is_finite()).then_some(unknowns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weighted_line_is_found() {
        let mut sums = LeastSquares::<2>::new();
        for (x, y, weight) in [(0.0, 1.0, 1.0), (1.0, 3.0, 2.0), (2.0, 5.0, 1.0), (3.0, 100.0, 0.0)] {
            sums.add([1.0, x], y, weight);
        }
        let [offset, slope] = sums.solve().unwrap();
        assert!((offset - 1.0).abs() < 1e-12 && (slope - 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_fixed_has_no_answer() {
        let mut sums = LeastSquares::<2>::new();
        assert!(sums.solve().is_none());
        for y in [1.0, 2.0] {
            sums.add([1.0, 7.0], y, 1.0);
        }
        assert!(sums.solve().is_none());
        sums.add([1.0, f64::NAN], 1.0, 1.0);
        assert!(sums.solve().is_none());
    }
}
