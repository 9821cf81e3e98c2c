//! Frames that a roof or trees hide in part, and frames whose stars are drawn out.

use std::time::Instant;

use imaging::solve::{Detected, at_epoch};
use imaging::{Camera, Frame, Measured, NoSolution, Pixels, Solution, StarSearch, measure, solve};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::drawn::{DrawnFrame, EPOCHS, Kind, PLAIN, draw, normal, star};
use crate::sky::{Psf, Sky, sigma};

/// Which side is hidden: the direction in which the open part lies, deg from +x to +y.
const OPEN_TO_DEG: [f64; 5] = [0.0, 180.0, -90.0, 45.0, -120.0];

/// What hides a part of a square frame.
#[derive(Clone, Copy)]
struct Roof {
    /// The open side's direction.
    to: (f64, f64),
    /// Its edge, px from the centre along that direction.
    edge_px: f64,
}

impl Roof {
    /// One that leaves this share of the frame open.
    fn leaving(share: f64, open_to_deg: f64, side: usize) -> Self {
        let (sin, cos) = open_to_deg.to_radians().sin_cos();
        let half = 0.5 * side as f64;
        let cells = || (0..10_000).map(|n| (f64::from(n % 100) / 50.0 - 0.99, f64::from(n / 100) / 50.0 - 0.99));
        let mut along: Vec<f64> = cells().map(|(x, y)| half * (x * cos + y * sin)).collect();
        along.sort_by(|a, b| b.total_cmp(a));
        Self { to: (cos, sin), edge_px: along[(share * along.len() as f64) as usize] }
    }

    /// How far on the open side of the edge a place is, px.
    fn beyond(&self, side: usize, x: f64, y: f64) -> f64 {
        let middle = 0.5 * (side as f64 - 1.0);
        (x - middle) * self.to.0 + (y - middle) * self.to.1 - self.edge_px
    }

    /// False detections along the edge.
    fn along(&self, side: usize, count: usize, rng: &mut StdRng) -> Vec<(f64, f64)> {
        let middle = 0.5 * (side as f64 - 1.0);
        let inside = |v: f64| (0.0..side as f64 - 1.0).contains(&v);
        let place = |rng: &mut StdRng| {
            let (along, off) = (rng.random_range(-1.0..1.0) * side as f64, self.edge_px + 8.0 * normal(rng));
            (middle + off * self.to.0 - along * self.to.1, middle + off * self.to.1 + along * self.to.0)
        };
        let places = (0..100 * count).map(|_| place(rng)).filter(|(x, y)| inside(*x) && inside(*y));
        places.take(count).collect()
    }
}

fn solved(frame: &DrawnFrame, detected: &Detected) -> Result<Solution, NoSolution> {
    solve(detected, &frame.hint, &at_epoch(&frame.catalogue, EPOCHS.1))
}

/// A frame with half the false detections along its edge that it has true ones left.
fn hidden(kind: &Kind, seed: u64, open: f64, open_to_deg: f64, false_share: f64) -> DrawnFrame {
    let mut frame = draw(kind, seed);
    let mut rng = StdRng::seed_from_u64(seed);
    let roof = Roof::leaving(open, open_to_deg, frame.shape.0);
    frame.stars.retain(|s| roof.beyond(frame.shape.0, s.x_px, s.y_px) > 5.0);
    let count = (false_share * frame.stars.len() as f64) as usize;
    let flux = |rng: &mut StdRng| 10_f64.powf(rng.random_range(2.5..4.0));
    let places = roof.along(frame.shape.0, count, &mut rng);
    let edge: Vec<_> = places.into_iter().map(|(x, y)| star(x, y, flux(&mut rng), 0.1)).collect();
    frame.stars.extend(edge);
    frame
}

#[test]
fn frames_hidden_by_a_roof_are_solved_with_the_right_hint() {
    for (stars, share_false) in [((36, 60), 0.0), ((50, 90), 0.6), ((120, 250), 1.0)] {
        let kind = Kind { field_deg: (0.4, 2.0), stars, offset_fields: 0.3, ..PLAIN };
        let (mut right, mut wrong, mut all, mut missed) = (0, 0, 0, Vec::new());
        let mut times = Vec::new();
        for seed in 0..40_u64 {
            let open = [0.25, 0.3, 0.35, 0.4][seed as usize % 4];
            let to = OPEN_TO_DEG[seed as usize % OPEN_TO_DEG.len()];
            let frame = hidden(&kind, 900 + seed, open, to, share_false);
            let started = Instant::now();
            match solved(&frame, &frame.detected()) {
                Ok(solution) => {
                    // the hidden part is far from the stars: the centre counts
                    let (centre, _) = frame.errors_px(&solution.wcs);
                    right += u32::from(centre < 4.0);
                    wrong += u32::from(centre >= 4.0);
                }
                Err(reason) => missed.push(format!("{seed} ({} stars): {reason}", frame.stars.len())),
            }
            times.push(started.elapsed().as_secs_f64() * 1e3);
            all += 1;
        }
        times.sort_by(f64::total_cmp);
        println!(
            "{stars:?} stars, {share_false} false: {right} right, {wrong} wrong of {all}, median {:.1} ms, worst {:.0} ms; {missed:#?}",
            times[times.len() / 2],
            times[times.len() - 1]
        );
        assert_eq!(wrong, 0);
        assert!(right * 100 >= all * 95, "{right} of {all}: {missed:#?}");
    }
}

