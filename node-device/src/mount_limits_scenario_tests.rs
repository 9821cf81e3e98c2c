//! A mount that tracks through the night, looked at every two seconds, however it reports its pier side and however
//! often it must be ordered to stop: it is stopped before each of its limits.

use bus::SkyTime;
use sky::{EarthOrientation, Place};
use units::{Angle, Utc};

use super::*;

const NIGHT: f64 = 1_795_228_200.0;
/// The mount is looked at so often, s: the watch is ten seconds ahead, and repeats an order after five.
const LOOK_S: usize = 2;

fn sky(at_s: f64) -> Observer {
    let place = Place::new(Angle::from_degrees(-24.6), Angle::from_degrees(-70.4), 2500.0).unwrap();
    Observer::new(&place, &EarthOrientation::default(), Utc::from_seconds(NIGHT + at_s)).unwrap()
}

/// How a driver reports the pier side.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SideReport {
    Truly,
    /// The two the wrong way round.
    Inverted,
    /// What was true so many seconds ago.
    Late(f64),
    /// Nothing for a while around the meridian, from then on the truth.
    NothingUntil(f64),
}

/// A German mount that has looked east since long. It turns over at an hour angle, if ever, and
/// takes no notice of the first orders to stop.
struct German {
    reports: SideReport,
    hour_angle_h: f64,
    dec_deg: f64,
    turns_at_h: Option<f64>,
    deaf: u32,
}

impl German {
    fn has_turned(&self, hour_angle_h: f64) -> bool {
        self.turns_at_h.is_some_and(|turns_h| hour_angle_h >= turns_h)
    }

    fn side(&self, hour_angle_h: f64) -> Option<PierSide> {
        let truth = |h| if self.has_turned(h) { PierSide::East } else { PierSide::West };
        match self.reports {
            SideReport::Truly => Some(truth(hour_angle_h)),
            SideReport::Inverted if truth(hour_angle_h) == PierSide::West => Some(PierSide::East),
            SideReport::Inverted => Some(PierSide::West),
            SideReport::Late(late_s) => Some(truth(hour_angle_h - late_s / 3600.0)),
            SideReport::NothingUntil(from_h) => {
                (hour_angle_h >= from_h || hour_angle_h < -0.05).then(|| truth(hour_angle_h))
            }
        }
    }

    /// Hour angle (h) and altitude (deg) at which its tracking ends, and whether it had turned over by then.
    fn ends(mut self, limits: &MountLimits) -> (f64, f64, bool) {
        let (begins_h, sidereal) = (self.hour_angle_h, 1.002_737_909);
        let mut watch = LimitWatch::new(limits.clone(), Duration::from_secs(300));
        for second in (0..80_000_u32).step_by(LOOK_S) {
            let at_s = f64::from(second);
            let hour_angle_h = begins_h + at_s * sidereal / 3600.0;
            if hour_angle_h.abs() > 11.9 {
                break;
            }
            let sky = sky(at_s);
            let ra = sky.sidereal_time() - Angle::from_hours(hour_angle_h);
            let place = OfDate { ra, dec: Angle::from_degrees(self.dec_deg) };
            let altitude_deg = sky.of_date_to_horizontal(&place).altitude.degrees();
            let turned_since_s = self.turns_at_h.map(|turns_h| (hour_angle_h - turns_h) * 3600.0);
            let since_boot = Duration::from_secs(1000 + u64::from(second));
            let now = Now { machine: MachineTime::from_boot(since_boot), sky: SkyTime::from_start(since_boot) };
            // A slew to the place where it points moves both axes.
            let slews = turned_since_s.is_some_and(|since_s| (0.0..30.0).contains(&since_s));
            let sight = MountSight {
                system: EquatorialSystem::Topocentric,
                ra_deg: Some((ra.wrapped_positive().degrees(), now)),
                dec_deg: Some((self.dec_deg, now)),
                tracking: Some((true, now)),
                slewing: Some((slews, now)),
                at_park: Some((false, now)),
                pier_side: self.side(hour_angle_h).map(|side| (side, now)),
                ..MountSight::default()
            };
            let looked = watch.look(now.machine, &sight, &sky, true);
            if !looked.commands.is_empty() {
                if self.deaf == 0 {
                    return (hour_angle_h, altitude_deg, self.has_turned(hour_angle_h));
                }
                self.deaf -= 1;
            }
        }
        (f64::INFINITY, f64::NEG_INFINITY, false)
    }
}

/// How far past the meridian a mount is stopped that ought to turn over at `turns_at_h` and reports its side so, h.
fn ends_h(reports: SideReport, turns_at_h: Option<f64>) -> f64 {
    let limits = MountLimits { altitude_min_deg: 20.0, hour_angle_max_h: None, meridian_past_min: Some(15.0) };
    German { reports, hour_angle_h: -0.1, dec_deg: -45.0, turns_at_h, deaf: 0 }.ends(&limits).0
}

