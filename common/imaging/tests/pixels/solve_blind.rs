//! Frames of the real sky (the catalogue that ships), drawn, solved with nothing known but their stars.

use std::time::Instant;

use imaging::catalogue::Catalogue;
use imaging::solve::{AllSky, Blind, Detected, Level, Stars, Within, at_epoch};
use imaging::tangent::separation;
use imaging::{NoSolution, Star, Wcs};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::drawn::{deg, normal, star, wcs};

const EPOCH: f64 = 2026.9;

fn catalogue() -> Catalogue<Vec<u8>> {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../catalogue/default.smcat");
    Catalogue::from_bytes(std::fs::read(file).unwrap()).unwrap()
}

struct Frame {
    stars: Vec<Star>,
    shape: (usize, usize),
    truth: Wcs,
}

impl Frame {
    /// A field anywhere, of this longer side (deg), any rotation, either parity: its brightest stars (of 10 to 50 in the
    /// field, magnitudes wrong by 0.2 mag, a tenth missing, places by 0.3 px), and false detections.
    fn draw(sky: &impl Stars, rng: &mut StdRng, field_deg: f64, spurious: f64) -> Self {
        let shape = [(1000, 1000), (1600, 1200), (2048, 1400)][rng.random_range(0..3)];
        let (ra, dec) = (deg(rng.random_range(0.0..360.0)), deg(rng.random_range(-1.0_f64..1.0).asin().to_degrees()));
        let scale = field_deg * 3600.0 / shape.0 as f64;
        let rotation = deg(rng.random_range(-180.0..180.0));
        let truth = wcs(ra, dec, shape, scale, rotation, rng.random_bool(0.5));
        let most = rng.random_range(20..=50);
        let mut inside = Vec::new();
        for limit in [5.0, 7.0, 9.0, 11.0, 99.0] {
            inside.clear();
            for known in sky.cone(ra, dec, deg(0.75 * field_deg), limit) {
                let (x, y) = truth.sky_to_pixel(known.ra, known.dec).unwrap();
                if (3.0..shape.0 as f64 - 4.0).contains(&x) && (3.0..shape.1 as f64 - 4.0).contains(&y) {
                    inside.push((known.mag + 0.2 * normal(rng), x + 0.3 * normal(rng), y + 0.3 * normal(rng)));
                }
            }
            if inside.len() > most {
                break;
            }
        }
        inside.retain(|_| rng.random_bool(0.9));
        inside.sort_by(|a, b| a.0.total_cmp(&b.0));
        inside.truncate(most);
        let false_ones = (inside.len() as f64 * spurious / (1.0 - spurious)).round() as usize;
        for _ in 0..false_ones {
            let mag = inside[rng.random_range(0..inside.len())].0;
            inside.push((
                mag,
                rng.random_range(0.0..shape.0 as f64 - 1.0),
                rng.random_range(0.0..shape.1 as f64 - 1.0),
            ));
        }
        let stars = inside.iter().map(|(mag, x, y)| star(*x, *y, 1e6 * 10_f64.powf(-0.4 * mag), 0.3)).collect();
        Self { stars, shape, truth }
    }

    fn detected(&self) -> Detected<'_> {
        Detected { stars: &self.stars, width: self.shape.0, height: self.shape.1, quality: None }
    }

    /// Distance of another WCS at the centre, px.
    fn error_px(&self, wcs: &Wcs) -> f64 {
        let (x, y) = (0.5 * (self.shape.0 as f64 - 1.0), 0.5 * (self.shape.1 as f64 - 1.0));
        let (ra, dec) = wcs.pixel_to_sky(x, y);
        self.truth.sky_to_pixel(ra, dec).map_or(f64::INFINITY, |(tx, ty)| (tx - x).hypot(ty - y))
    }
}

#[test]
fn fields_of_one_degree_and_more_are_found_without_a_hint() {
    fields_without_a_hint(1, 0, 1);
}

