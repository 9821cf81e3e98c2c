//! Compares the sky with astropy: 3 sites x 4 epochs (one the day of a leap second) x 4 targets, `golden/golden.json`.
//!
//! The tolerances are far below what Starmesh promises (5 arcsec, 50 ms, 1 ms of sidereal time), so that a wrong term
//! is noticed.
#![allow(clippy::unwrap_used, reason = "tests")]

use serde::Deserialize;
use sky::{EarthOrientation, Horizontal, Icrs, Night, Observer, OfDate, Place, Tangent, separation};
use units::{Angle, Utc};

#[derive(Deserialize)]
struct Golden {
    cases: Vec<Case>,
    tangent: Vec<TangentPoint>,
}

#[derive(Deserialize)]
struct Case {
    site: String,
    latitude_deg: f64,
    longitude_east_deg: f64,
    elevation_m: f64,
    utc: Utc,
    dut1_s: f64,
    polar_x_arcsec: f64,
    polar_y_arcsec: f64,
    apparent_sidereal_h: f64,
    mean_sidereal_h: f64,
    sun: Direction,
    moon: Direction,
    moon_fraction: f64,
    next_sunset: Option<Utc>,
    next_sunrise: Option<Utc>,
    next_dusk: Option<Utc>,
    targets: Vec<Target>,
}

#[derive(Deserialize)]
struct Direction {
    altitude_deg: f64,
    azimuth_deg: f64,
}

#[derive(Deserialize)]
struct Target {
    ra_deg: f64,
    dec_deg: f64,
    altitude_deg: f64,
    azimuth_deg: f64,
    of_date_ra_deg: f64,
    of_date_dec_deg: f64,
    bjd_tdb: (f64, f64),
    heliocentric_light_time_s: f64,
}

#[derive(Deserialize)]
struct TangentPoint {
    center_ra_deg: f64,
    center_dec_deg: f64,
    xi_deg: f64,
    eta_deg: f64,
    ra_deg: f64,
    dec_deg: f64,
}

fn golden() -> Golden {
    let golden: Golden = serde_json::from_str(include_str!("../golden/golden.json")).unwrap();
    assert_eq!(golden.cases.len(), 12);
    golden
}

impl Case {
    fn place(&self) -> Place {
        let (latitude, longitude) = (self.latitude_deg, self.longitude_east_deg);
        Place::new(Angle::from_degrees(latitude), Angle::from_degrees(longitude), self.elevation_m).unwrap()
    }

    fn orientation(&self) -> EarthOrientation {
        let Self { dut1_s, polar_x_arcsec, polar_y_arcsec, .. } = *self;
        EarthOrientation { dut1_s, polar_x_arcsec, polar_y_arcsec }
    }

    fn observer(&self) -> Observer {
        Observer::new(&self.place(), &self.orientation(), self.utc).unwrap()
    }
}

/// Fails with the name of the case when two numbers are further apart than the tolerance.
#[track_caller]
fn near(case: &Case, what: &str, off: f64, bar: f64) {
    assert!(off.abs() < bar, "{what} at {} {}: off by {off}, bar {bar}", case.site, case.utc);
}

#[test]
fn altitude_and_azimuth_agree_within_a_hundredth_of_an_arcsecond() {
    for case in golden().cases {
        let observer = case.observer();
        for target in &case.targets {
            let star = Icrs::from_degrees(target.ra_deg, target.dec_deg);
            let direction = Horizontal::from_degrees(target.altitude_deg, target.azimuth_deg);
            near(&case, "star", observer.to_horizontal(&star).separation(&direction).arcseconds(), 0.01);
            near(&case, "way back", separation(&observer.to_icrs(&direction), &star).arcseconds(), 0.01);
        }
    }
}

