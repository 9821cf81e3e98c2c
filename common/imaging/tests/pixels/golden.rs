//! Frames that another program drew (`tests/golden/README.md`): what is found against what was put there.

use std::path::PathBuf;

use imaging::{Camera, Frame, Measured, Star, StarSearch, measure};

use crate::fits;

/// A star of the truth: place (px) and whole flux (e-, here ADU too).
#[derive(Debug, Clone, Copy)]
struct Truth {
    x: f64,
    y: f64,
    flux: f64,
}

/// Share of the light that is found where nothing is lost.
const ALL: std::ops::Range<f64> = 0.96..1.04;

struct Golden {
    name: &'static str,
    width: usize,
    height: usize,
    stars: Vec<Truth>,
    fwhm_px: f64,
    measured: Measured,
}

fn golden(name: &'static str) -> Golden {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let image = fits::read(&folder.join(format!("{name}.fits.gz"))).unwrap();
    let table = std::fs::read_to_string(folder.join(format!("{name}.csv"))).unwrap();
    let fwhm_px = table.split_once("fwhm_px=").unwrap().1.split_once(',').unwrap().0.parse().unwrap();
    let star = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
        Truth { x: numbers[0], y: numbers[1], flux: numbers[2] }
    };
    let stars = table.lines().skip(1).map(star).collect();
    let frame = Frame::new(image.width, image.height, image.pixels()).unwrap();
    let measured = measure(&frame, &Camera::default(), &StarSearch::default()).unwrap();
    println!("{name}: {:?}", measured.quality);
    Golden { name, width: image.width, height: image.height, stars, fwhm_px, measured }
}

impl Golden {
    /// Rough significance of a star that stands alone.
    fn significance(&self, star: &Truth) -> f64 {
        let width = (self.fwhm_px.powi(2) + 0.46).sqrt() / 2.354_82;
        0.75 * star.flux / (self.measured.quality.noise_adu * (4.0 * std::f64::consts::PI).sqrt() * width)
    }

    /// Stars well inside, bright enough, and without a neighbour that disturbs them, each with what was found.
    fn clear(&self, least: f64) -> Vec<(Truth, Option<Star>)> {
        let inside = |s: &&Truth| {
            (6.0..self.width as f64 - 7.0).contains(&s.x) && (6.0..self.height as f64 - 7.0).contains(&s.y)
        };
        let alone = |s: &&Truth| {
            let disturbs = |o: &Truth| {
                let apart = (o.x - s.x).hypot(o.y - s.y);
                apart > 0.0 && apart < 5.0 * self.fwhm_px && o.flux > 0.05 * s.flux
                    || apart > 0.0 && apart < 25.0 && o.flux > 20.0 * s.flux
            };
            !self.stars.iter().any(disturbs)
        };
        let chosen = self.stars.iter().filter(inside).filter(alone).filter(|s| self.significance(s) > least);
        chosen.map(|s| (*s, self.near(s.x, s.y, self.fwhm_px))).collect()
    }

    fn near(&self, x: f64, y: f64, reach: f64) -> Option<Star> {
        let apart = |s: &Star| (s.x_px - x).hypot(s.y_px - y);
        let nearest = self.measured.stars.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        nearest.filter(|s| apart(s) < reach).copied()
    }

    /// Unflagged detections where nothing was drawn.
    fn false_stars(&self) -> Vec<Star> {
        let drawn = |s: &Star| self.stars.iter().any(|t| (t.x - s.x_px).hypot(t.y - s.y_px) < 1.5 * self.fwhm_px + 2.0);
        self.measured.stars.iter().filter(|s| !s.flags.cosmic && !drawn(s)).copied().collect()
    }

