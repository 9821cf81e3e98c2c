//! Smoothed curves through a run, by name, and where they are best: for operators that no formula describes.
//!
//! The predecessor's four (docs/formulae.md, "The predecessor's curves"). A hyperbola through star sizes
//! ([`super::hyperbola`]) is better where there are stars: it needs fewer frames and knows its error.

mod lowess;
mod radial;
mod running_median;
mod spline;

use super::operator::Better;

/// Places at which curves that are defined everywhere are looked at.
const SAMPLES: usize = 100;
/// Fewer positions than this have no curve.
const FEWEST: usize = 4;

/// (position, value), in order of position.
type Drawn = Vec<(f64, f64)>;

/// A way to draw a curve through points.
#[derive(Debug, Clone, Copy)]
pub struct Smoother {
    /// Its name in schedules.
    pub name: &'static str,
    /// What it is, in a few words.
    pub what: &'static str,
    curve: fn(&[(f64, f64)]) -> Option<Drawn>,
}

/// All of them.
pub const SMOOTHERS: [Smoother; 4] = [
    Smoother { name: "lowess", what: "local lines, half of the points each, 3 robust rounds", curve: lowess::curve },
    Smoother { name: "median", what: "running median of 10 points", curve: running_median::curve },
    Smoother { name: "spline", what: "quadratic spline, squared residuals as many as points", curve: spline::curve },
    Smoother { name: "rbf", what: "linear radial functions, smoothing 20", curve: radial::curve },
];

/// Why a run has no best position by a smoothed curve.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoExtremum {
    /// No smoother is called so.
    #[error("no smoother is called {name:?}; take one of {known}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// The names that there are.
        known: String,
    },
    /// Too few points with a value.
    #[error("{positions} different positions with a value, {FEWEST} are needed")]
    TooFew {
        /// Different positions with a finite value.
        positions: usize,
    },
    /// The curve cannot be computed.
    #[error("no {smoother} curve goes through the {points} points")]
    NoCurve {
        /// The smoother's name.
        smoother: &'static str,
        /// Points that it was given.
        points: usize,
    },
}

impl Smoother {
    /// The smoother of this name, or the only one whose name begins so.
    ///
    /// # Errors
    /// [`NoExtremum::Unknown`].
    pub fn named(name: &str) -> Result<&'static Self, NoExtremum> {
        super::by_name(&SMOOTHERS, |smoother| smoother.name, name)
            .map_err(|known| NoExtremum::Unknown { name: name.to_owned(), known })
    }

    /// The curve as (position, value), in order of position: at the points' own positions (lowess, median) or at 100
    /// evenly spaced ones (spline, rbf). Points come in any order; those without finite numbers are left out.
    ///
    /// # Errors
    /// [`NoExtremum`] when there are too few positions, or the curve is not determined.
    pub fn curve(&self, points: &[(f64, f64)]) -> Result<Vec<(f64, f64)>, NoExtremum> {
        let mut sorted: Vec<(f64, f64)> =
            points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut positions: Vec<f64> = sorted.iter().map(|(x, _)| *x).collect();
        positions.dedup();
        if positions.len() < FEWEST {
            return Err(NoExtremum::TooFew { positions: positions.len() });
        }
        let curve = (self.curve)(&sorted).filter(|curve| curve.iter().all(|(_, y)| y.is_finite()));
        curve.ok_or(NoExtremum::NoCurve { smoother: self.name, points: sorted.len() })
    }

    /// The best point of the curve (the first of equals).
    ///
    /// # Errors
    /// As [`Smoother::curve`].
    pub fn best(&self, points: &[(f64, f64)], better: Better) -> Result<(f64, f64), NoExtremum> {
        let curve = self.curve(points)?;
        let is_better = |a: f64, b: f64| if better == Better::Smaller { a < b } else { a > b };
        let best = curve.into_iter().reduce(|best, point| if is_better(point.1, best.1) { point } else { best });
        best.ok_or(NoExtremum::NoCurve { smoother: self.name, points: points.len() })
    }
}

/// Evenly spaced places from the first to the last position.
fn samples(points: &[(f64, f64)]) -> impl Iterator<Item = f64> {
    let (first, last) = (points.first().map_or(0.0, |p| p.0), points.last().map_or(0.0, |p| p.0));
    (0..SAMPLES).map(move |n| first + (last - first) * n as f64 / (SAMPLES - 1) as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A run whose curves were computed with statsmodels and scipy.
    pub(super) const RUN: [(f64, f64); 10] = [
        (0.0, 9.0),
        (1.0, 7.2),
        (2.0, 8.0),
        (3.0, 3.3),
        (4.0, 2.0),
        (5.0, 1.4),
        (6.0, 2.2),
        (7.0, 3.9),
        (8.0, 5.2),
        (9.0, 7.1),
    ];

    #[test]
    fn minima_agree_with_the_golden_numbers() {
        for (name, x, y) in [("spline", 5.454_545, 2.216_799), ("rbf", 5.0, 4.152_086), ("lowess", 5.0, 1.942_765)] {
            let found = Smoother::named(name).unwrap().best(&RUN, Better::Smaller).unwrap();
            println!("{name}: {found:?}");
            assert!((found.0 - x).abs() < 1e-6 && (found.1 - y).abs() < 1e-6, "{name}: {found:?}, golden {x} {y}");
        }
    }

    #[test]
    fn names_are_forgiving_and_what_has_no_curve_gives_the_reason() {
        assert_eq!(Smoother::named("LOWESS").unwrap().name, "lowess");
        assert!(matches!(Smoother::named("medianfilter"), Err(NoExtremum::Unknown { .. })));
        for smoother in &SMOOTHERS {
            let same = [(5.0, 1.0), (5.0, 2.0), (5.0, 3.0), (5.0, 4.0), (5.0, 1.0)];
            assert_eq!(smoother.curve(&same).unwrap_err(), NoExtremum::TooFew { positions: 1 });
            assert_eq!(smoother.curve(&[]).unwrap_err(), NoExtremum::TooFew { positions: 0 });
            let gaps = [(1.0, f64::NAN), (2.0, 1.0), (f64::INFINITY, 2.0), (3.0, 1.0)];
            assert_eq!(smoother.curve(&gaps).unwrap_err(), NoExtremum::TooFew { positions: 2 });
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn a_curve_is_finite_and_stays_in_range(
            points in prop::collection::vec((0_u16..40, prop_oneof![-1e6_f64..1e6, Just(f64::NAN), Just(0.0)]), 0..40)
        ) {
            let points: Vec<(f64, f64)> = points.into_iter().map(|(x, y)| (f64::from(x), y)).collect();
            for smoother in &SMOOTHERS {
                if let Ok(best) = smoother.best(&points, Better::Larger) {
                    prop_assert!((0.0..=40.0).contains(&best.0) && best.1.is_finite(), "{} {best:?}", smoother.name);
                }
            }
        }
    }
}
