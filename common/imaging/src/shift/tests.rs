//! Star lists with a known motion between them.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::star::Flags;

const SIDE: usize = 2048;

fn star(x_px: f64, y_px: f64, flux_adu: f64, error: f64) -> Star {
    Star {
        x_px,
        y_px,
        x_error_px: error,
        y_error_px: error,
        flux_adu,
        flux_error_adu: 1.0,
        snr: 100.0,
        significance: 100.0,
        peak_adu: 1000.0,
        fwhm_px: 4.0,
        ellipticity: 0.0,
        angle_deg: 0.0,
        flags: Flags::default(),
    }
}

/// A list, and where its stars stand after the motion; both with errors of 0.02 to 0.2 px.
fn lists(seed: u64, count: usize, shift: (f64, f64), rotation_deg: f64) -> (Vec<Star>, Vec<Star>) {
    let mut rng = StdRng::seed_from_u64(seed);
    let noise = |sigma: f64, rng: &mut StdRng| sigma * Distribution::<f64>::sample(&StandardNormal, rng);
    let (sin, cos) = rotation_deg.to_radians().sin_cos();
    let middle = 0.5 * (SIDE as f64 - 1.0);
    (0..count)
        .map(|_| {
            let (x, y) = (rng.random_range(0.0..SIDE as f64), rng.random_range(0.0..SIDE as f64));
            let (flux, error) = (10_f64.powf(rng.random_range(3.0..6.0)), rng.random_range(0.02..0.2));
            let (u, v) = (x - middle, y - middle);
            let there = (middle + cos * u - sin * v + shift.0, middle + sin * u + cos * v + shift.1);
            let reference = star(x + noise(error, &mut rng), y + noise(error, &mut rng), flux, error);
            let dimmed = 0.7 * flux;
            let check = star(there.0 + noise(error, &mut rng), there.1 + noise(error, &mut rng), dimmed, error);
            (reference, check)
        })
        .unzip()
}

#[test]
fn shift_and_rotation_are_found_and_their_errors_are_true() {
    let mut pulls = Vec::new();
    for seed in 0..200 {
        let (dx, dy, rotation) = ((seed as f64 * 7.3) % 160.0 - 80.0, (seed as f64 * 3.1) % 90.0 - 45.0, 0.05);
        let (reference, check) = lists(seed, 40, (dx, dy), rotation);
        let shift = from_stars(&reference, &check, SIDE, SIDE).unwrap();
        assert!(shift.stars > 30, "seed {seed}: {shift:?}");
        assert!((shift.transparency.unwrap() - 0.7).abs() < 1e-3);
        let errors: Vec<f64> = (0..3).map(|n| shift.covariance[n][n].sqrt()).collect();
        pulls.extend([
            (shift.dx_px - dx) / errors[0],
            (shift.dy_px - dy) / errors[1],
            (shift.rotation_deg - rotation) / errors[2],
        ]);
    }
    let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
    let spread = (pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64).sqrt();
    assert!(mean.abs() < 0.15 && (0.85..1.15).contains(&spread), "pulls {mean} +- {spread}");
}

#[test]
fn spurious_and_lost_stars_do_not_matter() {
    for seed in 0..100 {
        let (mut reference, mut check) = lists(seed, 12, (33.3, -21.7), 0.0);
        let (other, another) = (lists(seed + 1000, 18, (0.0, 0.0), 0.0).0, lists(seed + 2000, 18, (0.0, 0.0), 0.0).0);
        reference.extend(other);
        check.extend(another);
        let shift = from_stars(&reference, &check, SIDE, SIDE).unwrap();
        assert!((shift.dx_px - 33.3).hypot(shift.dy_px + 21.7) < 0.15, "seed {seed}: {shift:?}");
    }
}