#[test]
fn places_of_date_agree_within_a_thousandth_of_an_arcsecond() {
    for case in golden().cases {
        let observer = case.observer();
        for target in &case.targets {
            let star = Icrs::from_degrees(target.ra_deg, target.dec_deg);
            let apparent = OfDate::from_degrees(target.of_date_ra_deg, target.of_date_dec_deg);
            let ours = observer.to_of_date(&star);
            let east = (ours.ra - apparent.ra).wrapped_signed().arcseconds() * apparent.dec.cos();
            near(&case, "place of date", east.hypot((ours.dec - apparent.dec).arcseconds()), 0.001);
            near(&case, "way back", separation(&observer.of_date_to_icrs(&apparent), &star).arcseconds(), 0.001);
        }
    }
}

#[test]
fn sidereal_times_agree_within_ten_microseconds() {
    for case in golden().cases {
        let observer = case.observer();
        let seconds =
            |ours: Angle, theirs_h: f64| (ours - Angle::from_hours(theirs_h)).wrapped_signed().hours() * 3600.0;
        near(&case, "apparent", seconds(observer.sidereal_time(), case.apparent_sidereal_h), 1e-5);
        near(&case, "mean", seconds(observer.mean_sidereal_time(), case.mean_sidereal_h), 1e-5);
    }
}

#[test]
fn barycentric_and_heliocentric_times_agree_within_a_tenth_of_a_millisecond() {
    for case in golden().cases {
        let observer = case.observer();
        for target in &case.targets {
            let star = Icrs::from_degrees(target.ra_deg, target.dec_deg);
            let seconds = |a: (f64, f64), b: (f64, f64)| ((a.0 - b.0) + (a.1 - b.1)) * 86_400.0;
            near(&case, "BJD_TDB", seconds(observer.barycentric_jd_tdb(&star), target.bjd_tdb), 1e-4);
            let heliocentric_s = seconds(observer.heliocentric_jd_utc(&star), case.utc.julian_date());
            near(&case, "HJD_UTC", heliocentric_s - target.heliocentric_light_time_s, 1e-4);
        }
    }
}

#[test]
fn sun_and_moon_agree_within_a_tenth_of_an_arcsecond() {
    for case in golden().cases {
        let observer = case.observer();
        for (name, ours, theirs) in [("Sun", observer.sun(), &case.sun), ("Moon", observer.moon(), &case.moon)] {
            let theirs = Horizontal::from_degrees(theirs.altitude_deg, theirs.azimuth_deg);
            near(&case, name, ours.separation(&theirs).arcseconds(), 0.1);
        }
        near(&case, "Moon's lit part", observer.moon_illumination() - case.moon_fraction, 1e-5);
    }
}

#[test]
fn sunset_sunrise_and_dusk_agree_within_a_tenth_of_a_second() {
    for case in golden().cases {
        for (name, altitude, rising, theirs) in [
            ("sunset", Night::SUNSET, false, case.next_sunset),
            ("sunrise", Night::SUNSET, true, case.next_sunrise),
            ("dusk", Night::ASTRONOMICAL, false, case.next_dusk),
        ] {
            let ours = sky::next_sun_crossing(&case.place(), &case.orientation(), case.utc, altitude, rising).unwrap();
            assert_eq!(ours.is_some(), theirs.is_some(), "{name} at {} {}", case.site, case.utc);
            if let (Some(ours), Some(theirs)) = (ours, theirs) {
                near(&case, name, ours.seconds_since(theirs), 0.1);
            }
        }
    }
}

#[test]
fn the_tangent_plane_agrees_with_a_fits_world_coordinate_system() {
    for point in golden().tangent {
        let plane = Tangent::new(Icrs::from_degrees(point.center_ra_deg, point.center_dec_deg));
        let star = Icrs::from_degrees(point.ra_deg, point.dec_deg);
        let (xi, eta) = plane.project(&star).unwrap();
        let off = (xi.degrees() - point.xi_deg).hypot(eta.degrees() - point.eta_deg) * 3600.0;
        assert!(off < 1e-6, "({}, {}): {off} arcsec", point.xi_deg, point.eta_deg);
        let back = plane.unproject(Angle::from_degrees(point.xi_deg), Angle::from_degrees(point.eta_deg));
        assert!(separation(&back, &star).arcseconds() < 1e-6);
    }
}
