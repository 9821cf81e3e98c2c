//! Trails of satellites and aircraft: the stars next to them are found and measured as on the same frame without
//! them.

use std::f64::consts::PI;

use imaging::{Camera, Frame, Measured, Pixels, StarSearch, measure};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::sky::{Psf, Sky, Trail, seen_fwhm, sigma};

/// What a frame is like.
#[derive(Debug, Clone, Copy)]
struct Field {
    width: usize,
    height: usize,
    fwhm: f64,
    stars: usize,
    level: f64,
    read_noise: f64,
    seed: u64,
}

const FIELD: Field = Field { width: 512, height: 512, fwhm: 3.9, stars: 60, level: 400.0, read_noise: 8.0, seed: 0 };

impl Field {
    fn draw(&self, trails: &[Trail]) -> (Sky, Vec<u16>) {
        let mut sky = Sky::new(self.width, self.height, self.level, self.seed);
        let noise = (self.level + self.read_noise * self.read_noise).sqrt();
        let places = sky.places(self.stars, 2.5 * self.fwhm + 2.0);
        for (x, y) in places {
            // significance from 8 to some thousands
            let significance = 8.0 * sky.rng.random_range(1e-3_f64..1.0).powf(-0.8);
            let flux = significance * noise * (4.0 * PI).sqrt() * sigma(seen_fwhm(self.fwhm));
            sky.add_star(Psf::Moffat(self.fwhm, 3.0), x, y, flux);
        }
        trails.iter().for_each(|trail| sky.add_trail(trail));
        let counts = sky.counts(300.0, self.read_noise);
        (sky, counts)
    }

    fn look(&self, counts: &[u16]) -> Measured {
        let frame = Frame::new(self.width, self.height, Pixels::U16(counts)).unwrap();
        measure(&frame, &Camera::default(), &StarSearch::default()).unwrap()
    }
}

/// What a trail does to a frame.
#[derive(Debug, Default, Clone, Copy)]
struct Harm {
    /// Detections that are no stars, more than without the trail.
    spurious: usize,
    /// Stars next to the trail without it, and with it.
    without: usize,
    with: usize,
    /// Width with the trail over that without.
    width: f64,
    /// Ellipticity with the trail less that without.
    ellipticity: f64,
    trails: usize,
    /// Whether the stars pass for trails.
    trailed: bool,
}

fn harm(field: &Field, trails: &[Trail]) -> Harm {
    let ((sky, plain), (_, spoilt)) = (field.draw(&[]), field.draw(trails));
    let (plain, spoilt) = (field.look(&plain), field.look(&spoilt));
    let near = |x: f64, y: f64, measured: &Measured| {
        measured.stars.iter().any(|s| !s.flags.cosmic && (s.x_px - x).hypot(s.y_px - y) < field.fwhm.max(2.0))
    };
    let drawn = |x: f64, y: f64| sky.stars.iter().any(|s| (s.x - x).hypot(s.y - y) < 2.0 * field.fwhm.max(2.0));
    let spurious = |measured: &Measured| measured.stars.iter().filter(|s| !drawn(s.x_px, s.y_px)).count();
    let is_apart = |x: f64, y: f64| trails.iter().all(|t| t.distance(x, y) > 3.0 * t.fwhm + 2.0 * field.fwhm);
    let mut harm = Harm { trails: spoilt.quality.trails, ..Harm::default() };
    for star in sky.stars.iter().filter(|star| is_apart(star.x, star.y)) {
        harm.without += usize::from(near(star.x, star.y, &plain));
        harm.with += usize::from(near(star.x, star.y, &plain) && near(star.x, star.y, &spoilt));
    }
    harm.spurious = spurious(&spoilt).saturating_sub(spurious(&plain));
    if harm.spurious > 2 {
        for star in spoilt.stars.iter().filter(|s| !drawn(s.x_px, s.y_px)) {
            let places = trails.iter().map(|trail| trail.along_and_across(star.x_px, star.y_px));
            println!(
                "  ({:.0}, {:.0}) significance {:.1} {:?}",
                star.x_px,
                star.y_px,
                star.significance,
                places.collect::<Vec<_>>()
            );
        }
    }
    let fwhm = |measured: &Measured| measured.quality.fwhm_px.unwrap().value;
    let ellipticity = |measured: &Measured| measured.quality.ellipticity.unwrap().value;
    harm.width = fwhm(&spoilt) / fwhm(&plain);
    harm.ellipticity = ellipticity(&spoilt) - ellipticity(&plain);
    harm.trailed = spoilt.quality.trailed;
    harm
}

/// What trails may do at most: spurious detections in each frame, and the share of the stars that is left.
struct Most(usize, f64);

const MOST: Most = Most(2, 0.98);