/// Fields of each kind, of which so many may be missed, and lists of random stars.
fn fields_without_a_hint(fields: usize, most_missed: usize, random_lists: u64) {
    let catalogue = catalogue();
    let sky = AllSky::new(at_epoch(&catalogue, EPOCH));
    let source = at_epoch(&catalogue, EPOCH);
    let mut rng = StdRng::seed_from_u64(3);
    // longer sides, deg; share of false detections; whether the scale is known to 10 %
    for (from_deg, to_deg, spurious, knows_scale) in [
        (12.0, 24.0, 0.2, false),
        (4.0, 12.0, 0.2, false),
        (1.5, 4.0, 0.2, false),
        (1.0, 1.5, 0.2, false),
        (1.0, 4.0, 0.5, true),
    ] {
        let (mut right, mut wrong, mut times, mut missed) = (0, 0, Vec::new(), Vec::new());
        for number in 0..fields {
            let field_deg = from_deg * f64::powf(to_deg / from_deg, rng.random_range(0.0..1.0));
            let frame = Frame::draw(&source, &mut rng, field_deg, spurious);
            let scale = frame.truth.scale_arcsec_px();
            let blind =
                Blind { scales_arcsec_px: knows_scale.then_some((0.9 * scale, 1.1 * scale)), ..Blind::default() };
            let started = Instant::now();
            let answer = sky.solve(&frame.detected(), &blind);
            times.push(started.elapsed().as_secs_f64() * 1e3);
            match answer {
                Ok(solution) => {
                    let good = frame.error_px(&solution.wcs) < 1.0 && solution.level == Level::Blind;
                    right += usize::from(good);
                    wrong += usize::from(!good);
                    assert_eq!(solution.mirrored, frame.truth.mirrored());
                    assert!(solution.false_alarm < 1e-6);
                }
                Err(reason) => missed.push(format!("{number} ({field_deg:.1} deg): {reason}")),
            }
        }
        times.sort_by(f64::total_cmp);
        println!(
            "{from_deg} to {to_deg} deg, {:.0} % false, scale {}: {right} of {fields} right, {wrong} wrong; median {:.0} \
             ms, p90 {:.0} ms, longest {:.0} ms; missed {missed:?}",
            100.0 * spurious,
            if knows_scale { "to 10 %" } else { "unknown" },
            times[fields / 2],
            times[fields * 9 / 10],
            times[fields - 1],
        );
        assert_eq!(wrong, 0);
        assert!(right + most_missed >= fields, "{right} of {fields}; missed {missed:?}");
    }
    // and what is no sky at all is nowhere
    let (mut candidates, mut lists) = (0, 0);
    for _ in 0..random_lists {
        let count = rng.random_range(8..60);
        let at = |rng: &mut StdRng| (rng.random_range(0.0..999.0), rng.random_range(0.0..999.0));
        let stars: Vec<Star> = (0..count)
            .map(|n| {
                let (x, y) = at(&mut rng);
                star(x, y, 1e5 / f64::from(n + 1), 0.3)
            })
            .collect();
        let detected = Detected { stars: &stars, width: 1000, height: 1000, quality: None };
        let started = Instant::now();
        match sky.solve(&detected, &Blind { most_candidates: 2000, ..Blind::default() }) {
            Err(NoSolution::Blind { candidates: tried, .. }) => {
                candidates += tried;
                lists += 1;
            }
            other => panic!("{other:?}"),
        }
        println!("random list of {count}: {:?}", started.elapsed());
    }
    println!("{lists} random lists, {candidates} candidates, none accepted");
    assert!(candidates > 80 * random_lists, "only {candidates} candidates");
}

#[test]
fn a_hint_of_more_than_60_deg_finds_what_lies_within_it_and_nothing_beyond() {
    hints_of_more_than_60_deg(&[150.0]);
}

