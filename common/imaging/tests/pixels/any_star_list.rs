//! Star lists and hints that make no sense: a typed answer, never a panic; and the classes of failure.

use imaging::catalogue;
use imaging::quality::Quality;
use imaging::solve::{Detected, Hint, LearnedOptics, at_epoch};
use imaging::tangent::TangentPlane;
use imaging::wcs::Sip;
use imaging::{NoSolution, Star, solve};
use proptest::prelude::*;
use units::Angle;

use crate::drawn::{EPOCHS, Kind, PLAIN, deg, draw, star};

/// A few stars on a spiral around (10, 20) deg, one of them no number.
fn spiral(ra: Angle, dec: Angle, _radius: Angle, faintest_mag: f64) -> Vec<catalogue::CatalogueStar> {
    let plane = TangentPlane::new(deg(10.0), deg(20.0));
    let mut stars: Vec<catalogue::CatalogueStar> = (1..60)
        .map(|n| {
            let (sin, cos) = (2.4 * f64::from(n)).sin_cos();
            let (ra, dec) = plane.direction(1e-4 * f64::from(n) * sin, 1e-4 * f64::from(n) * cos);
            catalogue::CatalogueStar { ra, dec, mag: 6.0 + 0.1 * f64::from(n) }
        })
        .filter(|star| star.mag <= faintest_mag)
        .collect();
    stars.push(catalogue::CatalogueStar { ra: deg(f64::NAN), dec, mag: 5.0 });
    stars.push(catalogue::CatalogueStar { ra, dec, mag: f64::NAN });
    stars
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -50.0..600.0_f64,
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1e300), Just(0.0), Just(100.0)],
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_star_list_gets_an_answer(
        places in prop::collection::vec((number(), number(), number(), number(), 0..8_u8), 0..30),
        copies in 1..4_usize,
        shape in prop_oneof![Just((512, 512)), Just((16, 700)), Just((1, 1)), Just((0, 5)), Just((9000, 20))],
        hint in (number(), number(), prop_oneof![4 => 0.05..20.0_f64, 1 => number()], 0.0..0.06_f64),
        learned in prop::option::of((number(), any::<bool>(), -1e-2..1e-2_f64)),
    ) {
        let drawn = |&(x, y, flux, error, flags): &(f64, f64, f64, f64, u8)| {
            let mut drawn = star(x, y, flux, error);
            drawn.fwhm_px = error;
            (drawn.flags.cosmic, drawn.flags.trailed) = (flags == 1, flags & 2 != 0);
            drawn.flags.saturated = flags & 4 != 0;
            drawn
        };
        let once: Vec<Star> = places.iter().map(drawn).collect();
        let stars: Vec<Star> = once.iter().cycle().take(copies * once.len()).copied().collect();
        let mut given = Hint::new(deg(hint.0), deg(hint.1), hint.2);
        (given.scale_tolerance, given.furthest) = (hint.3, deg(0.2));
        given.most_hypotheses = 200_000;
        given.learned = learned.map(|(rotation_deg, mirrored, bend)| LearnedOptics {
            scale_arcsec_px: hint.2,
            rotation_deg,
            mirrored,
            sip: Some(Sip { a: [bend; 7], b: [bend; 7] }),
        });
        let detected = Detected { stars: &stars, width: shape.0, height: shape.1, quality: None };
        match solve(&detected, &given, &spiral) {
            Ok(solution) => prop_assert!(solution.ra.is_finite() && solution.rms_px.is_finite(), "{solution:?}"),
            Err(reason) => prop_assert!(!reason.to_string().is_empty()),
        }
    }
}

fn quality() -> Quality {
    Quality {
        stars: 0,
        fwhm_px: None,
        ellipticity: None,
        elongation_deg: None,
        trailed: false,
        trail_px: None,
        background_adu: 100.0,
        noise_adu: 3.0,
        saturated_fraction: 0.0,
        defect_fraction: 0.0,
        banding: false,
        trails: 0,
    }
}

/// What the solver says of a drawn frame whose stars were replaced.
fn refused(kind: &Kind, stars: &[Star], quality: &Quality, faintest_mag: Option<f64>) -> NoSolution {
    let frame = draw(kind, 3);
    let (width, height) = frame.shape;
    let hint = Hint { faintest_mag, ..frame.hint.clone() };
    let detected = Detected { stars, width, height, quality: Some(quality) };
    solve(&detected, &hint, &at_epoch(&frame.catalogue, EPOCHS.1)).unwrap_err()
}

fn scattered(count: u32) -> Vec<Star> {
    let place = |n: u32, step: u32| f64::from(n * step % 2039) + 3.3;
    (1..=count).map(|n| star(place(n, 631), place(n, 1201), 1000.0 * f64::from(n), 0.1)).collect()
}