#[test]
fn random_stars_on_one_side_of_a_frame_are_not_accepted() {
    random_stars_on_one_side(6);
}

fn random_stars_on_one_side(frames: u64) {
    let kind = Kind { field_deg: (0.4, 2.0), stars: (30, 90), offset_fields: 0.3, ..PLAIN };
    let mut accepted = Vec::new();
    for seed in 0..frames {
        let mut frame = hidden(&kind, 5_000 + seed, 0.3, OPEN_TO_DEG[seed as usize % 5], 0.5);
        // the same brightness and the same edge, other places: those of another sky
        let other = hidden(&kind, 7_000 + seed, 0.3, OPEN_TO_DEG[seed as usize % 5], 0.5);
        frame.stars = other.stars;
        if let Ok(solution) = solved(&frame, &frame.detected()) {
            accepted.push((seed, solution.matched, solution.false_alarm));
        }
    }
    assert!(accepted.is_empty(), "{accepted:?}");
}

/// The frame as pixels, drawn by this light of a star.
fn painted(frame: &DrawnFrame, psf: Psf, roof: Option<Roof>, seed: u64) -> Measured {
    let side = frame.shape.0;
    let mut sky = Sky::new(side, side, 800.0, seed);
    for star in &frame.stars {
        sky.add_star(psf, star.x_px, star.y_px, 40.0 * star.flux_adu);
    }
    if let Some(roof) = roof {
        let width = side;
        let mut rng = StdRng::seed_from_u64(seed);
        for (n, light) in sky.light.iter_mut().enumerate() {
            // the roof is dark, its edge out of focus
            let beyond = roof.beyond(side, (n % width) as f64, (n / width) as f64);
            *light = 150.0 + (*light - 150.0) / (1.0 + (-beyond / 6.0).exp());
        }
        // leaves and screws in the light of the town
        for (x, y) in roof.along(side, 60, &mut rng) {
            sky.add_star(Psf::Gaussian(1.5), x, y, 10_f64.powf(rng.random_range(3.0..4.5)));
        }
    }
    let pixels = sky.counts(100.0, 8.0);
    let frame = Frame::new(side, side, Pixels::U16(&pixels)).unwrap();
    measure(&frame, &Camera::default(), &StarSearch::default()).unwrap()
}

fn of<'a>(measured: &'a Measured, frame: &DrawnFrame) -> Detected<'a> {
    Detected { stars: &measured.stars, width: frame.shape.0, height: frame.shape.1, quality: Some(&measured.quality) }
}

#[test]
fn pixels_behind_a_roof_are_solved() {
    let kind = Kind { shape: (1024, 1024), field_deg: (0.5, 2.0), stars: (60, 120), offset_fields: 0.3, ..PLAIN };
    let (mut right, mut missed) = (0, Vec::new());
    for seed in 0..10_u64 {
        let frame = draw(&kind, 2_000 + seed);
        let open = [0.28, 0.4][seed as usize % 2];
        let roof = Roof::leaving(open, OPEN_TO_DEG[seed as usize % 5], 1024);
        let measured = painted(&frame, Psf::Gaussian(sigma(3.0)), Some(roof), seed);
        match solved(&frame, &of(&measured, &frame)) {
            Ok(solution) => {
                let (centre, _) = frame.errors_px(&solution.wcs);
                assert!(centre < 4.0, "seed {seed} is {centre} px off: {} matched", solution.matched);
                right += 1;
            }
            Err(reason) => missed.push(format!("{seed}: {reason}")),
        }
    }
    println!("pixels behind a roof: {right} of 10 right; {missed:#?}");
    assert!(right >= 9, "{right}: {missed:#?}");
}

#[test]
fn a_long_trail_is_refused_and_a_short_one_solved() {
    trails_are_refused_or_solved(&[(6.0, true), (40.0, false)], 1);
}

