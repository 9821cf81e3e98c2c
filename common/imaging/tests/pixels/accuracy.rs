//! Places, fluxes, widths and their errors against what was drawn.

use imaging::{Camera, Frame, Measured, Pixels, Star, StarSearch, measure};
use rand::RngExt;

use crate::sky::{Drawn, Psf, Sky, mean_and_spread, seen_fwhm, sigma};

fn look(width: usize, height: usize, counts: &[u16]) -> Measured {
    let frame = Frame::new(width, height, Pixels::U16(counts)).unwrap();
    measure(&frame, &Camera::default(), &StarSearch::default()).unwrap()
}

/// Each drawn star with the one that was found there.
fn pairs<'a>(sky: &'a Sky, measured: &'a Measured, reach: f64) -> Vec<(&'a Drawn, &'a Star)> {
    let near = |drawn: &Drawn, star: &Star| (drawn.x - star.x_px).hypot(drawn.y - star.y_px);
    let found = |drawn| measured.stars.iter().min_by(|a, b| near(drawn, a).total_cmp(&near(drawn, b)));
    sky.stars.iter().filter_map(|d| found(d).filter(|s| near(d, s) < reach).map(|s| (d, s))).collect()
}

#[test]
fn places_and_fluxes_are_unbiased_and_their_errors_true() {
    are_unbiased(8);
}

fn are_unbiased(frames: u64) {
    let cases: [(Psf, f64); 4] = [
        (Psf::Gaussian(sigma(1.8)), 1.8),
        (Psf::Gaussian(sigma(4.0)), 4.0),
        (Psf::Moffat(3.5, 2.5), 3.5),
        (Psf::Gaussian(sigma(8.0)), 8.0),
    ];
    for (psf, fwhm) in cases {
        let (mut x, mut y, mut flux, mut pull, mut flux_pull) = (vec![], vec![], vec![], vec![], vec![]);
        for seed in 0..frames {
            let mut sky = Sky::new(512, 512, 300.0, seed);
            for (px, py) in sky.places(30, 10.0 * fwhm.min(5.0)) {
                let bright = 3000.0 * fwhm * 10_f64.powf(sky.rng.random_range(-0.3..1.3));
                sky.add_star(psf, px, py, bright);
            }
            let counts = sky.counts(500.0, 6.0);
            let measured = look(512, 512, &counts);
            for (drawn, star) in pairs(&sky, &measured, 1.5) {
                x.push(star.x_px - drawn.x);
                y.push(star.y_px - drawn.y);
                pull.push((star.x_px - drawn.x) / star.x_error_px);
                pull.push((star.y_px - drawn.y) / star.y_error_px);
                flux.push(star.flux_adu / drawn.flux - 1.0);
                flux_pull.push((star.flux_adu - drawn.flux) / star.flux_error_adu);
            }
        }
        let (bias_x, bias_y) = (mean_and_spread(&x).0, mean_and_spread(&y).0);
        let (pull_mean, pull_spread) = mean_and_spread(&pull);
        let (flux_bias, _) = mean_and_spread(&flux);
        println!(
            "{psf:?}: {} stars, bias {bias_x:.4} {bias_y:.4} px, pull {pull_mean:.3} +- {pull_spread:.3}, flux {:.2} %, pull {:.2}",
            x.len(),
            100.0 * flux_bias,
            mean_and_spread(&flux_pull).1
        );
        assert!(x.len() as u64 > 13 * frames, "{psf:?}: {} stars", x.len());
        assert!(bias_x.abs() < 0.005 && bias_y.abs() < 0.005, "{psf:?}: {bias_x} {bias_y}");
        assert!(pull_mean.abs() < 0.1 && (0.6..1.15).contains(&pull_spread), "{psf:?}: {pull_mean} {pull_spread}");
        assert!(flux_bias.abs() < 0.03, "{psf:?}: {flux_bias}");
    }
}