/// Looks at many frames of a kind; each draws its trails with its own dice.
fn judge(kind: &str, frames: u64, Most(spurious, left): Most, draw: impl Fn(&mut StdRng) -> (Field, Vec<Trail>)) {
    let (mut sum, mut worst, mut spoilt) = (Harm::default(), Harm { width: 1.0, ..Harm::default() }, 0);
    for seed in 0..frames {
        let mut rng = StdRng::seed_from_u64(1000 + seed);
        let (field, trails) = draw(&mut rng);
        let field = Field { seed, ..field };
        let harm = harm(&field, &trails);
        if harm.spurious > 2 || (harm.width - 1.0).abs() > 0.05 {
            spoilt += 1;
            println!("{kind} {seed}: {harm:?} {field:?} {trails:?}");
        }
        sum.spurious += harm.spurious;
        (sum.without, sum.with, sum.trails) =
            (sum.without + harm.without, sum.with + harm.with, sum.trails + harm.trails);
        worst.spurious = worst.spurious.max(harm.spurious);
        worst.width = if (harm.width - 1.0).abs() > (worst.width - 1.0).abs() { harm.width } else { worst.width };
        worst.trailed |= harm.trailed;
        worst.ellipticity = worst.ellipticity.max(harm.ellipticity);
    }
    println!(
        "{kind}: {frames} frames, {:.2} trails each, spurious {:.2} at most {}, stars {} of {}, width {:.3}, ellipticity +{:.3}; {spoilt} spoilt",
        sum.trails as f64 / frames as f64,
        sum.spurious as f64 / frames as f64,
        worst.spurious,
        sum.with,
        sum.without,
        worst.width,
        worst.ellipticity
    );
    assert!(!worst.trailed, "{kind}");
    assert!(worst.spurious <= spurious, "{kind}: {sum:?}, at most {}", worst.spurious);
    assert!(sum.with as f64 >= left * sum.without as f64, "{kind}: {sum:?}");
    assert!((worst.width - 1.0).abs() < 0.1 && worst.ellipticity < 0.05, "{kind}: {worst:?}");
}

/// Any place and angle, but not exactly along rows or columns: that goes with the bands.
fn anywhere(rng: &mut StdRng, field: &Field, peak: f64, fwhm: f64) -> Trail {
    let within = |rng: &mut StdRng, length: usize| rng.random_range(0.15..0.85) * length as f64;
    let (x, y) = (within(rng, field.width), within(rng, field.height));
    let angle = 0.5 * PI * f64::from(rng.random_range(0..2)) + rng.random_range(0.02..0.5 * PI - 0.02);
    Trail::new(x, y, angle, peak, fwhm)
}

#[test]
fn a_trail_as_wide_as_the_stars() {
    judge_a_trail_as_wide_as_the_stars(1);
}

fn judge_a_trail_as_wide_as_the_stars(many: u64) {
    for peak in [200.0, 2000.0, 200_000.0] {
        judge(&format!("peak {peak}"), 3 * many, MOST, |rng| (FIELD, vec![anywhere(rng, &FIELD, peak, FIELD.fwhm)]));
    }
}

#[test]
fn a_trail_that_begins_or_ends_within_the_frame() {
    judge_a_trail_that_begins_or_ends_within_the_frame(1);
}

fn judge_a_trail_that_begins_or_ends_within_the_frame(many: u64) {
    judge("ends", 4 * many, MOST, |rng| {
        let field = Field { width: 768, height: 768, stars: 90, ..FIELD };
        let mut trail = anywhere(rng, &field, 2000.0, field.fwhm);
        trail.ends.0 = rng.random_range(-300.0..-60.0);
        if rng.random_bool(0.5) {
            trail.ends.1 = rng.random_range(60.0..300.0);
        }
        (field, vec![trail])
    });
}

#[test]
fn two_trails_that_cross() {
    judge_two_trails_that_cross(1);
}

fn judge_two_trails_that_cross(many: u64) {
    judge("crossing", 3 * many, MOST, |rng| {
        (FIELD, (0..2).map(|_| anywhere(rng, &FIELD, 2000.0, FIELD.fwhm)).collect())
    });
}

#[test]
fn a_trail_that_blinks() {
    judge_a_trail_that_blinks(1);
}

fn judge_a_trail_that_blinks(many: u64) {
    judge("blinking", 4 * many, MOST, |rng| {
        let field = Field { width: 768, height: 768, stars: 90, ..FIELD };
        let trail = anywhere(rng, &field, 2000.0, field.fwhm);
        let period = (rng.random_range(60.0..200.0), rng.random_range(0.4..0.8));
        (field, vec![Trail { period: Some(period), ..trail }])
    });
}

#[test]
fn a_trail_that_is_bent() {
    judge_a_trail_that_is_bent(1);
}

fn judge_a_trail_that_is_bent(many: u64) {
    judge("bent", 2 * many, MOST, |rng| {
        let field = Field { width: 768, height: 768, stars: 90, ..FIELD };
        let trail = anywhere(rng, &field, 2000.0, field.fwhm);
        (field, vec![Trail { bend: rng.random_range(-1e-4..1e-4), ..trail }])
    });
}

#[test]
fn a_trail_out_of_focus() {
    judge_a_trail_out_of_focus(1);
}

fn judge_a_trail_out_of_focus(many: u64) {
    judge("wide", 2 * many, Most(8, 0.97), |rng| {
        let field = Field { width: 1024, height: 1024, stars: 120, ..FIELD };
        let fwhm = rng.random_range(8.0..30.0);
        (field, vec![anywhere(rng, &field, 1000.0, fwhm)])
    });
}

/// Four times as many frames: the whole statistics take a minute of a processor.
mod proof {
    #[test]
    fn many_trails_as_wide_as_the_stars() {
        super::judge_a_trail_as_wide_as_the_stars(4);
    }

    #[test]
    fn many_trails_that_begin_or_end_within_the_frame() {
        super::judge_a_trail_that_begins_or_ends_within_the_frame(4);
    }

    #[test]
    fn many_trails_that_cross() {
        super::judge_two_trails_that_cross(4);
    }

    #[test]
    fn many_trails_that_blink() {
        super::judge_a_trail_that_blinks(4);
    }

    #[test]
    fn many_trails_that_are_bent() {
        super::judge_a_trail_that_is_bent(4);
    }

    #[test]
    fn many_trails_out_of_focus() {
        super::judge_a_trail_out_of_focus(4);
    }
}
