//! Shifts by the sums of bright patches: what they say of related frames, and what they must not say of others.

use imaging::projection::from_projections;
use imaging::{Camera, Clean, Frame, NoShift, Pixels, Shift};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::sky::{Psf, Sky};

/// What a pair of frames suffers from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Nothing,
    /// The check frame has a third of the light.
    Clouds,
    /// Bright towards one corner.
    Gradient,
    /// Columns that are brighter than the others, in both frames.
    HotColumns,
    /// One star that the camera cannot count.
    Saturated,
    Crowded,
}

const FAULTS: [Fault; 6] =
    [Fault::Nothing, Fault::Clouds, Fault::Gradient, Fault::HotColumns, Fault::Saturated, Fault::Crowded];

/// A field of stars about the frame, so that a shift brings others in: places from the middle, and fluxes.
struct Field {
    stars: Vec<(f64, f64, f64)>,
}

impl Field {
    fn new(seed: u64, side: usize, fault: Fault) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let per_star_px2 = if fault == Fault::Crowded { 400.0 } else { rng.random_range(2500.0..6000.0) };
        let wide = 2.0 * side as f64;
        let count = (wide * wide / per_star_px2) as usize;
        let mut place = || rng.random_range(-0.5 * wide..0.5 * wide);
        let places: Vec<(f64, f64)> = (0..count).map(|_| (place(), place())).collect();
        let mut stars: Vec<(f64, f64, f64)> =
            places.into_iter().map(|(x, y)| (x, y, 1500.0 * rng.random_range(0.003..1.0_f64).powf(-0.8))).collect();
        if fault == Fault::Saturated {
            let mut near = || rng.random_range(-0.2..0.2) * side as f64;
            stars.push((near(), near(), 6e6));
        }
        Self { stars }
    }

    fn clean(&self, side: usize, shift: (f64, f64), fault: Fault, is_check: bool, seed: u64) -> Clean {
        let mut sky = Sky::new(side, side, 200.0, seed);
        let middle = 0.5 * side as f64;
        let light = if is_check && fault == Fault::Clouds { 0.33 } else { 1.0 };
        for (x, y, flux) in &self.stars {
            let at = (middle + x + shift.0, middle + y + shift.1);
            sky.add_star(Psf::Gaussian(1.6), at.0, at.1, light * flux);
        }
        match fault {
            Fault::Gradient => sky.add_light(|x, y| 1.5 * (x + 2.0 * y)),
            Fault::HotColumns => {
                sky.add_light(|x, _| if [31.0, 100.0, 0.7 * middle.round()].contains(&x) { 400.0 } else { 0.0 });
            }
            _ => {}
        }
        let counts = sky.counts(300.0, 5.0);
        Clean::new(&Frame::new(side, side, Pixels::U16(&counts)).unwrap(), &Camera::default(), None).unwrap()
    }
}

/// Off by more than its error allows: 5 sigma and 1 px.
fn is_wrong(shift: &Shift, (dx, dy): (f64, f64)) -> bool {
    let off = |found: f64, truth: f64, sigma: f64| (found - truth).abs() > 1.0_f64.max(5.0 * sigma);
    off(shift.dx_px, dx, shift.error_px().0) || off(shift.dy_px, dy, shift.error_px().1)
}

#[test]
fn frames_of_different_fields_have_no_shift() {
    different_fields(8);
}

fn different_fields(pairs: u64) {
    for fault in FAULTS {
        let wrong = (0..pairs).filter(|n| {
            let side = [256, 384, 512, 1024][(n % 4) as usize].min(if fault == Fault::Crowded { 512 } else { 1024 });
            let seed = 1000 * (fault as u64 + 1) + 2 * n;
            let frames = [seed, seed + 1]
                .map(|seed| Field::new(seed, side, fault).clean(side, (0.0, 0.0), fault, seed % 2 == 1, seed));
            let found = from_projections(&frames[0], &frames[1]);
            found.inspect(|shift| println!("{fault:?} {n}: {shift:?}")).is_ok()
        });
        assert_eq!(wrong.count(), 0, "{fault:?}");
    }
}

#[test]
fn a_frame_without_stars_has_no_shift() {
    without_stars(8);
}

fn without_stars(frames: u64) {
    for n in 0..frames {
        let side = [256, 512][(n % 2) as usize];
        for fault in [Fault::Nothing, Fault::HotColumns, Fault::Gradient] {
            let field = Field::new(n, side, fault);
            let blank = Field { stars: Vec::new() };
            let frames = [
                field.clean(side, (0.0, 0.0), fault, false, n),
                blank.clean(side, (0.0, 0.0), fault, true, n + 1),
                blank.clean(side, (0.0, 0.0), fault, true, n + 2),
            ];
            for (reference, check) in [(0, 1), (1, 0), (1, 2)] {
                let refused = from_projections(&frames[reference], &frames[check]);
                assert!(matches!(refused, Err(NoShift::NoPeak { .. })), "{fault:?} {n}: {refused:?}");
            }
        }
    }
}

#[test]
fn true_shifts_up_to_a_third_of_the_frame_are_found_within_their_errors() {
    // each side and all lengths
    true_shifts(3);
}

/// Of 48 shifts each so many-th.
fn true_shifts(step: usize) {
    for fault in FAULTS {
        let (mut pulls, mut lost, mut all) = (Vec::new(), 0, 0);
        for n in (0..48_u64).step_by(step) {
            all += 1;
            let side = [256, 384, 512, 1024][(n % 4) as usize].min(if fault == Fault::Crowded { 512 } else { 1024 });
            let mut rng = StdRng::seed_from_u64(n);
            let greatest = side as f64 / 3.0 * (n / 4) as f64 / 11.0;
            let mut along = || rng.random_range(-1.0..=1.0) * greatest;
            let truth = (along(), along());
            let field = Field::new(5000 + n, side, fault);
            let clean = |shift, is_check, seed| field.clean(side, shift, fault, is_check, seed);
            match from_projections(&clean((0.0, 0.0), false, n), &clean(truth, true, n + 100)) {
                Ok(shift) => {
                    assert!(!is_wrong(&shift, truth), "{fault:?} {n}: {truth:?} {shift:?}");
                    let (sx, sy) = shift.error_px();
                    pulls.extend([((shift.dx_px - truth.0) / sx).abs(), ((shift.dy_px - truth.1) / sy).abs()]);
                }
                Err(why) => {
                    println!("{fault:?} {n}: side {side}, {truth:?}: {why}");
                    lost += 1;
                }
            }
        }
        pulls.sort_by(f64::total_cmp);
        let within = pulls[(0.683 * pulls.len() as f64) as usize];
        println!("{fault:?}: lost {lost} of {all}; 68 % within {within:.2} sigma, most {:.1}", pulls[pulls.len() - 1]);
        assert!((0.6..1.6).contains(&within), "{fault:?}: {within}");
        assert!(24 * lost <= all, "{fault:?}: {lost}");
    }
}

/// The whole statistics take half a minute of a processor.
mod proof {
    #[test]
    fn many_frames_of_different_fields_have_no_shift() {
        super::different_fields(84);
    }

    #[test]
    fn many_frames_without_stars_have_no_shift() {
        super::without_stars(40);
    }

    #[test]
    fn many_true_shifts_up_to_a_third_of_the_frame_are_found_within_their_errors() {
        super::true_shifts(1);
    }
}
