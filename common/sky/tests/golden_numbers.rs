//! The golden numbers of the sky: airmass (docs/formulae.md, "Airmass") and the ratio of sidereal to solar time.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use sky::{EarthOrientation, Observer, Place};
use units::{Angle, Utc};

#[test]
fn airmasses_are_those_of_young() {
    for (altitude_deg, golden) in [(90.0, 1.000000364), (60.0, 1.154108441), (30.0, 1.991730756), (10.0, 5.540701917)] {
        let found = sky::airmass(Angle::from_degrees(altitude_deg)).unwrap();
        assert!((found - golden).abs() < 1e-9, "at {altitude_deg} deg: {found}, golden {golden}");
    }
}

/// Turns of the sky in a day of UT1.
#[test]
fn the_sky_turns_by_the_sidereal_ratio() {
    const GOLDEN: f64 = 1.0027379093604878;
    let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2600.0).unwrap();
    let start: Utc = "2026-11-21T03:00:00Z".parse().unwrap();
    let turned = |days: f64| {
        let at = start.plus_seconds(86_400.0 * days);
        Observer::new(&place, &EarthOrientation::default(), at).unwrap().mean_sidereal_time()
    };
    const DAYS: f64 = 200.0;
    let beyond = (turned(DAYS) - turned(0.0) - Angle::from_degrees(360.0 * GOLDEN * DAYS)).wrapped_signed();
    // A stamp is good to a microsecond: 4e-9 deg.
    assert!((beyond.degrees() / 360.0 / DAYS).abs() < 2e-11, "{} deg in {DAYS} days", beyond.degrees());
}