#[test]
fn a_centroid_has_no_error_that_depends_on_the_pixel_phase() {
    for (psf, limit) in
        [(Psf::Gaussian(sigma(1.5)), 0.02), (Psf::Gaussian(sigma(4.0)), 0.003), (Psf::Moffat(3.0, 2.5), 0.005)]
    {
        let mut sky = Sky::new(720, 720, 100.0, 5);
        for n in 0..100 {
            let phase = (f64::from(n % 10) / 10.0, f64::from(n / 10) / 10.0);
            // not in rows and columns: those would be taken for bands
            let off = (f64::from(n * 37 % 41) - 20.0, f64::from(n * 23 % 43) - 21.0);
            let (x, y) = (60.0 + 65.0 * f64::from(n % 10) + off.0, 60.0 + 65.0 * f64::from(n / 10) + off.1);
            let (x, y) = (x + phase.0, y + phase.1);
            sky.add_star(psf, x, y, 1e5);
        }
        let pixels: Vec<f32> =
            sky.light.iter().enumerate().map(|(n, l)| (*l + ((n * 7919) % 13) as f64 * 0.1) as f32).collect();
        let frame = Frame::new(720, 720, Pixels::F32(&pixels)).unwrap();
        let measured = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap();
        let found = pairs(&sky, &measured, 1.0);
        let is_found = |d: &Drawn| found.iter().any(|(other, _)| (other.x, other.y) == (d.x, d.y));
        let missed: Vec<&Drawn> = sky.stars.iter().filter(|d| !is_found(d)).collect();
        assert!(missed.is_empty(), "{psf:?}: {missed:?}");
        let worst = found.iter().map(|(d, s)| (d.x - s.x_px).hypot(d.y - s.y_px)).fold(0.0, f64::max);
        println!("{psf:?}: worst {worst:.4} px");
        assert!(worst < limit, "{psf:?}: {worst} px");
    }
}

#[test]
fn stars_sharper_than_hot_pixels_are_not_taken_for_them() {
    let mut sky = Sky::new(400, 400, 200.0, 21);
    for (x, y) in sky.places(150, 12.0) {
        sky.add_star(Psf::Gaussian(sigma(0.7)), x, y, 5000.0);
    }
    let counts = sky.counts(300.0, 5.0);
    let measured = look(400, 400, &counts);
    assert!(measured.quality.fwhm_px.unwrap().value < 1.5);
    let found = pairs(&sky, &measured, 0.5);
    assert!(found.len() >= 148 && measured.quality.defect_fraction == 0.0, "{} {:?}", found.len(), measured.quality);
    let ratios: Vec<f64> = found.iter().map(|(drawn, star)| star.flux_adu / drawn.flux).collect();
    assert!((mean_and_spread(&ratios).0 - 1.0).abs() < 0.1, "{:?}", mean_and_spread(&ratios));
}

#[test]
fn the_width_is_measured_whatever_was_expected() {
    for fwhm in [1.5, 2.5, 4.0, 6.0, 9.0, 12.0] {
        for (psf, truth) in [(Psf::Gaussian(sigma(fwhm)), seen_fwhm(fwhm)), (Psf::Moffat(fwhm, 2.5), seen_fwhm(fwhm))] {
            let mut sky = Sky::new(640, 640, 200.0, 11);
            for (x, y) in sky.places(25, 50.0) {
                sky.add_star(psf, x, y, 20_000.0 * fwhm);
            }
            let counts = sky.counts(300.0, 5.0);
            let measured = look(640, 640, &counts);
            let width = measured.quality.fwhm_px.unwrap();
            println!("{psf:?}: seen {truth:.3}, measured {:.3} +- {:.3} px", width.value, width.error);
            // the pixel widens a narrow Moffat by more than it does a Gaussian
            let tolerance = if fwhm < 2.0 { 0.1 } else { 0.05 };
            assert!((width.value / truth - 1.0).abs() < tolerance, "{psf:?}: {width:?}, drawn {truth}");
            let round = measured.quality.ellipticity.unwrap().value;
            assert!(round < 0.06, "{psf:?}: ellipticity {round}");
            assert!(!measured.quality.trailed);
        }
    }
}

