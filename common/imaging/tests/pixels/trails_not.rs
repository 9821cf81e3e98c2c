//! What looks like a trail of a satellite and is none: it stays in the frame.

use std::f64::consts::PI;

use imaging::{Camera, Frame, Measured, Pixels, StarSearch, measure};

use crate::sky::{Psf, Sky, sigma};

const SIDE: usize = 768;
const FWHM: f64 = 3.5;

/// A frame with round stars, before noise.
fn field(seed: u64, stars: usize) -> Sky {
    let mut sky = Sky::new(SIDE, SIDE, 400.0, seed);
    for (x, y) in sky.places(stars, 14.0) {
        sky.add_star(Psf::Moffat(FWHM, 3.0), x, y, 20_000.0);
    }
    sky
}

fn look(counts: &[u16]) -> Measured {
    let frame = Frame::new(SIDE, SIDE, Pixels::U16(counts)).unwrap();
    measure(&frame, &Camera::default(), &StarSearch::default()).unwrap()
}

fn found(sky: &Sky, measured: &Measured) -> usize {
    let near = |x: f64, y: f64| measured.stars.iter().any(|s| (s.x_px - x).hypot(s.y_px - y) < FWHM);
    sky.stars.iter().filter(|star| near(star.x, star.y)).count()
}

#[test]
fn a_row_of_stars_is_no_trail() {
    for (seed, apart) in [9.0, 11.0, 16.0, 30.0].into_iter().enumerate() {
        let mut sky = field(seed as u64, 40);
        let (sin, cos) = (0.3 + 0.4 * seed as f64).sin_cos();
        for n in 0..20 {
            let t = apart * f64::from(n);
            sky.add_star(
                Psf::Moffat(FWHM, 3.0),
                200.0 + t * cos,
                60.0 + t * sin,
                15_000.0 + 1_000.0 * f64::from(n % 7),
            );
        }
        let counts = sky.counts(300.0, 8.0);
        let measured = look(&counts);
        assert_eq!(measured.quality.trails, 0, "{apart} px apart");
        let found = found(&sky, &measured);
        assert!(found + 3 >= sky.stars.len(), "{apart} px apart: {found} of {}", sky.stars.len());
    }
}

#[test]
fn crowded_and_plain_fields_have_no_trails() {
    for (seed, stars) in [10, 150, 600].into_iter().enumerate() {
        for fwhm in [1.5, 4.0] {
            let mut sky = Sky::new(SIDE, SIDE, 400.0, 50 + seed as u64);
            for (n, (x, y)) in sky.places(stars, 2.0 * fwhm).into_iter().enumerate() {
                sky.add_star(Psf::Moffat(fwhm, 2.5), x, y, 3_000.0 * fwhm * 1.5_f64.powi(n as i32 % 13));
            }
            let counts = sky.counts(300.0, 8.0);
            assert_eq!(look(&counts).quality.trails, 0, "{stars} stars of {fwhm} px");
        }
    }
}

#[test]
fn galaxies_are_no_trails() {
    for (seed, (long, wide)) in [(60.0, 6.0), (40.0, 3.0), (90.0, 40.0), (25.0, 2.0)].into_iter().enumerate() {
        let mut sky = field(seed as u64, 40);
        let (sin, cos) = (0.2 + 0.7 * seed as f64).sin_cos();
        // an exponential disc from the side
        sky.add_light(|x, y| {
            let (t, d) = ((x - 380.0) * cos + (y - 390.0) * sin, (y - 390.0) * cos - (x - 380.0) * sin);
            5000.0 * (-(t / long).hypot(d / wide)).exp()
        });
        let counts = sky.counts(300.0, 8.0);
        assert_eq!(look(&counts).quality.trails, 0, "{long} px by {wide} px");
    }
}

#[test]
fn spikes_and_bleeding_of_bright_stars_are_no_trails() {
    for (seed, turn) in [0.0, 0.4, 0.25 * PI].into_iter().enumerate() {
        let mut sky = field(seed as u64, 40);
        let (x0, y0) = (350.3, 401.7);
        sky.add_star(Psf::Moffat(FWHM, 2.5), x0, y0, 2e7);
        for n in 0..2 {
            let (sin, cos) = (turn + 0.5 * PI * f64::from(n)).sin_cos();
            sky.add_light(|x, y| {
                let (t, d) = ((x - x0) * cos + (y - y0) * sin, (y - y0) * cos - (x - x0) * sin);
                30_000.0 * (-0.5 * (d / sigma(FWHM)).powi(2)).exp() / (1.0 + (t / 12.0).powi(2))
            });
        }
        let counts = sky.counts(300.0, 8.0);
        assert_eq!(look(&counts).quality.trails, 0, "spikes at {turn} rad");
        let mut counts = counts;
        for y in 250..560 {
            for x in 349..353 {
                counts[y * SIDE + x] = 65_535;
            }
        }
        assert_eq!(look(&counts).quality.trails, 0, "a bleeding column and spikes at {turn} rad");
    }
}

/// Longer ones may pass for satellites: docs/imaging.md.
#[test]
fn stars_that_are_all_drawn_out_are_no_trails_of_satellites() {
    for (seed, length) in [5.0, 12.0, 25.0].into_iter().enumerate() {
        for stars in [6, 25] {
            let mut sky = Sky::new(SIDE, SIDE, 400.0, 80 + seed as u64);
            let (dy, dx) = (0.35 + 0.5 * seed as f64).sin_cos();
            for (x, y) in sky.places(stars, 60.0) {
                sky.add_star(Psf::Trail(sigma(FWHM), length * dx, length * dy), x, y, 4_000.0 * length);
            }
            let counts = sky.counts(300.0, 8.0);
            let measured = look(&counts);
            let quality = &measured.quality;
            assert_eq!(quality.trails, 0, "{stars} stars of {length} px");
            assert!(quality.trailed || length < 6.0, "{stars} stars of {length} px: {quality:?}");
            // where trails are longer than some widths, a place on them is none of the star
            assert_eq!(quality.trail_px.is_some(), length > 20.0, "{stars} stars of {length} px: {quality:?}");
            if let Some(trail_px) = quality.trail_px {
                assert!((trail_px / length - 1.0).abs() < 0.2, "{stars} stars of {length} px: {quality:?}");
                assert!(measured.stars.iter().all(|star| star.x_error_px.hypot(star.y_error_px) > 0.2 * length));
            }
        }
    }
}
