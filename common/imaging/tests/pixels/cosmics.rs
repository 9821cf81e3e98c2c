//! Frames with hundreds of cosmic rays: the width is that of the stars, whatever was expected, and no width is made of rays.

use std::f64::consts::PI;

use imaging::{Camera, Frame, Measured, Pixels, StarSearch, measure};
use rand::RngExt;

use crate::sky::{Psf, Sky, seen_fwhm};

const SIDE: usize = 640;

/// Stars, and rays: points and tracks of up to 12 px at any angle, brighter than most stars.
fn frame(stars: usize, fwhm: f64, rays: usize, seed: u64) -> Vec<u16> {
    let mut sky = Sky::new(SIDE, SIDE, 400.0, seed);
    for (x, y) in sky.places(stars, 16.0) {
        let flux = sky.rng.random_range(4_000.0..40_000.0);
        sky.add_star(Psf::Moffat(fwhm, 3.0), x, y, flux);
    }
    let mut counts = sky.counts(300.0, 8.0);
    for _ in 0..rays {
        let (x, y) = (sky.rng.random_range(15.0..SIDE as f64 - 15.0), sky.rng.random_range(15.0..SIDE as f64 - 15.0));
        let (angle, length) = (sky.rng.random_range(0.0..PI), sky.rng.random_range(0.0_f64..12.0));
        let charge = 10_f64.powf(sky.rng.random_range(2.8..4.3));
        for step in 0..=length as usize {
            let (column, row) = (x + step as f64 * angle.cos(), y + step as f64 * angle.sin());
            let at = row.round() as usize * SIDE + column.round() as usize;
            counts[at] = (f64::from(counts[at]) + charge).min(65_535.0) as u16;
        }
    }
    counts
}

fn look(counts: &[u16], fwhm_px: Option<f32>) -> Measured {
    let frame = Frame::new(SIDE, SIDE, Pixels::U16(counts)).unwrap();
    measure(&frame, &Camera::default(), &StarSearch { fwhm_px, ..StarSearch::default() }).unwrap()
}

#[test]
fn three_hundred_rays_do_not_change_the_width_whatever_was_expected() {
    for (seed, (fwhm, stars)) in [(3.9, 60), (2.6, 60), (6.0, 40), (3.9, 35)].into_iter().enumerate() {
        let counts = frame(stars, fwhm, 300, seed as u64);
        for expected in [None, Some(fwhm as f32), Some(0.0), Some(0.2), Some(1.2), Some(f32::NAN)] {
            let quality = look(&counts, expected).quality;
            let width = quality.fwhm_px.unwrap();
            println!("{stars} stars of {fwhm} px, expected {expected:?}: {width:?}, {} stars", quality.stars);
            assert!((width.value / seen_fwhm(fwhm) - 1.0).abs() < 0.1, "{fwhm} px, expected {expected:?}: {quality:?}");
            assert!(!quality.trailed);
        }
    }
}

#[test]
fn rays_alone_have_no_width() {
    for seed in 0..6 {
        let quality = look(&frame(0, 3.0, 300, 20 + seed), Some(3.9)).quality;
        assert!(quality.fwhm_px.is_none_or(|width| width.value >= 1.5), "{quality:?}");
    }
}

#[test]
fn the_width_that_is_handed_on_does_not_feed_itself() {
    hand_on(2);
}

/// So many frames of each kind, one after the other.
fn hand_on(each: usize) {
    let mut handed_on = None;
    for n in 0..4 * each {
        // good, then rays, then a true change of focus among rays, then good again
        let (fwhm, rays) = [(3.9, 0), (3.9, 300), (6.0, 300), (3.9, 0)][n / each];
        let quality = look(&frame(50, fwhm, rays, 40 + n as u64), handed_on).quality;
        let width = quality.fwhm_px.unwrap().value;
        assert!((width / seen_fwhm(fwhm) - 1.0).abs() < 0.1, "frame {n}, expected {handed_on:?}: {quality:?}");
        handed_on = Some(width as f32);
    }
}

mod proof {
    /// The whole night takes ten seconds of a processor.
    #[test]
    fn the_width_that_is_handed_on_never_feeds_itself() {
        super::hand_on(6);
    }
}
