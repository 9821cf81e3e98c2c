//! For any place of the sky and any horizon: a place that is not hidden is above both limits, by the cosine rule.

use proptest::prelude::*;
use proptest::test_runner::Config;
use sky::{EarthOrientation, Place};
use units::Angle;

use super::*;

const LATITUDE_DEG: f64 = -24.6;
const NIGHT: f64 = 1_795_228_200.0;

fn sky(at: Utc) -> Observer {
    let place = Place::new(Angle::from_degrees(LATITUDE_DEG), Angle::from_degrees(-70.4), 2500.0).unwrap();
    Observer::new(&place, &EarthOrientation::default(), at).unwrap()
}

/// Altitude and azimuth, degrees, of a place of date.
fn by_cosine_rule(sky: &Observer, target: &Icrs) -> [f64; 2] {
    let of_date = sky.to_of_date(target);
    let hour_angle = (sky.sidereal_time().degrees() - of_date.ra.degrees()).to_radians();
    let (latitude, dec) = (LATITUDE_DEG.to_radians(), of_date.dec.degrees().to_radians());
    let sine = latitude.sin() * dec.sin() + latitude.cos() * dec.cos() * hour_angle.cos();
    let south = latitude.sin() * dec.cos() * hour_angle.cos() - latitude.cos() * dec.sin();
    let west = dec.cos() * hour_angle.sin();
    [sine.asin().to_degrees(), (west.atan2(south).to_degrees() + 180.0).rem_euclid(360.0)]
}

/// Points of a horizon, 30 deg apart, with the altitude on the straight line between them.
fn wall_deg(walls: &[f64], azimuth_deg: f64) -> f64 {
    let (before, share) = ((azimuth_deg / 30.0).floor(), (azimuth_deg / 30.0).fract());
    let at = |index: f64| walls[index as usize % walls.len()];
    at(before) * (1.0 - share) + at(before + 1.0) * share
}

proptest! {
    #![proptest_config(Config { failure_persistence: None, ..Config::default() })]

    #[test]
    fn nothing_is_observed_behind_the_horizon_or_below_the_least_altitude(
        ra in 0.0..360.0_f64, dec in -90.0..90.0_f64, hours in 0.0..8760.0_f64, least in -5.0..60.0_f64,
        walls in prop::collection::vec(-5.0..70.0_f64, 12),
    ) {
        let points: Vec<[f64; 2]> = walls.iter().zip(0..).map(|(wall, n)| [f64::from(n) * 30.0, *wall]).collect();
        let horizon_limits = HorizonLimits::new(least, Some(Horizon::new(&points).unwrap()));
        let (at, target) = (Utc::from_seconds(NIGHT + 3600.0 * hours), Icrs::from_degrees(ra, dec));
        let sky = sky(at);
        let [altitude_deg, azimuth_deg] = by_cosine_rule(&sky, &target);
        let limit_deg = wall_deg(&walls, azimuth_deg).max(least).max(0.0);
        // Where the horizon is steep, a minute of arc of aberration along it is more across.
        let room_deg = 0.1 + 0.1 * 75.0 / 30.0 / altitude_deg.to_radians().cos().max(0.01);
        let reason = horizon_limits.hides(&target, &sky);
        prop_assert!(altitude_deg > limit_deg - room_deg || reason.is_some(), "{altitude_deg} deg, limit {limit_deg} deg");
        prop_assert!(altitude_deg < limit_deg + room_deg || reason.is_none(), "{altitude_deg}, {limit_deg}: {reason:?}");
        // It stands clear from the time that was computed, and at no earlier time.
        let until = at.plus_seconds(4.0 * 3600.0);
        let clear = horizon_limits.clear_from(&target, at, until, |at| Some(self::sky(at)));
        prop_assert_eq!(clear == Some(at), reason.is_none());
        if let Some(clear) = clear {
            prop_assert!(at <= clear && clear <= until);
            prop_assert!(horizon_limits.hides(&target, &self::sky(clear)).is_none());
        }
    }
}

#[test]
fn what_hides_a_target_is_reported_with_its_place_and_the_limit() {
    let at = Utc::from_seconds(NIGHT);
    let sky = sky(at);
    let stands = |altitude, azimuth| sky.to_icrs(&Horizontal::from_degrees(altitude, azimuth));
    let hill = Horizon::new(&[[0.0, 5.0], [80.0, 5.0], [90.0, 40.0], [100.0, 5.0]]).unwrap();
    let horizon_limits = HorizonLimits::new(20.0, Some(hill));
    for (altitude, azimuth, words) in [
        (-3.0, 200.0, Some("stands -3.0 deg high, below the horizon")),
        (10.0, 200.0, Some("stands 10.0 deg high, the least is 20 deg")),
        (30.0, 90.0, Some("at azimuth 90.0 deg, below the horizon of the site, which is 40.0 deg there")),
        (30.0, 120.0, None),
        (41.0, 90.0, None),
    ] {
        let reason = horizon_limits.hides(&stands(altitude, azimuth), &sky);
        match words {
            Some(words) => assert!(reason.as_ref().is_some_and(|reason| reason.contains(words)), "{reason:?}: {words}"),
            None => assert_eq!(reason, None, "{altitude} {azimuth}"),
        }
    }
    assert!(horizon_limits.hides(&Icrs::from_degrees(f64::NAN, 0.0), &sky).is_some(), "a place that is no number");
}

#[test]
fn the_least_altitude_is_the_higher_of_the_mounts_limit_and_of_what_schedules_are_held_against() {
    let config = |check: f64, limit: f64| {
        let text = format!(
            "[observatory]\nsite = \"test\"\ntelescope = \"alpha\"\nlatitude_deg = 10.0\nlongitude_deg = 0.0\n\
             elevation_m = 0.0\n[schedule.check]\naltitude_min_deg = {check:?}\n[[telescope]]\nname = \"mount\"\n\
             server = \"10.0.0.5:11111\"\nlimits = {{ altitude_min_deg = {limit:?} }}\n"
        );
        config::parse(&text, std::path::Path::new(".")).unwrap()
    };
    for (check, limit, least) in [(30.0, 20.0, 30.0), (10.0, 20.0, 20.0), (-5.0, 0.0, 0.0)] {
        let config = config(check, limit);
        assert_eq!(altitude_min_deg(&config, config.telescope.first()), least);
        assert_eq!(HorizonLimits::of(&config, &config.telescope[0]).unwrap(), HorizonLimits::new(least, None));
    }
}