fn hints_of_more_than_60_deg(away: &[f64]) {
    let catalogue = catalogue();
    let source = at_epoch(&catalogue, EPOCH);
    let sky = AllSky::new(at_epoch(&catalogue, EPOCH));
    let mut rng = StdRng::seed_from_u64(11);
    for &away_deg in away {
        let frame = Frame::draw(&source, &mut rng, 3.0, 0.2);
        let scale = frame.truth.scale_arcsec_px();
        // The hint lies on the great circle through the frame and the pole.
        let over = frame.truth.dec.degrees() + away_deg;
        let (ra, dec) = if over > 90.0 {
            (frame.truth.ra.degrees() + 180.0, 180.0 - over)
        } else {
            (frame.truth.ra.degrees(), over)
        };
        let (ra, dec) = if dec < -90.0 { (ra + 180.0, -180.0 - dec) } else { (ra, dec) };
        let (ra, dec) = (deg(ra), deg(dec));
        let apart_deg = separation((ra, dec), (frame.truth.ra, frame.truth.dec)).degrees();
        assert!((apart_deg - away_deg).abs() < 1e-6, "{apart_deg} for {away_deg}");
        let blind = |furthest_deg: f64| Blind {
            scales_arcsec_px: Some((0.9 * scale, 1.1 * scale)),
            within: Some(Within { ra, dec, furthest: deg(furthest_deg) }),
            ..Blind::default()
        };
        let found = sky.solve(&frame.detected(), &blind(away_deg + 1.0));
        assert!(found.as_ref().is_ok_and(|solution| frame.error_px(&solution.wcs) < 1.0), "{away_deg}: {found:?}");
        let beyond = sky.solve(&frame.detected(), &blind(away_deg - 1.0));
        assert!(matches!(beyond, Err(NoSolution::Blind { .. })), "{away_deg}: {beyond:?}");
    }
    let frame = Frame::draw(&source, &mut rng, 3.0, 0.2);
    for (dec_deg, furthest_deg) in [(0.0, 180.1), (0.0, -1.0), (0.0, f64::NAN), (91.0, 90.0), (f64::NAN, 90.0)] {
        let within = Some(Within { ra: deg(0.0), dec: deg(dec_deg), furthest: deg(furthest_deg) });
        let answer = sky.solve(&frame.detected(), &Blind { within, ..Blind::default() });
        assert!(matches!(answer, Err(NoSolution::Hint { .. })), "{dec_deg} {furthest_deg}: {answer:?}");
    }
}

#[test]
fn scales_that_make_no_sense_and_too_few_stars_are_refused() {
    let none = |_, _, _, _| Vec::new();
    let sky = AllSky::new(none);
    let stars: Vec<Star> = (0..5).map(|n| star(100.0 * f64::from(n), 40.0, 100.0, 0.1)).collect();
    let detected = Detected { stars: &stars, width: 500, height: 500, quality: None };
    for scales in [(0.0, 1.0), (f64::NAN, 1.0), (2.0, 1.0), (1.0, f64::INFINITY)] {
        let answer = sky.solve(&detected, &Blind { scales_arcsec_px: Some(scales), ..Blind::default() });
        assert!(matches!(answer, Err(NoSolution::Hint { .. })), "{scales:?}: {answer:?}");
    }
    let answer = sky.solve(&detected, &Blind::default());
    assert_eq!(answer, Err(NoSolution::TooFewStars { stars: 5, needed: 6 }));
}

/// The whole statistics take half a minute of a processor.
mod proof {
    #[test]
    fn many_fields_of_one_degree_and_more_are_found_without_a_hint() {
        super::fields_without_a_hint(12, 1, 6);
    }

    #[test]
    fn hints_of_more_than_60_deg_find_what_lies_within_them_and_nothing_beyond() {
        super::hints_of_more_than_60_deg(&[65.0, 100.0, 150.0, 175.0]);
    }
}
