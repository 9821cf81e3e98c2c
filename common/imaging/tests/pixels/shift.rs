//! Shifts between pairs of frames that another program drew, and between frames drawn here.

use std::path::PathBuf;

use imaging::projection::from_projections;
use imaging::shift::from_stars;
use imaging::{Camera, Clean, Frame, NoShift, Pixels, StarSearch, measure};

use crate::fits;
use crate::sky::{Psf, Sky, mean_and_spread, sigma};

/// Name, and true shift (check - reference), px.
const PAIRS: [(&str, f64, f64); 4] =
    [("p05_vlarge", 17.8, -9.15), ("p07_faint", -2.15, 0.85), ("p08_hot", 1.6, -1.1), ("p12_seeing_chg", 0.9, -0.4)];

fn read(name: &str) -> fits::Image {
    fits::read(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.fits.gz"))).unwrap()
}

#[test]
fn golden_pairs_are_registered_by_stars_and_by_projections() {
    for (name, dx, dy) in PAIRS {
        let (reference, check) = (read(&format!("{name}_ref")), read(&format!("{name}_check")));
        let frames = [&reference, &check].map(|image| Frame::new(image.width, image.height, image.pixels()).unwrap());
        let stars = frames.map(|frame| measure(&frame, &Camera::default(), &StarSearch::default()).unwrap().stars);
        let shift = from_stars(&stars[0], &stars[1], reference.width, reference.height).unwrap();
        let clean = frames.map(|frame| Clean::new(&frame, &Camera::default(), Some(4.0)).unwrap());
        let projected = from_projections(&clean[0], &clean[1]).unwrap();
        let off = |found: &imaging::Shift| (found.dx_px - dx, found.dy_px - dy);
        println!(
            "{name}: stars {:?} +- {:?} of {}, projections {:?}",
            off(&shift),
            shift.error_px(),
            shift.stars,
            off(&projected)
        );
        let error = shift.error_px();
        assert!(error.0 < 0.05 && error.1 < 0.05, "{name}: {shift:?}");
        assert!(off(&shift).0.abs() < 3.0 * error.0 && off(&shift).1.abs() < 3.0 * error.1, "{name}: {shift:?}");
        assert!(off(&projected).0.abs() < 0.3 && off(&projected).1.abs() < 0.3, "{name}: {projected:?}");
    }
}

/// What is asked of a guide measurement: an error below 0.02 px with 20 stars of signal-to-noise 50, at all phases
/// between the pixels.
#[test]
fn a_guide_measurement_is_good_to_a_fiftieth_of_a_pixel() {
    let fwhm = 4.0;
    let places = Sky::new(512, 512, 0.0, 1).places(20, 40.0);
    let frame = |dx: f64, dy: f64, seed: u64| {
        let mut sky = Sky::new(512, 512, 300.0, seed);
        // S/N 50 in a sky of 300 e- and 6 e- read noise
        places.iter().for_each(|(x, y)| sky.add_star(Psf::Gaussian(sigma(fwhm)), x + dx, y + dy, 7800.0));
        sky.counts(300.0, 6.0)
    };
    let stars = |counts: &[u16]| {
        let frame = Frame::new(512, 512, Pixels::U16(counts)).unwrap();
        measure(&frame, &Camera::default(), &StarSearch { fwhm_px: Some(4.1), ..StarSearch::default() }).unwrap().stars
    };
    let reference = stars(&frame(0.0, 0.0, 1));
    let snr = reference.iter().map(|s| s.snr).sum::<f64>() / reference.len() as f64;
    assert!((40.0..60.0).contains(&snr), "S/N {snr}");
    let (mut off, mut pulls) = (Vec::new(), Vec::new());
    for seed in 0..100_u64 {
        let (dx, dy) = ((seed % 10) as f64 * 0.1 + 1.0, (seed / 10) as f64 * 0.1 - 1.5);
        let shift = from_stars(&reference, &stars(&frame(dx, dy, seed + 2)), 512, 512).unwrap();
        assert_eq!(shift.stars, 20, "seed {seed}");
        off.extend([shift.dx_px - dx, shift.dy_px - dy]);
        pulls.extend([(shift.dx_px - dx) / shift.error_px().0, (shift.dy_px - dy) / shift.error_px().1]);
    }
    let (bias, spread) = mean_and_spread(&off);
    println!("guide measurement: bias {bias:.4} px, rms {spread:.4} px, pulls {:?}", mean_and_spread(&pulls));
    assert!(spread < 0.02 && bias.abs() < 0.015, "bias {bias}, rms {spread} px");
    assert!((0.6..1.3).contains(&mean_and_spread(&pulls).1), "{:?}", mean_and_spread(&pulls));
}

#[test]
fn clouds_and_other_shapes_give_no_shift() {
    let clean = |width: usize, seed: u64| {
        let counts = Sky::new(width, 300, 200.0, seed).counts(300.0, 5.0);
        Clean::new(&Frame::new(width, 300, Pixels::U16(&counts)).unwrap(), &Camera::default(), None).unwrap()
    };
    for seed in 0..20 {
        let refused = from_projections(&clean(400, seed), &clean(400, seed + 100));
        assert!(matches!(refused, Err(NoShift::NoPeak { .. })), "seed {seed}: {refused:?}");
    }
    assert_eq!(from_projections(&clean(400, 1), &clean(300, 1)).unwrap_err(), NoShift::Shapes(400, 300, 300, 300));
    let black = vec![100_u16; 90_000];
    let flat = Clean::new(&Frame::new(300, 300, Pixels::U16(&black)).unwrap(), &Camera::default(), None).unwrap();
    assert!(from_projections(&flat, &flat).is_err());
}
