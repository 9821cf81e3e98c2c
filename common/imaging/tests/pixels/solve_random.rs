//! Star lists that show no piece of the catalogue: none may be accepted (acceptance test 2 of the specification).

use imaging::catalogue::{Catalogue, Entry, build};
use imaging::solve::{Detected, FIRST_LIGHT, Hint, LearnedOptics, at_epoch};
use imaging::tangent::TangentPlane;
use imaging::{NoSolution, Star, solve};
use rand::{RngExt, SeedableRng, rngs::StdRng};

use crate::drawn::{EPOCHS, deg, normal, star};

/// Skies; each serves as many lists.
const SKIES: u64 = 50;

/// A random sky of this many stars per field of 0.5 deg, 2 deg in radius.
fn sky(rng: &mut StdRng, per_field: f64) -> (Catalogue<Vec<u8>>, TangentPlane) {
    let plane = TangentPlane::new(deg(rng.random_range(0.0..360.0)), deg(rng.random_range(-85.0..85.0)));
    let count = (per_field * std::f64::consts::PI * 4.0 / 0.25) as usize;
    let entry = |rng: &mut StdRng| {
        let (far, bearing) =
            (2.0 * rng.random_range(0.0_f64..1.0).sqrt(), rng.random_range(0.0..std::f64::consts::TAU));
        let (ra, dec) = plane.direction(far.to_radians() * bearing.sin(), far.to_radians() * bearing.cos());
        Entry { ra, dec, pm_ra_mas: 0.0, pm_dec_mas: 0.0, mag: rng.random_range(6.0..13.0) }
    };
    let entries: Vec<Entry> = (0..count).map(|_| entry(rng)).collect();
    (Catalogue::from_bytes(build(&entries, 6, EPOCHS.0)).unwrap(), plane)
}

#[test]
fn random_star_lists_are_not_accepted() {
    random_star_lists(500, 4);
}

/// Of the lists, one in so many may be too sparse to test anything.
fn random_star_lists(lists: u64, sparse: u64) {
    let mut rng = StdRng::seed_from_u64(7);
    let rng = &mut rng;
    let (mut tried, mut accepted, mut tested, mut few) = (0_u64, Vec::new(), 0, 0);
    for number in 0..SKIES {
        // sparse skies are where chance deceives; every 25th is crowded too, which takes twenty times longer
        let most = if number % 25 == 0 { 50.0 } else { 12.0_f64 };
        let per_field = 6.0 * (most / 6.0).powf(rng.random_range(0.0..1.0));
        let (catalogue, plane) = sky(rng, per_field);
        for _ in 0..lists / SKIES {
            // as many stars as such a field shows, and three at the least
            let count = rng.random_range(3..=(1.2 * per_field).max(8.0) as usize);
            let side = [512, 1024, 2048][rng.random_range(0..3)];
            let length = side as f64 - 1.0;
            let draw = |rng: &mut StdRng| {
                let (x, y) = (rng.random_range(0.0..length), rng.random_range(0.0..length));
                star(x, y, 10_f64.powf(rng.random_range(2.0..5.0)), 0.1)
            };
            let stars: Vec<Star> = (0..count).map(|_| draw(rng)).collect();
            let (ra, dec) = plane.direction(0.005 * normal(rng), 0.005 * normal(rng));
            let mut hint = Hint::new(ra, dec, 1800.0 / side as f64);
            // levels 0 and 1 on all lists, the tiles of level 2 on one in 250: they take a hundred times longer
            hint.furthest = deg(if tried.is_multiple_of(250) { 1.5 } else { 0.0 });
            if rng.random_bool(0.2) {
                hint.scale_tolerance = FIRST_LIGHT;
            }
            if rng.random_bool(0.5) {
                let (rotation_deg, mirrored) = (rng.random_range(-180.0..180.0), rng.random_bool(0.5));
                hint.learned =
                    Some(LearnedOptics { scale_arcsec_px: hint.scale_arcsec_px, rotation_deg, mirrored, sip: None });
            }
            let detected = Detected { stars: &stars, width: side, height: side, quality: None };
            match solve(&detected, &hint, &at_epoch(&catalogue, EPOCHS.0)) {
                Ok(solution) => accepted.push((tried, count, solution)),
                Err(NoSolution::NoMatch { hypotheses, .. }) => tested += hypotheses,
                Err(NoSolution::TooFewStars { .. } | NoSolution::CatalogueTooShallow { .. }) => few += 1,
                Err(other) => panic!("list {tried}: {other}"),
            }
            tried += 1;
        }
    }
    println!("{tried} lists, {} accepted, {few} too sparse to be matched, {tested} hypotheses", accepted.len());
    assert_eq!(tried, lists);
    assert!(tested > 1000 * lists, "only {tested} hypotheses: the lists were not searched");
    assert!(few < lists / sparse, "{few} lists were too sparse to test anything");
    assert!(accepted.is_empty(), "{accepted:#?}");
}

mod proof {
    /// The whole statistics take 20 s of a processor.
    #[test]
    fn ten_thousand_random_star_lists_are_never_accepted() {
        super::random_star_lists(10_000, 5);
    }
}