#[test]
fn trailed_stars_are_reported_with_their_direction() {
    let mut sky = Sky::new(640, 640, 200.0, 3);
    for (x, y) in sky.places(20, 60.0) {
        sky.add_star(Psf::Trail(sigma(3.0), 9.0, -5.0), x, y, 40_000.0);
    }
    let counts = sky.counts(300.0, 5.0);
    let measured = look(640, 640, &counts);
    let quality = &measured.quality;
    assert!(quality.trailed, "{quality:?}");
    let direction = (-5.0_f64).atan2(9.0).to_degrees();
    assert!((quality.elongation_deg.unwrap() - direction).abs() < 3.0, "{quality:?}");
    for drawn in &sky.stars {
        let there = measured.stars.iter().filter(|s| (s.x_px - drawn.x).hypot(s.y_px - drawn.y) < 10.0).count();
        assert_eq!(there, 1, "one trail is one star: {drawn:?}");
    }
}

#[test]
fn saturated_and_blended_stars_cosmic_rays_and_the_edge_are_flagged() {
    let mut sky = Sky::new(512, 512, 200.0, 8);
    let psf = Psf::Gaussian(sigma(4.0));
    for (x, y) in [(100.0, 100.0), (300.2, 90.0), (400.0, 300.0), (90.0, 400.0), (200.0, 200.0)] {
        sky.add_star(psf, x, y, 30_000.0);
    }
    sky.add_star(psf, 408.0, 300.0, 12_000.0); // blended with (400, 300)
    sky.add_star(psf, 250.0, 450.0, 4e6); // saturated
    sky.add_star(psf, 510.0, 222.0, 30_000.0); // on the edge
    let mut counts = sky.counts(300.0, 5.0);
    for (x, y) in [(150, 300), (151, 301), (152, 302), (150, 301), (151, 302), (153, 303)] {
        counts[y * 512 + x] = 9000; // a ray that is no single pixel
    }
    let measured = look(512, 512, &counts);
    let words = |x: f64, y: f64| {
        let star = measured.stars.iter().find(|s| (s.x_px - x).hypot(s.y_px - y) < 3.0);
        star.unwrap_or_else(|| panic!("no star at {x} {y}")).flags.words()
    };
    assert_eq!(words(100.0, 100.0), Vec::<&str>::new());
    assert_eq!(words(400.0, 300.0), ["blended"]);
    assert_eq!(words(408.0, 300.0), ["blended"]);
    assert!(words(250.0, 450.0).contains(&"saturated"));
    assert_eq!(words(510.0, 222.0), ["edge"]);
    if let Some(ray) = measured.stars.iter().find(|s| (s.x_px - 151.0).hypot(s.y_px - 301.5) < 3.0) {
        assert!(ray.flags.cosmic || ray.flags.trailed, "{ray:?}");
    }
    assert!(measured.quality.saturated_fraction > 0.0);
    assert_eq!(measured.stars.iter().filter(|s| s.flags.none()).count(), 4, "{:?}", measured.stars);
}

#[test]
fn stars_clipped_below_the_greatest_count_are_saturated_too() {
    let mut sky = Sky::new(400, 400, 200.0, 9);
    for (n, (x, y)) in sky.places(12, 40.0).into_iter().enumerate() {
        sky.add_star(Psf::Gaussian(sigma(4.0)), x, y, if n < 4 { 900_000.0 } else { 20_000.0 });
    }
    // a camera of 12 bits whose counts are stored in 16
    let counts: Vec<u16> = sky.counts(300.0, 5.0).iter().map(|value| (*value).min(4095)).collect();
    let measured = look(400, 400, &counts);
    assert_eq!(measured.stars.iter().filter(|s| s.flags.saturated).count(), 4);
}

mod proof {
    /// The whole statistics take five seconds of a processor.
    #[test]
    fn places_and_fluxes_of_many_frames_are_unbiased_and_their_errors_true() {
        super::are_unbiased(30);
    }
}