#[test]
fn a_mount_that_ignores_its_flip_is_stopped_past_the_meridian_however_it_reports_its_side() {
    for reports in [
        SideReport::Truly,
        SideReport::Inverted,
        SideReport::Late(60.0),
        SideReport::NothingUntil(0.4),
        SideReport::NothingUntil(9.0),
    ] {
        let ends_h = ends_h(reports, None);
        assert!(
            (0.24..0.25).contains(&ends_h),
            "{reports:?}: stopped {ends_h} h past the meridian, the limit is 0.25 h"
        );
    }
}

#[test]
fn a_mount_that_turns_over_and_reports_it_a_minute_late_goes_on_into_the_west() {
    for reports in [SideReport::Truly, SideReport::Late(60.0)] {
        let ends_h = ends_h(reports, Some(0.1));
        assert!(ends_h > 4.0, "{reports:?}: stopped {ends_h} h past the meridian");
    }
}

#[test]
fn a_mount_that_turns_over_and_reports_its_sides_the_wrong_way_round_is_stopped_for_safety() {
    // Nothing distinguishes it from one that points back over its pier: that is what the limit is for.
    let ends_h = ends_h(SideReport::Inverted, Some(0.1));
    assert!((0.24..0.25).contains(&ends_h), "stopped {ends_h} h past the meridian, the limit is 0.25 h");
}

/// Tracks a mount to its end; by what it goes beyond its limits, if at all.
fn beyond(german: German, limits: &MountLimits) -> Option<String> {
    let (most_h, past_min) = (limits.hour_angle_max_h.unwrap(), limits.meridian_past_min.unwrap());
    let (ends_h, altitude_deg, has_turned) = german.ends(limits);
    let least = limits.altitude_min_deg;
    // A mount that misses one order receives the next one, five seconds later, and the watch is ten seconds ahead.
    if ends_h > most_h {
        Some(format!("tracks until {ends_h} h, the limit is {most_h} h"))
    } else if altitude_deg < least {
        Some(format!("tracks down to {altitude_deg} deg, the limit is {least} deg"))
    } else {
        let is_past = !has_turned && ends_h * 60.0 > past_min;
        is_past.then(|| format!("{} min past, the limit is {past_min}", ends_h * 60.0))
    }
}

#[test]
fn neither_a_deaf_mount_nor_one_whose_reports_are_wrong_tracks_beyond_its_limits() {
    let cases = [
        (SideReport::Truly, true, -70.0, [0.0, 2.0, 25.0]),
        (SideReport::Inverted, false, 10.0, [40.0, 1.2, 5.0]),
        (SideReport::Late(60.0), true, -20.0, [30.0, 0.5, 15.0]),
        (SideReport::NothingUntil(0.5), false, -45.0, [10.0, 1.5, 20.0]),
    ];
    for (deaf, (reports, turns, dec_deg, [least, most_h, past_min])) in (0..2).cycle().zip(cases) {
        let limits =
            MountLimits { altitude_min_deg: least, hour_angle_max_h: Some(most_h), meridian_past_min: Some(past_min) };
        let german = German { reports, hour_angle_h: -0.1, dec_deg, turns_at_h: turns.then_some(0.02), deaf };
        assert_eq!(beyond(german, &limits), None, "{reports:?}");
    }
}

mod proof {
    use proptest::prelude::*;
    use proptest::test_runner::Config;

    use super::*;

    fn reports() -> impl Strategy<Value = SideReport> {
        prop_oneof![
            Just(SideReport::Truly),
            Just(SideReport::Inverted),
            (0.0..120.0_f64).prop_map(SideReport::Late),
            (0.0..1.0_f64).prop_map(SideReport::NothingUntil),
        ]
    }

    // A random property.
    proptest! {
        // Each is hours of a night.
        #![proptest_config(Config { cases: 6, failure_persistence: None, ..Config::default() })]

        #[test]
        fn no_mount_tracks_beyond_a_limit(
            (reports, turns) in (reports(), prop::bool::ANY), begins_h in -0.3..-0.05_f64, dec_deg in -70.0..10.0_f64,
            least in 0.0..40.0_f64, most_h in 0.5..2.0_f64, past_min in 5.0..25.0_f64, deaf in 0..2_u32,
        ) {
            let limits = MountLimits {
                altitude_min_deg: least, hour_angle_max_h: Some(most_h), meridian_past_min: Some(past_min),
            };
            let turns_at_h = turns.then_some(0.02);
            let german = German { reports, hour_angle_h: begins_h, dec_deg, turns_at_h, deaf };
            prop_assert_eq!(beyond(german, &limits), None);
        }
    }
}
