//! Named mounts that come to a limit, each looked at once a second: what they are ordered, and when.

use bus::SkyTime;
use sky::{EarthOrientation, Place};
use units::{Angle, Utc};

use super::*;

const NIGHT: f64 = 1_795_228_200.0;
pub(super) const PARK: Duration = Duration::from_secs(300);

pub(super) fn sky_at(latitude_deg: f64, at_s: f64) -> Observer {
    let place = Place::new(Angle::from_degrees(latitude_deg), Angle::from_degrees(-70.4), 2500.0).unwrap();
    Observer::new(&place, &EarthOrientation::default(), Utc::from_seconds(NIGHT + at_s)).unwrap()
}

pub(super) fn sky() -> Observer {
    sky_at(-24.6, 0.0)
}

pub(super) fn at(seconds: f64) -> Now {
    // Long after the boot, so that nothing is before it.
    let since = Duration::from_secs_f64(10_000.0 + seconds);
    Now { machine: MachineTime::from_boot(since), sky: SkyTime::from_start(since) }
}

pub(super) const LIMITS: MountLimits =
    MountLimits { altitude_min_deg: 20.0, hour_angle_max_h: Some(5.0), meridian_past_min: Some(15.0) };

/// A mount, as it is and as it reports itself.
#[derive(Clone)]
struct Fake {
    latitude_deg: f64,
    ra_deg: f64,
    dec_deg: f64,
    tracks: bool,
    slews_until_s: f64,
    parked: bool,
    side: Option<PierSide>,
    /// What it does on orders.
    obeys_off: bool,
    obeys_abort: bool,
    obeys_park: bool,
    /// It says so long after an abort that it slews, s.
    slows_down_s: f64,
    /// What it reports.
    says_tracking: Option<bool>,
    says_altitude_deg: Option<f64>,
    hides_place: bool,
    hides_tracking: bool,
    hides_all: bool,
    ordered: Option<(Ordered, MachineTime)>,
}

impl Fake {
    /// Tracks at an altitude of some 20 deg in the west, and comes to the limit in a minute.
    fn coming_to_the_limit() -> Self {
        let sky = sky();
        // -24.6 deg passes the zenith; the altitude falls by 0.25 deg a minute.
        let ra_deg = (sky.sidereal_time() - Angle::from_hours(5.19)).wrapped_positive().degrees();
        Self {
            latitude_deg: -24.6,
            ra_deg,
            dec_deg: -24.6,
            tracks: true,
            slews_until_s: -1.0,
            parked: false,
            side: None,
            obeys_off: true,
            obeys_abort: true,
            obeys_park: true,
            slows_down_s: 0.0,
            says_tracking: None,
            says_altitude_deg: None,
            hides_place: false,
            hides_tracking: false,
            hides_all: false,
            ordered: None,
        }
    }

    /// At rest 10 deg high in the west, parked.
    fn parked_low() -> Self {
        let ra_deg = (sky().sidereal_time() - Angle::from_hours(5.9)).wrapped_positive().degrees();
        Self { ra_deg, parked: true, tracks: false, ..Self::coming_to_the_limit() }
    }

    fn sight(&self, seconds: f64) -> MountSight {
        let asked = at(seconds);
        let sky = sky_at(self.latitude_deg, seconds);
        let place = OfDate::from_degrees(self.ra_deg, self.dec_deg);
        let horizontal = sky.of_date_to_horizontal(&place);
        let seen = |value: f64, hidden: bool| (!hidden && !self.hides_all).then_some((value, asked));
        let flag = |value: bool| (!self.hides_all).then_some((value, asked));
        MountSight {
            system: EquatorialSystem::Topocentric,
            ra_deg: seen(self.ra_deg, self.hides_place),
            dec_deg: seen(self.dec_deg, self.hides_place),
            altitude_deg: seen(self.says_altitude_deg.unwrap_or(horizontal.altitude.degrees()), self.hides_place),
            azimuth_deg: seen(horizontal.azimuth.degrees(), self.hides_place),
            tracking: flag(self.says_tracking.unwrap_or(self.tracks)).filter(|_| !self.hides_tracking),
            slewing: flag(seconds < self.slews_until_s),
            at_park: flag(self.parked),
            pier_side: self.side.map(|side| (side, asked)),
            ordered: self.ordered,
        }
    }