#[test]
fn each_failure_has_its_name_and_its_figures() {
    let busy = Kind { stars: (30, 40), ..PLAIN };
    let plain = quality();
    assert_eq!(refused(&busy, &scattered(2), &plain, None), NoSolution::TooFewStars { stars: 2, needed: 4 });
    assert_eq!(refused(&busy, &[], &plain, None), NoSolution::TooFewStars { stars: 0, needed: 4 });
    let clouds = refused(&busy, &scattered(2), &plain, Some(13.0));
    assert!(matches!(clouds, NoSolution::Clouds { stars: 2, expected: 60..200, .. }), "{clouds}");
    let trailed = refused(&busy, &scattered(20), &Quality { trailed: true, ..plain.clone() }, Some(13.0));
    assert_eq!(trailed, NoSolution::Trailed { stars: 20, length_px: 0.0 });
    let saturated = refused(&busy, &scattered(20), &Quality { saturated_fraction: 0.4, ..plain.clone() }, None);
    assert!(matches!(saturated, NoSolution::Saturated { stars: 0, .. }), "{saturated}");
    let mut bright = scattered(20);
    bright.iter_mut().for_each(|star| star.flags.saturated = true);
    assert!(matches!(refused(&busy, &bright, &plain, None), NoSolution::Saturated { stars: 20, .. }));
    let nothing = refused(&busy, &scattered(40), &plain, Some(13.0));
    assert!(matches!(nothing, NoSolution::NoMatch { stars: 40, hypotheses: 1.., .. }), "{nothing}");
}

#[test]
fn a_catalogue_without_stars_there_is_called_too_shallow() {
    let stars = scattered(40);
    let detected = Detected { stars: &stars, width: 2048, height: 2048, quality: None };
    let hint = Hint { furthest: Angle::default(), ..Hint::new(deg(200.0), deg(-50.0), 0.35) };
    let none = |_: Angle, _: Angle, _: Angle, _: f64| Vec::new();
    let reason = solve(&detected, &hint, &none).unwrap_err();
    assert!(matches!(reason, NoSolution::CatalogueTooShallow { stars: 0, .. }), "{reason:?}");
    assert_eq!(
        reason.to_string(),
        "catalogue too shallow: 0 stars in this field of 0.199 deg; take a deeper catalogue"
    );
}

#[test]
fn a_sky_that_repeats_itself_is_ambiguous() {
    // the same four stars twice, a field apart
    let four = [(-0.12, 0.05), (0.1, 0.11), (0.03, -0.13), (-0.05, -0.02)];
    let hint = Hint { furthest: Angle::default(), ..Hint::new(deg(10.0), deg(0.0), 0.9) };
    let plane = TangentPlane::new(deg(10.0), deg(0.0));
    let sky = move |_: Angle, _: Angle, _: Angle, _: f64| {
        let places = [-0.2_f64, 0.2].into_iter().flat_map(|x| four.map(|(dx, dy)| (x + dx * 0.8, dy * 0.8)));
        let at = |(x, y): (f64, f64)| plane.direction(x.to_radians(), y.to_radians());
        places.map(at).map(|(ra, dec)| catalogue::CatalogueStar { ra, dec, mag: 9.0 }).collect::<Vec<_>>()
    };
    let pixel =
        |(x, y): (f64, f64)| star(511.5 - x * 0.8 * 3600.0 / 0.9, 511.5 + y * 0.8 * 3600.0 / 0.9, 1000.0 - x, 0.05);
    let stars: Vec<Star> = four.iter().copied().map(pixel).collect();
    let detected = Detected { stars: &stars, width: 1024, height: 1024, quality: None };
    let reason = solve(&detected, &hint, &sky).unwrap_err();
    let NoSolution::Ambiguous { apart, matched: 4 } = reason else { panic!("{reason:?}") };
    assert!((apart.degrees() - 0.4).abs() < 0.001, "{apart:?}");
}

#[test]
fn hints_that_make_no_sense_are_refused_by_name() {
    let stars = scattered(10);
    let detected = Detected { stars: &stars, width: 512, height: 512, quality: None };
    let good = Hint::new(deg(10.0), deg(20.0), 1.0);
    for (hint, expected) in [
        (Hint { ra: deg(f64::NAN), ..good.clone() }, "ra, deg"),
        (Hint { dec: deg(91.0), ..good.clone() }, "dec, deg"),
        (Hint { scale_arcsec_px: 0.0, ..good.clone() }, "scale, arcsec/px"),
        (Hint { scale_tolerance: 0.5, ..good.clone() }, "scale tolerance"),
        (Hint { scale_arcsec_px: 1000.0, ..good.clone() }, "longer side of the frame, deg"),
    ] {
        let reason = solve(&detected, &hint, &spiral).unwrap_err();
        assert!(matches!(reason, NoSolution::Hint { what, .. } if what == expected), "{reason}");
    }
}
