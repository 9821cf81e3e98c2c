//! Where a mount is at a limit and where it is not, by the place, the altitude and the pier side that it reports.

use units::Angle;

use super::tests::{LIMITS, PARK, at, sky, sky_at};
use super::*;

/// Where a mount points that stands at this hour angle and altitude.
fn pointing(hour_angle_h: f64, altitude_deg: Option<f64>, side: Option<PierSide>) -> Pointing {
    let ra = sky().sidereal_time() - Angle::from_hours(hour_angle_h);
    // A declination of that altitude would be another one: reported altitudes decide in these tables.
    let place = OfDate { ra, dec: Angle::from_degrees(-24.6) };
    let reckoned = sky().of_date_to_horizontal(&place).altitude.degrees();
    let altitude_deg = altitude_deg.map(|altitude| altitude.max(reckoned - 1.0));
    Pointing { place: Some(place), altitude_deg, side }
}

fn why(pointing: &Pointing) -> String {
    reached(&LIMITS, &mut Approach::default(), pointing, &sky()).unwrap_or_default()
}

#[test]
fn tracking_ends_just_before_the_limit() {
    let (east, west) = (Some(PierSide::East), Some(PierSide::West));
    let bare = |altitude_deg| Pointing { place: None, altitude_deg: Some(altitude_deg), side: east };
    assert_eq!(why(&bare(20.1)), "");
    assert!(why(&bare(20.03)).starts_with("altitude 20.03 deg"));
    assert!(why(&pointing(4.999, None, east)).starts_with("hour angle 5.00"));
    assert_eq!(why(&pointing(-4.999, None, west)), "", "rising");
}

#[test]
fn an_altitude_that_the_mounts_own_place_contradicts_is_not_believed() {
    // A star of declination = latitude passes the zenith, and stands 20 deg high 5.17 h later.
    let east = Some(PierSide::East);
    let limits = MountLimits { hour_angle_max_h: None, meridian_past_min: None, ..LIMITS };
    let why = |pointing: &Pointing| reached(&limits, &mut Approach::default(), pointing, &sky()).unwrap_or_default();
    assert_eq!(why(&pointing(4.9, None, east)), "");
    assert!(why(&pointing(5.3, None, east)).starts_with("altitude"), "reckoned where it is not reported");
    let high = Pointing { altitude_deg: Some(60.0), ..pointing(5.3, None, east) };
    assert!(why(&high).starts_with("altitude 1"), "{}", why(&high));
    let low = Pointing { altitude_deg: Some(5.0), ..pointing(2.0, None, east) };
    assert!(why(&low).starts_with("altitude 5"), "{}", why(&low));
}

#[test]
fn past_each_meridian_only_the_wrong_side_of_the_pier_is_stopped() {
    let limits = MountLimits { altitude_min_deg: -90.0, hour_angle_max_h: None, ..LIMITS };
    for (hour_angle_h, side, is_stopped) in [
        (0.24, Some(PierSide::West), false),
        (0.26, Some(PierSide::West), true),
        (0.26, Some(PierSide::East), false),
        (5.9, Some(PierSide::West), true),
        // From there on it comes down on the other side.
        (6.1, Some(PierSide::West), false),
        (11.9, Some(PierSide::East), false),
        (12.24, Some(PierSide::East), false),
        (12.26, Some(PierSide::East), true),
        (-11.74, Some(PierSide::East), true),
        (12.26, Some(PierSide::West), false),
        (-6.1, Some(PierSide::East), true),
        (-5.9, Some(PierSide::East), false),
        // A fork, or a mount that does not report its side.
        (0.26, None, false),
        (12.26, None, false),
    ] {
        for latitude_deg in [-24.6, 56.8] {
            let sky = sky_at(latitude_deg, 0.0);
            let ra = sky.sidereal_time() - Angle::from_hours(hour_angle_h);
            let place = Some(OfDate { ra, dec: Angle::from_degrees(80.0_f64.copysign(latitude_deg)) });
            let pointing = Pointing { place, altitude_deg: None, side };
            let why = reached(&limits, &mut Approach::default(), &pointing, &sky);
            assert_eq!(why.is_some(), is_stopped, "{hour_angle_h} h {side:?} at {latitude_deg} deg: {why:?}");
        }
    }
}

#[test]
fn a_mount_of_j2000_is_stopped_at_the_same_limit_as_one_of_date() {
    let (sky, now) = (sky(), at(0.0).machine);
    let limits = MountLimits { altitude_min_deg: -90.0, meridian_past_min: None, ..LIMITS };
    // By precession its own right ascension is more than a minute of time off.
    for (before_s, is_stopped) in [(40.0, false), (5.0, true)] {
        let ra = sky.sidereal_time() - Angle::from_hours(5.0 - before_s / 3600.0);
        let of_date = OfDate { ra, dec: Angle::from_degrees(-24.6) };
        let icrs = sky.of_date_to_icrs(&of_date);
        for (system, ra, dec) in [
            (EquatorialSystem::Topocentric, of_date.ra, of_date.dec),
            (EquatorialSystem::J2000, icrs.ra, icrs.dec),
            (EquatorialSystem::Other, icrs.ra, icrs.dec),
        ] {
            let mut watch = LimitWatch::new(limits.clone(), PARK);
            watch.place_deg = Some([ra.wrapped_positive().degrees(), dec.degrees()]);
            let why = watch.why(now, now, &MountSight { system, ..MountSight::default() }, &sky);
            assert_eq!(why.is_some(), is_stopped, "{system:?}, {before_s} s before the limit: {why:?}");
        }
    }
}