/// Lengths, px, and whether all frames with them must be solved.
fn trails_are_refused_or_solved(lengths: &[(f64, bool)], frames: u64) {
    let kind = Kind { shape: (1024, 1024), field_deg: (0.5, 2.0), stars: (40, 80), offset_fields: 0.3, ..PLAIN };
    for &(length, must_solve) in lengths {
        let (mut near, mut refused, mut others) = (0_u64, 0, Vec::new());
        for seed in 0..frames {
            let frame = draw(&kind, 3_000 + seed);
            let (sin, cos) = (30.0 * seed as f64).to_radians().sin_cos();
            let measured = painted(&frame, Psf::Trail(sigma(3.0), length * cos, length * sin), None, seed);
            let trailed = measured.stars.iter().filter(|s| s.flags.trailed).count();
            match solved(&frame, &of(&measured, &frame)) {
                Ok(solution) => {
                    let (centre, _) = frame.errors_px(&solution.wcs);
                    assert!(
                        centre < 1.5,
                        "trails of {length} px: {centre} px off, false alarm {}",
                        solution.false_alarm
                    );
                    near += 1;
                }
                Err(NoSolution::Trailed { .. }) => refused += 1,
                Err(other) => others.push(other.to_string()),
            }
            if seed == 0 {
                let s = &measured.stars[measured.stars.len().min(8) / 2];
                println!(
                    "trail {length}: {} stars ({trailed} trailed, quality {}), fwhm {:.1} e {:.2} at {:.0} deg",
                    measured.stars.len(),
                    measured.quality.trailed,
                    s.fwhm_px,
                    s.ellipticity,
                    s.angle_deg
                );
            }
        }
        println!("trails of {length} px: {near} solved, {refused} trailed, {others:?}");
        assert!(!must_solve || near == frames, "trails of {length} px: {others:?}");
    }
}

/// Two chips side by side in one image, without the gap that is between them on the sky, and the second a little turned.
#[test]
fn a_frame_of_two_chips_is_placed_by_one_of_them() {
    let kind = Kind { field_deg: (0.4, 2.0), stars: (60, 160), offset_fields: 0.3, ..PLAIN };
    let (mut right, mut wrong, mut missed) = (0, 0, Vec::new());
    for seed in 0..40_u64 {
        let mut frame = draw(&kind, 4_200 + seed);
        let gap = [10.0, 30.0, 80.0, 150.0][seed as usize % 4];
        let turn = (0.05 * (seed % 3) as f64).to_radians();
        let (middle, height) = (0.5 * frame.shape.0 as f64, 0.5 * frame.shape.1 as f64);
        frame.stars.retain_mut(|star| {
            if star.x_px < middle {
                return true;
            }
            let (x, y) = (star.x_px - middle, star.y_px - height);
            star.x_px = middle - gap + x * turn.cos() - y * turn.sin();
            star.y_px = height + x * turn.sin() + y * turn.cos();
            x > gap && (0.0..2.0 * height - 1.0).contains(&star.y_px)
        });
        match solved(&frame, &frame.detected()) {
            Ok(solution) => {
                // one chip, or the other, is where it says
                let off_px = |shifted: bool| {
                    let (x, y) = if shifted { (1.5 * middle, height) } else { (0.5 * middle, height) };
                    let (ra, dec) = solution.wcs.pixel_to_sky(if shifted { x - gap } else { x }, y);
                    frame.truth.sky_to_pixel(ra, dec).map_or(f64::INFINITY, |(tx, ty)| (tx - x).hypot(ty - y))
                };
                let off = off_px(false).min(off_px(true));
                if off < 3.0 {
                    right += 1
                } else {
                    wrong += 1
                }
                if off >= 3.0 {
                    println!("seed {seed} gap {gap}: {off:.1} px off, {} matched", solution.matched);
                }
            }
            Err(reason) => missed.push(format!("{seed} gap {gap} turn {turn:.4}: {reason}")),
        }
    }
    println!("two chips: {right} right, {wrong} wrong, missed {missed:#?}");
    assert!(wrong == 0 && right >= 36, "{right} right, {wrong} wrong: {missed:#?}");
}

/// The whole statistics take a minute of a processor.
mod proof {
    #[test]
    fn random_stars_on_one_side_of_a_frame_are_never_accepted() {
        super::random_stars_on_one_side(60);
    }

    #[test]
    fn long_trails_are_refused_and_short_ones_solved() {
        let lengths = [(6.0, true), (10.0, false), (20.0, false), (40.0, false), (80.0, false)];
        super::trails_are_refused_or_solved(&lengths, 4);
    }
}
