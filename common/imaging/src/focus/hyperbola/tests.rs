use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

use super::*;

fn truth(x: f64) -> f64 {
    2.5_f64.hypot(0.03 * (x - 5210.0))
}

fn run(positions: impl Iterator<Item = f64>) -> Vec<Size> {
    positions.map(|position| Size { position, size: truth(position), error: 0.02 * truth(position) }).collect()
}

#[test]
fn an_exact_curve_is_found_exactly() {
    let fit = Hyperbola::fit(&run((0..9).map(|n| 4800.0 + 100.0 * f64::from(n)))).unwrap();
    assert!((fit.best_position - 5210.0).abs() < 1e-4, "{fit:?}");
    assert!((fit.least_size - 2.5).abs() < 1e-6 && (fit.slope - 0.03).abs() < 1e-8, "{fit:?}");
    assert!((fit.critical_zone() - 83.333_33).abs() < 1e-3 && fit.used.iter().all(|used| *used));
    assert!((fit.size_at(4900.0) - truth(4900.0)).abs() < 1e-6);
}

#[test]
fn the_error_is_what_the_scatter_of_many_runs_shows() {
    let mut rng = StdRng::seed_from_u64(7);
    let pulls: Vec<f64> = (0..300)
        .map(|_| {
            let mut points = run((0..16).map(|n| 4900.0 + 40.0 * f64::from(n)));
            for point in &mut points {
                let noise: f64 = StandardNormal.sample(&mut rng);
                point.size *= 1.0 + 0.03 * noise;
                point.error = 0.022 * point.size; // with the share of seeing: 3 %
            }
            let fit = Hyperbola::fit(&points).unwrap();
            (fit.best_position - 5210.0) / fit.best_position_error
        })
        .collect();
    let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64).sqrt();
    println!("rms of the pulls {rms:.3}");
    // less than 1: the error allows for two slopes, which these runs have not
    assert!((0.5..1.25).contains(&rms), "{rms}");
}

#[test]
fn two_frames_through_clouds_or_gusts_do_not_matter() {
    let mut rng = StdRng::seed_from_u64(11);
    for _ in 0..200 {
        let mut points = run((0..16).map(|n| 4900.0 + 40.0 * f64::from(n)));
        let first = rng.random_range(0..16);
        let second = (first + rng.random_range(1..16)) % 16;
        points[first].size *= rng.random_range(1.5..4.0);
        points[second].size *= rng.random_range(0.2..0.6);
        let fit = Hyperbola::fit(&points).unwrap();
        assert!(!fit.used[first] && !fit.used[second], "{fit:?}");
        assert!((fit.best_position - 5210.0).abs() < 0.1, "{fit:?}");
    }
}

#[test]
fn one_wing_shows_on_which_side_the_focus_lies() {
    let fit = Hyperbola::fit(&run((0..9).map(|n| 4000.0 + 100.0 * f64::from(n))));
    assert!(fit.is_ok_and(|fit| fit.best_position > 4800.0));
}

#[test]
fn a_curve_without_minimum_is_reported() {
    let flat = |_: f64| 4.0;
    let hill = |x: f64| 9.0 - 0.001 * (x - 400.0).powi(2).abs().sqrt();
    for shape in [&flat as &dyn Fn(f64) -> f64, &hill] {
        let points: Vec<Size> = (0..9)
            .map(|n| 100.0 * f64::from(n))
            .map(|position| Size { position, size: shape(position), error: 0.1 })
            .collect();
        assert_eq!(Hyperbola::fit(&points).unwrap_err(), NoHyperbola::NoMinimum);
    }
    let one = [Size { position: 1.0, size: 2.0, error: 0.1 }];
    assert_eq!(Hyperbola::fit(&one).unwrap_err(), NoHyperbola::TooFew { points: 1, positions: 1 });
    let same = [one[0]; 9];
    assert_eq!(Hyperbola::fit(&same).unwrap_err(), NoHyperbola::TooFew { points: 9, positions: 1 });
    assert_eq!(Hyperbola::fit(&[]).unwrap_err(), NoHyperbola::TooFew { points: 0, positions: 0 });
}

#[test]
fn a_slope_too_small_for_a_number_is_none() {
    let size = |position: f64, error: f64| Size { position, size: 1e-300, error };
    let points = [size(0.0, f64::NAN), size(40.0, 0.0), size(1e300, f64::NAN), size(-1e300, 0.56)];
    assert_eq!(Hyperbola::fit(&points).unwrap_err(), NoHyperbola::NoMinimum);
}

/// A run over a curve whose slopes differ, in critical zones.
struct Drawn {
    points: Vec<Size>,
    best: f64,
}