#[test]
fn hot_pixels_that_stay_in_place_are_left_out() {
    let (mut reference, mut check) = lists(5, 12, (2.4, 1.6), 0.0);
    for n in 0..8 {
        let hot = star(100.0 + 200.0 * f64::from(n), 150.0 + 70.0 * f64::from(n), 5e4, 0.01);
        reference.push(hot);
        check.push(hot);
    }
    let shift = from_stars(&reference, &check, SIDE, SIDE).unwrap();
    assert!((shift.dx_px - 2.4).abs() < 0.1 && (shift.dy_px - 1.6).abs() < 0.1 && shift.stars <= 12, "{shift:?}");
}

#[test]
fn lists_that_have_nothing_in_common_give_no_shift() {
    let mut accepted = 0;
    for seed in 0..300 {
        let (reference, check) = (lists(seed, 40, (0.0, 0.0), 0.0).0, lists(seed + 5000, 40, (0.0, 0.0), 0.0).0);
        accepted += usize::from(from_stars(&reference, &check, SIDE, SIDE).is_ok());
    }
    assert_eq!(accepted, 0);
    assert_eq!(from_stars(&[], &[], 10, 10).unwrap_err(), NoShift::TooFewStars { reference: 0, check: 0 });
}

#[test]
fn a_field_that_a_flip_turned_over_is_found_and_its_turn_is_reported() {
    for seed in 0..100_u64 {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut along = || rng.random_range(-600.0..600.0);
        let (moved, turn) = ((along(), along()), 180.0 + 0.001 * along());
        let (reference, check) = lists(seed, 25, moved, turn);
        let shift = from_stars_either_way(&reference, &check, SIDE, SIDE).unwrap();
        let (off_x, off_y) = (shift.dx_px - moved.0, shift.dy_px - moved.1);
        assert!(off_x.hypot(off_y) < 0.15, "seed {seed}: {moved:?} {shift:?}");
        let off_deg = (shift.rotation_deg - turn + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off_deg.abs() < 0.02 && shift.rotation_deg.abs() <= 180.0, "seed {seed}: {turn} {shift:?}");
        let (x, y) = shift.apply(reference[0].x_px, reference[0].y_px, SIDE, SIDE);
        assert!((x - check[0].x_px).hypot(y - check[0].y_px) < 1.5, "seed {seed}: {shift:?}");
        // what is not turned stays as it is
        let (reference, check) = lists(seed, 25, (10.0, -20.0), 0.3);
        let shift = from_stars_either_way(&reference, &check, SIDE, SIDE).unwrap();
        assert!((shift.rotation_deg - 0.3).abs() < 0.02, "seed {seed}: {shift:?}");
    }
}

#[test]
fn fields_of_any_size_that_have_nothing_in_common_are_not_turned_onto_each_other() {
    for seed in 0..1500_u64 {
        let side = [256.0, 512.0, 1024.0, 2048.0][(seed % 4) as usize];
        let count = 3 + (seed % 40) as usize;
        let list = |seed| {
            let mut stars = lists(seed, count, (0.0, 0.0), 0.0).0;
            stars
                .iter_mut()
                .for_each(|s| (s.x_px, s.y_px) = (s.x_px * side / SIDE as f64, s.y_px * side / SIDE as f64));
            stars
        };
        let found = from_stars_either_way(&list(seed), &list(seed + 5000), side as usize, side as usize);
        assert!(found.is_err(), "seed {seed}: {count} stars on {side} px: {found:?}");
    }
}

#[test]
fn few_stars_are_believed_when_they_moved_little() {
    let one = [star(500.0, 500.0, 1e4, 0.05)];
    let near = from_stars(&one, &[star(502.0, 499.0, 1e4, 0.05)], SIDE, SIDE).unwrap();
    assert!((near.dx_px - 2.0).abs() < 1e-9 && near.rotation_deg == 0.0 && near.stars == 1);
    let far = from_stars(&one, &[star(520.0, 499.0, 1e4, 0.05)], SIDE, SIDE);
    assert!(matches!(far, Err(NoShift::NoMatch { matched: 1, .. })), "{far:?}");
    let vague = from_stars(&[star(500.0, 500.0, 1e4, 0.6)], &[star(501.0, 500.0, 1e4, 0.6)], SIDE, SIDE);
    assert!(matches!(vague, Err(NoShift::Uncertain { .. })), "{vague:?}");
}