    /// All that holds for a frame of round stars; `light` is the share of it that passed the optics.
    fn judge(&self, fewest: usize, light: std::ops::Range<f64>) {
        let name = self.name;
        let clear = self.clear(9.0);
        assert!(clear.len() >= fewest, "{name}: only {} clear stars", clear.len());
        let missed: Vec<_> = clear.iter().filter(|(_, found)| found.is_none()).collect();
        assert!(missed.is_empty(), "{name}: missed {missed:?}");
        let found: Vec<(Truth, Star)> = clear.iter().filter_map(|(t, s)| s.map(|s| (*t, s))).collect();
        for (truth, star) in &found {
            if !star.flags.saturated {
                let (x, y) = ((star.x_px - truth.x) / star.x_error_px, (star.y_px - truth.y) / star.y_error_px);
                assert!(x.abs() < 4.5 && y.abs() < 4.5, "{name}: {truth:?} {star:?}");
            }
        }
        let mut ratios: Vec<f64> = found
            .iter()
            .filter(|(_, s)| !s.flags.saturated && s.snr > 20.0)
            .map(|(t, s)| s.flux_adu / t.flux)
            .collect();
        ratios.sort_by(f64::total_cmp);
        let ratio = ratios[ratios.len() / 2];
        println!("{name}: {} of {} clear stars, flux ratio {ratio:.3}, {ratios:?}", found.len(), clear.len());
        assert!(light.contains(&ratio), "{name}: flux ratio {ratio}");
        let false_stars = self.false_stars();
        assert!(false_stars.is_empty(), "{name}: {false_stars:#?}");
        let width = self.measured.quality.fwhm_px.unwrap();
        // the pixel adds its own width to an undersampled star
        let seen = (self.fwhm_px.powi(2) + 2.354_82_f64.powi(2) / 12.0).sqrt();
        println!("{name}: fwhm {:.3} +- {:.3}, drawn {:.3}, seen {seen:.3} px", width.value, width.error, self.fwhm_px);
        assert!(width.value > 0.95 * self.fwhm_px && width.value < 1.05 * seen, "{name}: {width:?}");
        assert!(!self.measured.quality.trailed, "{name}");
    }
}

#[test]
fn a_plain_field() {
    golden("f01_nominal").judge(5, ALL);
}

#[test]
fn an_undersampled_field() {
    golden("f02_wide_undersampled").judge(20, ALL);
}

#[test]
fn a_noisy_field() {
    // the camera cut off the lower half of its read noise: the sky's mean is not what stars stand on
    golden("f04_noisy").judge(2, 0.88..1.04);
}

#[test]
fn a_field_with_hot_and_dead_pixels() {
    let golden = golden("f05_hot_cold");
    golden.judge(5, ALL);
    // 0.2 % hot; dead pixels lie only two sigma below this dark sky
    let share = golden.measured.quality.defect_fraction;
    assert!((0.0019..0.0025).contains(&share), "{share}");
}

#[test]
fn a_field_on_a_gradient_with_vignetting() {
    // 12 % of vignetting in the corners
    golden("f08_gradient").judge(5, 0.85..1.0);
}

#[test]
fn a_field_with_a_saturated_star() {
    let golden = golden("f09_saturated");
    golden.judge(5, ALL);
    let brightest = golden.stars.iter().max_by(|a, b| a.flux.total_cmp(&b.flux)).unwrap();
    let star = golden.near(brightest.x, brightest.y, 4.0).unwrap();
    assert!(star.flags.saturated, "{star:?}");
    assert!((star.x_px - brightest.x).hypot(star.y_px - brightest.y) < 0.3, "{star:?} {brightest:?}");
    assert!(golden.measured.quality.saturated_fraction > 0.0);
}

#[test]
fn a_field_of_two_stars() {
    let golden = golden("f11_two_stars");
    golden.judge(2, ALL);
    assert_eq!(golden.measured.quality.stars, 2);
}

#[test]
fn a_rectangular_binned_field() {
    golden("f15_rect_bin2").judge(8, ALL);
}

#[test]
fn a_trailed_field() {
    let golden = golden("f16_trailed");
    // places are those of the shutter's opening; the trail is 6.79 px long in x and 2.91 px in y
    let middles = golden.clear(15.0).into_iter().map(|(t, _)| (t, golden.near(t.x + 3.394, t.y + 1.454, 2.0)));
    let middles: Vec<_> = middles.collect();
    assert!(middles.len() >= 5 && middles.iter().all(|(_, star)| star.is_some()), "{middles:?}");
    let quality = &golden.measured.quality;
    assert!(quality.ellipticity.unwrap().value > 0.3, "{quality:?}");
    let direction = 2.908_9_f64.atan2(6.787_4).to_degrees();
    assert!((quality.elongation_deg.unwrap() - direction).abs() < 4.0, "{quality:?} {direction}");
}