impl Drawn {
    fn new(seed: u64, steepest: f64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        // slope above over slope below, less one
        let steeper = if steepest > 0.0 { rng.random_range(-steepest..=steepest) } else { 0.0 };
        let (half, count) = (rng.random_range(2.5..8.0), rng.random_range(7..25));
        let best = rng.random_range(-0.6..0.6) * half;
        let noise_share: f64 = rng.random_range(0.005..0.06);
        let k = steeper / (2.0 + steeper);
        // the first positions after a change of direction lag behind
        let lag = if seed % 5 == 1 { 0.3 } else { 0.0 };
        let mut points: Vec<Size> = (0..count)
            .map(|n| {
                let position = half * (2.0 * f64::from(n) / f64::from(count - 1) - 1.0);
                let off = position - best + if n == 0 { lag } else { 0.0 };
                let truth = 1.0_f64.hypot((1.0 + k * off.signum()) * off);
                let noise: f64 = StandardNormal.sample(&mut rng);
                let size = truth * (1.0 + noise_share.hypot(SEEING) * noise);
                Size { position, size, error: noise_share * truth }
            })
            .collect();
        if seed % 3 == 1 {
            let spoilt = rng.random_range(0..points.len());
            points[spoilt].size *= rng.random_range(1.3..3.0);
        }
        Self { points, best }
    }
}

#[test]
fn the_error_covers_slopes_that_differ_clouds_gusts_and_few_points() {
    for (steepest, most) in [(0.0, 2.2), (0.15, 2.5), (0.4, 2.5)] {
        let (mut pulls, mut offs, mut stated) = (Vec::new(), Vec::new(), Vec::new());
        for seed in 0..1500 {
            let run = Drawn::new(seed, steepest);
            let fit = Hyperbola::fit(&run.points).unwrap();
            let off = (fit.best_position - run.best).abs();
            pulls.push(off / fit.best_position_error);
            offs.push(off);
            stated.push(fit.best_position_error);
        }
        let rank = |values: &mut Vec<f64>, share: f64| {
            values.sort_by(f64::total_cmp);
            values[(share * values.len() as f64) as usize]
        };
        println!(
            "slopes to {steepest}: 68 % within {:.2} sigma, 95 % {:.2}, 99 % {:.2}; off {:.3} in the median, stated {:.3}",
            rank(&mut pulls, 0.683),
            rank(&mut pulls, 0.95),
            rank(&mut pulls, 0.99),
            rank(&mut offs, 0.5),
            rank(&mut stated, 0.5)
        );
        assert!(rank(&mut pulls, 0.95) < most, "{steepest}");
        assert!(rank(&mut pulls, 0.5) > 0.3, "{steepest}: the error is not made up");
    }
}

#[test]
fn symmetric_runs_are_as_good_as_with_one_slope_alone() {
    let (mut averaged, mut alone) = (0.0, 0.0);
    for seed in (0..1200).filter(|seed| seed % 3 != 1 && seed % 5 != 1) {
        let run = Drawn::new(seed, 0.0);
        averaged += (Hyperbola::fit(&run.points).unwrap().best_position - run.best).powi(2);
        let scaled = Scaled::of(&run.points).unwrap();
        let [x0, c, a] = scaled.start().unwrap();
        let one = scaled.refine([x0, c, a, 0.0], &scaled.all(), 1.0, ONE_SLOPE).unwrap();
        alone += (scaled.middle + scaled.half * one.at[0] - run.best).powi(2);
    }
    println!("rms with two slopes allowed {averaged:.3}, with one {alone:.3} (sums of squares)");
    assert!(averaged < 1.2 * alone, "{averaged} {alone}");
}

proptest! {
    #[test]
    fn any_points_have_a_finite_answer_or_a_reason(
        points in prop::collection::vec(
            (
                prop_oneof![0.0_f64..100.0, Just(50.0), Just(f64::NAN), Just(1e300), Just(-1e300)],
                prop_oneof![0.1_f64..50.0, Just(0.0), Just(-1.0), Just(f64::NAN), Just(f64::INFINITY), Just(1e-300)],
                prop_oneof![0.0_f64..5.0, Just(f64::NAN), Just(0.0)],
            ), 0..25)
    ) {
        let points: Vec<Size> = points.into_iter().map(|(position, size, error)| Size { position, size, error }).collect();
        if let Ok(fit) = Hyperbola::fit(&points) {
            prop_assert!(fit.best_position.is_finite() && fit.best_position_error.is_finite(), "{fit:?}");
            prop_assert!(fit.least_size > 0.0 && fit.slope > 0.0, "{fit:?}");
        }
    }
}