    fn second(&mut self) {
        if !self.tracks {
            self.ra_deg += TURN_DEG_PER_S;
        }
    }

    fn obey(&mut self, command: &Command, seconds: f64) {
        match command {
            Command::Track { on: false } => {
                self.tracks &= !self.obeys_off;
                self.ordered = Some((Ordered::Stop, at(seconds).machine));
            }
            Command::Abort => {
                self.tracks &= !self.obeys_abort;
                if self.slows_down_s > 0.0 {
                    self.slews_until_s = seconds + self.slows_down_s;
                }
                self.ordered = Some((Ordered::Stop, at(seconds).machine));
            }
            Command::Park => {
                if self.obeys_park {
                    (self.tracks, self.slews_until_s) = (false, seconds + 20.0);
                }
                self.ordered = Some((Ordered::Go, at(seconds).machine));
            }
            other => panic!("{other:?} is no stop"),
        }
    }
}

/// Looks at a mount for so many seconds; returns each order with its second, and the last look.
fn watched(
    fake: &mut Fake,
    seconds: std::ops::Range<u32>,
    watch: &mut LimitWatch,
    mut each: impl FnMut(&mut Fake, u32),
) -> (Vec<(u32, &'static str)>, Looked) {
    let mut orders = Vec::new();
    let mut last = Looked::nothing(Alarm::Leave);
    for second in seconds {
        let now_s = f64::from(second);
        each(fake, second);
        if fake.slews_until_s > 0.0
            && now_s >= fake.slews_until_s
            && fake.ordered.is_some_and(|(o, _)| o == Ordered::Go)
        {
            (fake.parked, fake.slews_until_s) = (true, -1.0);
        }
        // Read half a second ago.
        let sight = fake.sight(now_s - 0.5);
        last = watch.look(at(now_s).machine, &sight, &sky_at(fake.latitude_deg, now_s), true);
        for command in &last.commands {
            orders.push((
                second,
                match command {
                    Command::Track { on: false } => "off",
                    Command::Abort => "abort",
                    Command::Park => "park",
                    other => panic!("{other:?}"),
                },
            ));
            fake.obey(command, now_s + 0.2);
        }
        fake.second();
    }
    (orders, last)
}

fn watch() -> LimitWatch {
    LimitWatch::new(MountLimits { hour_angle_max_h: None, ..LIMITS }, PARK)
}

fn words(orders: &[(u32, &'static str)]) -> Vec<&'static str> {
    orders.iter().map(|(_, word)| *word).collect()
}

#[test]
fn orders_follow_each_other_until_the_coordinates_show_that_it_stands() {
    let base = Fake::coming_to_the_limit();
    for (name, fake, expected) in [
        ("obeys at once", base.clone(), vec!["off"]),
        ("ignores the end of tracking", Fake { obeys_off: false, ..base.clone() }, vec!["off", "abort", "off"]),
        (
            "says that it stands and tracks on, and an abort stops it",
            Fake { obeys_off: false, says_tracking: Some(false), ..base.clone() },
            vec!["off", "abort", "off"],
        ),
        (
            "can only be parked",
            Fake { obeys_off: false, obeys_abort: false, ..base.clone() },
            vec!["off", "abort", "off", "park"],
        ),
        ("stands, and says for ever that it tracks", Fake { says_tracking: Some(true), ..base.clone() }, vec!["off"]),
    ] {
        let mut fake = Fake { ..fake };
        // A mount whose flag lies from the start is told by its coordinates.
        let (orders, last) = watched(&mut fake, 0..400, &mut watch(), |_, _| {});
        assert_eq!(words(&orders), expected, "{name}: {orders:?}");
        assert_eq!(last.beyond, None, "{name}");
        let (first, _) = orders[0];
        assert!((60..100).contains(&first), "{name}: the limit is reached after a minute and more: {orders:?}");
    }
}

#[test]
fn a_mount_that_nothing_stops_is_published_as_not_stopped_and_ordered_for_ever() {
    let deaf = Fake { obeys_off: false, obeys_abort: false, obeys_park: false, ..Fake::coming_to_the_limit() };
    let (orders, last) = watched(&mut deaf.clone(), 0..400, &mut watch(), |_, _| {});
    assert_eq!(words(&orders)[..4], ["off", "abort", "off", "park"], "{orders:?}");
    let first = orders[0].0;
    assert!(orders[3].0 - first <= 12, "parked within seconds: {orders:?}");
    assert!(orders.len() >= 12, "again and again: {orders:?}");
    let beyond = last.beyond.expect("published");
    assert!(beyond.not_stopped && beyond.why.starts_with("altitude"), "{beyond:?}");
    assert!(matches!(last.alarm, Alarm::Raise(cause) if cause.contains("no order stops it")));
    // Not at once: 45 s after the first order all of them had their time.
    let (_, early) = watched(&mut deaf.clone(), 0..first + 30, &mut watch(), |_, _| {});
    assert!(!early.beyond.expect("being stopped").not_stopped);
    let (_, later) = watched(&mut deaf.clone(), 0..first + 60, &mut watch(), |_, _| {});
    assert!(later.beyond.expect("being stopped").not_stopped);
}

#[test]
fn a_mount_that_slews_for_a_second_after_each_abort_is_parked_and_published_as_not_stopped() {
    let base = Fake { obeys_off: false, obeys_abort: false, obeys_park: false, ..Fake::coming_to_the_limit() };
    let deaf = Fake { slows_down_s: 1.0, ..base };
    let each = |fake: &mut Fake, second: u32| {
        if f64::from(second) > fake.slews_until_s {
            fake.slews_until_s = -1.0;
        }
    };
    let (orders, last) = watched(&mut deaf.clone(), 0..400, &mut watch(), each);
    assert_eq!(words(&orders)[..4], ["off", "abort", "off", "park"], "{orders:?}");
    assert!(orders[3].0 - orders[0].0 <= 12, "parked within seconds: {orders:?}");
    assert!(last.beyond.expect("published").not_stopped, "{orders:?}");
    let (_, slows_down) = watched(&mut deaf.clone(), 0..orders[1].0 + 2, &mut watch(), each);
    assert!(slows_down.beyond.is_some(), "it is not seen stopped");
}

#[test]
fn a_mount_that_somebody_slews_back_within_its_limits_is_stopped_no_longer() {
    let deaf = Fake { obeys_off: false, ..Fake::coming_to_the_limit() };
    let (orders, _) = watched(&mut deaf.clone(), 0..200, &mut watch(), |_, _| {});
    let (slews, arrives) = (orders[0].0 + 2, orders[0].0 + 40);
    for ordered_here in [true, false] {
        let each = |fake: &mut Fake, second: u32| {
            if second == slews {
                fake.slews_until_s = f64::from(arrives);
                if ordered_here {
                    fake.ordered = Some((Ordered::Go, at(f64::from(second) - 0.6).machine));
                }
            }
            if second == arrives {
                (fake.ra_deg, fake.slews_until_s) = (fake.ra_deg + 60.0, -1.0);
            }
        };
        let (_, on_its_way) = watched(&mut deaf.clone(), 0..slews + 10, &mut watch(), each);
        assert_eq!(on_its_way.beyond.is_none(), ordered_here, "nobody knows yet where it goes");
        let (orders, last) = watched(&mut deaf.clone(), 0..300, &mut watch(), each);
        assert_eq!((words(&orders), last.beyond, last.alarm), (vec!["off"], None, Alarm::Clear), "{orders:?}");
    }
}

#[test]
fn a_mount_that_says_that_it_is_parked_and_follows_the_sky_is_not_believed() {
    let base = Fake { obeys_off: false, obeys_abort: false, obeys_park: false, ..Fake::coming_to_the_limit() };
    let mut fake = Fake { says_tracking: Some(false), ..base };
    let each = |fake: &mut Fake, _: u32| {
        fake.parked |= fake.ordered.is_some_and(|(ordered, _)| ordered == Ordered::Go);
    };
    let (orders, last) = watched(&mut fake, 0..600, &mut watch(), each);
    assert_eq!(words(&orders)[..4], ["off", "abort", "off", "park"], "{orders:?}");
    assert!(orders.len() >= 8, "it is ordered on: {orders:?}");
    assert!(last.beyond.expect("published").not_stopped, "everything is to be closed");
}

#[test]
fn a_park_that_does_not_end_is_published_as_not_stopped_after_the_time_of_a_slew() {
    let base = Fake { obeys_off: false, obeys_abort: false, obeys_park: false, ..Fake::coming_to_the_limit() };
    let mut fake = base;
    let mut parks_since = None;
    let each = |fake: &mut Fake, second: u32| {
        if fake.ordered.is_some_and(|(ordered, _)| ordered == Ordered::Go) {
            parks_since.get_or_insert(second);
            // It slews for ever, and never arrives.
            fake.slews_until_s = f64::INFINITY;
            fake.ra_deg += 0.5;
        }
    };
    let (orders, last) = watched(&mut fake, 0..900, &mut watch(), each);
    assert_eq!(words(&orders)[..4], ["off", "abort", "off", "park"], "{orders:?}");
    assert!(last.beyond.expect("published").not_stopped);
    assert!(orders[4].0 - orders[3].0 >= 300, "it has the time of a slew: {orders:?}");
}

#[test]
fn a_mount_that_is_unparked_below_its_limit_and_slewed_away_is_left_alone() {
    for (unparks, tracks, slews, arrives) in [(5, 5, 6, 30), (5, 7, 12, 40), (5, 15, 30, 50)] {
        let mut fake = Fake::parked_low();
        let each = |fake: &mut Fake, second: u32| {
            let ordered = |ordered| Some((ordered, at(f64::from(second)).machine));
            if second == unparks {
                (fake.parked, fake.ordered) = (false, ordered(Ordered::Begin));
            }
            if second == tracks {
                (fake.tracks, fake.ordered) = (true, ordered(Ordered::Begin));
            }
            if second == slews {
                // It says only four seconds later that it slews.
                fake.ordered = ordered(Ordered::Go);
            }
            if second == slews + 4 {
                fake.slews_until_s = f64::from(arrives);
            }
            if second == arrives {
                (fake.ra_deg, fake.slews_until_s) = (fake.ra_deg + 60.0, -1.0);
                fake.ordered = ordered(Ordered::Begin);
            }
        };
        let (orders, last) = watched(&mut fake, 0..300, &mut watch(), each);
        assert_eq!((words(&orders), last.alarm), (vec![], Alarm::Clear), "{unparks} {tracks} {slews} {arrives}");
    }
}

#[test]
fn a_mount_that_is_left_tracking_below_its_limit_after_an_unpark_is_stopped() {
    let mut fake = Fake::parked_low();
    let each = |fake: &mut Fake, second: u32| {
        if second == 5 {
            (fake.parked, fake.tracks) = (false, true);
            fake.ordered = Some((Ordered::Begin, at(5.0).machine));
        }
    };
    let (orders, _) = watched(&mut fake, 0..300, &mut watch(), each);
    assert_eq!(words(&orders), ["off"]);
    assert!((35..40).contains(&orders[0].0), "{orders:?}");
    // One that is sent away again and again and does not go is stopped all the same.
    let mut deaf = Fake { parked: false, tracks: true, ..Fake::parked_low() };
    let each = |fake: &mut Fake, second: u32| {
        if second.is_multiple_of(10) && fake.tracks {
            fake.ordered = Some((Ordered::Go, at(f64::from(second)).machine));
        }
    };
    let (orders, _) = watched(&mut deaf, 0..300, &mut watch(), each);
    assert!(matches!(orders.first(), Some((120..=125, "off"))), "{orders:?}");
}

#[test]
fn a_mount_that_somebody_slews_beyond_its_limit_is_stopped_where_it_arrives() {
    for begins_parked in [true, false] {
        let mut fake = Fake { ra_deg: Fake::coming_to_the_limit().ra_deg + 60.0, ..Fake::parked_low() };
        (fake.parked, fake.tracks) = (begins_parked, !begins_parked);
        let low_deg = Fake::parked_low().ra_deg;
        // Another client moves it: this node ordered nothing.
        let each = |fake: &mut Fake, second: u32| match second {
            10 => (fake.parked, fake.slews_until_s) = (false, 25.0),
            25 => {
                (fake.ra_deg, fake.tracks, fake.slews_until_s) = (low_deg, true, -1.0);
                // That it slews no more is read first.
                (fake.hides_place, fake.hides_tracking) = (true, true);
            }
            28 => (fake.hides_place, fake.hides_tracking) = (false, false),
            _ => {}
        };
        let (orders, _) = watched(&mut fake, 0..60, &mut watch(), each);
        assert!(matches!(orders[..], [(28..=30, "off")]), "{orders:?}");
    }
}

#[test]
fn a_mount_that_went_where_it_was_sent_and_is_then_slewed_beyond_its_limit_is_stopped() {
    let mut fake = Fake { parked: false, tracks: true, ..Fake::parked_low() };
    let low_deg = fake.ra_deg;
    fake.ra_deg += 60.0;
    let each = |fake: &mut Fake, second: u32| match second {
        5 => fake.ordered = Some((Ordered::Go, at(5.0).machine)),
        6 => fake.slews_until_s = 9.0,
        // It has arrived, and another client has sent it on between two looks.
        9 => (fake.ra_deg, fake.slews_until_s, fake.ordered) = (low_deg, -1.0, Some((Ordered::Go, at(5.0).machine))),
        _ => {}
    };
    let (orders, _) = watched(&mut fake, 0..14, &mut watch(), each);
    assert!(matches!(orders[..], [(9..=12, "off")]), "{orders:?}");
}

#[test]
fn an_altitude_that_was_read_before_the_slew_is_not_judged_after_it() {
    let mut watch = watch();
    let mut fake = Fake { tracks: true, ..Fake::coming_to_the_limit() };
    fake.ra_deg += 45.0;
    let high = fake.sight(100.0);
    let low_before = Some((10.0, at(60.0)));
    for second in 0..60 {
        let slews = MountSight { slewing: Some((true, at(f64::from(second)))), altitude_deg: low_before, ..high };
        let looked = watch.look(at(f64::from(second)).machine, &slews, &sky(), true);
        assert_eq!(looked, Looked::nothing(Alarm::Leave));
    }
    // Fast polls bring all but the altitude, which is still that of the park.
    for second in 61..63 {
        let now = at(f64::from(second));
        let sight = MountSight { altitude_deg: low_before, slewing: Some((false, now)), ..high };
        let sight = MountSight {
            tracking: Some((true, now)),
            ra_deg: sight.ra_deg.map(|(ra, _)| (ra, now)),
            dec_deg: sight.dec_deg.map(|(dec, _)| (dec, now)),
            ..sight
        };
        assert_eq!(watch.look(now.machine, &sight, &sky(), true), Looked::nothing(Alarm::Clear));
    }
}

#[test]
fn coordinates_that_are_missing_or_frozen_keep_no_mount_from_its_limit() {
    // Its place is missing from the 20th second on: it has tracked on.
    let mut fake = Fake::coming_to_the_limit();
    let (orders, _) = watched(&mut fake, 0..200, &mut watch(), |fake, second| fake.hides_place = second >= 20);
    assert_eq!(orders.first().map(|(_, word)| *word), Some("off"));
    // Nobody ever knew where it points.
    let mut fake = Fake { hides_place: true, obeys_off: false, obeys_abort: false, ..Fake::coming_to_the_limit() };
    fake.ra_deg += 60.0;
    let (orders, last) = watched(&mut fake, 0..66, &mut watch(), |_, _| {});
    assert_eq!(words(&orders)[..1], ["off"], "{orders:?}");
    assert!(last.beyond.expect("published").why.contains("not known"), "{orders:?}");
    // Its altitude is frozen just above the limit.
    let mut fake = Fake { says_altitude_deg: Some(20.5), ..Fake::coming_to_the_limit() };
    let (orders, _) = watched(&mut fake, 0..300, &mut watch(), |_, _| {});
    assert_eq!(words(&orders), ["off"]);
    // One that does not answer any more goes on as it did: it is ordered to stop, which it may yet receive.
    let mut fake = Fake::coming_to_the_limit();
    let (orders, _) = watched(&mut fake, 0..300, &mut watch(), |fake, second| fake.hides_all = second >= 20);
    assert_eq!(words(&orders)[..4], ["off", "abort", "off", "park"], "{orders:?}");
    let mut fake = Fake { tracks: false, ..Fake::coming_to_the_limit() };
    let (orders, _) = watched(&mut fake, 0..300, &mut watch(), |fake, second| fake.hides_all = second >= 20);
    assert_eq!(orders, [], "it stood");
}

#[test]
fn parked_slewing_and_resting_mounts_are_left_alone() {
    let low = Fake { parked: false, ..Fake::parked_low() };
    for fake in [
        Fake { parked: true, ..low.clone() },
        Fake { tracks: false, ..low.clone() },
        // Some drivers report the last place for ever.
        Fake { tracks: false, says_tracking: Some(false), ..low.clone() },
    ] {
        let (orders, last) = watched(&mut fake.clone(), 0..200, &mut watch(), |_, _| {});
        assert_eq!((orders, last.alarm), (vec![], Alarm::Leave));
    }
    let mut slews = Fake { tracks: true, ..low.clone() };
    let (orders, _) = watched(&mut slews, 0..50, &mut watch(), |fake, _| {
        fake.slews_until_s = f64::INFINITY;
        fake.ra_deg += 1.0;
    });
    assert_eq!(orders, []);
    // One that only says so, and tracks, is none that slews.
    let mut lies = Fake::coming_to_the_limit();
    let (orders, _) = watched(&mut lies, 0..300, &mut watch(), |fake, _| fake.slews_until_s = f64::INFINITY);
    assert_eq!(orders.first().map(|(_, word)| *word), Some("off"));
}

#[test]
fn a_mount_past_its_lower_culmination_is_stopped_on_either_half_of_the_earth() {
    for latitude_deg in [56.8, -56.8] {
        let sky = sky_at(latitude_deg, 0.0);
        let mut fake = Fake {
            latitude_deg,
            ra_deg: (sky.sidereal_time() - Angle::from_hours(11.95)).wrapped_positive().degrees(),
            dec_deg: 80.0_f64.copysign(latitude_deg),
            side: Some(PierSide::East),
            ..Fake::coming_to_the_limit()
        };
        let (orders, _) = watched(&mut fake, 0..1500, &mut watch(), |_, _| {});
        // 3 min to the meridian, and 15 min past it.
        assert!(matches!(orders[..], [(1050..=1080, "off")]), "{latitude_deg}: {orders:?}");
        let mut turned = Fake { side: None, tracks: true, ..fake.clone() };
        turned.ra_deg = (sky.sidereal_time() - Angle::from_hours(11.95)).wrapped_positive().degrees();
        assert_eq!(watched(&mut turned, 0..1500, &mut watch(), |_, _| {}).0, [], "a fork passes");
    }
}
