//! The meridian flip beyond the plain one: of a target that moves among the stars, and of a mount that is late to
//! report the side of its pier.

use std::time::Duration;

use contract::device::telescope::PierSide;
use simulator::{Fault, Kind};
use sky::{Body, EarthOrientation, Icrs, Observer, OfDate, Place};
use units::{Angle, Utc};

use crate::MOST;
use crate::sim::{NIGHT, Sim, wide_field};

const SPEED: f64 = 20.0;
/// Targets culminate so long after the start, min: the roof opens and frames are taken before, also on a machine that
/// takes half a minute for that.
const BEFORE_MIN: f64 = 10.0;
const FRAMES: u32 = 24;
const SLEW: &str = "slewtocoordinatesasync";

fn observer(options: &simulator::Options, at: Utc) -> Observer {
    let place = Place::new(options.latitude, options.longitude, options.elevation_m).unwrap();
    Observer::new(&place, &EarthOrientation::default(), at).unwrap()
}

fn options() -> simulator::Options {
    let mut options = wide_field(SPEED);
    options.mount = simulator::MountOptions { slew_deg_per_s: 20.0, ..simulator::MountOptions::perfect() };
    options
}

async fn observing(options: simulator::Options, object: &str) -> Sim {
    let more = "[imaging]\nsolve = false\n[names]\nonline = false\n";
    let mut sim = Sim::with_mount(options, more, "meridian_flip = true\nmeridian_flip_min = 1.0\n").await;
    let row = format!("{{{object}, \"exptime\": 30, \"n\": {FRAMES}}}");
    sim.write_schedule(&[("object", &row)], 18_000.0);
    sim.start().await;
    sim.until("frames before the meridian", MOST, |sim| frames(sim) > 1).await;
    assert_eq!(side(&sim), PierSide::West, "it looks east");
    sim
}

fn frames(sim: &Sim) -> u32 {
    sim.schedule.get().and_then(|received| received.sample.body.rows.first().map(|row| row.frames)).unwrap_or(0)
}

/// On which side of its pier the tube truly is.
fn side(sim: &Sim) -> PierSide {
    let state = sim.simulator.world().state();
    if state["telescope"]["pier_west"].as_bool().unwrap() { PierSide::West } else { PierSide::East }
}

fn slews(sim: &Sim) -> usize {
    sim.sent_to_mount(0).iter().filter(|(member, _)| member == SLEW).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_is_turned_over_under_the_moon_and_follows_it_on_the_other_side() {
    let mut options = options();
    let moon = Body::Moon;
    // From sunset on, until it stands so long before the meridian.
    let before = |at: Utc| {
        let sky = observer(&options, at);
        sky.hour_angle(&moon.seen(&sky).unwrap().icrs).hours() * 60.0 + BEFORE_MIN
    };
    let night = (0..24 * 60).map(|minute| Utc::from_seconds(NIGHT - 43_200.0 + 60.0 * f64::from(minute)));
    let start = night.filter(|at| before(*at).abs() < 1.0).min_by(|a, b| before(*a).abs().total_cmp(&before(*b).abs()));
    options.start = start.unwrap();
    let sim = observing(options, "\"object\": \"Moon\", \"lookup_name\": \"Moon\"").await;

    sim.until("turned over", MOST, |sim| side(sim) == PierSide::East).await;
    let taken = frames(&sim);
    sim.until("frames on the other side", MOST, |sim| frames(sim) > taken + 2).await;
    let off_arcsec = |sim: &Sim| {
        let (at, looks) = sim.simulator.world().looks_at_when();
        sky::separation(&looks, &moon.seen(&observer(&sim.options, at)).unwrap().icrs).arcseconds()
    };
    // It goes 10 arcsec in a second of this machine, which may be busy; how near it is held is measured by whole nights.
    sim.until("on the Moon after the flip", MOST, |sim| off_arcsec(sim) < 60.0).await;
    let rates = sim.simulator.world().rates_arcsec_per_s();
    assert!(rates[0].hypot(rates[1]) > 0.2, "at its own rates: {rates:?} arcsec/s");
    sim.until("the row observed", MOST, |sim| sim.ended(0).is_some()).await;
    assert_eq!(frames(&sim), FRAMES, "none is lost and none doubled");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_is_late_to_report_its_side_is_not_taken_to_have_stayed() {
    let options = options();
    let sky = observer(&options, options.start);
    let ra = sky.sidereal_time() + Angle::from_hours(BEFORE_MIN / 60.0);
    let target: Icrs = sky.of_date_to_icrs(&OfDate { ra, dec: Angle::from_degrees(-45.0) });
    let (ra, dec) = (target.ra.wrapped_positive().degrees(), target.dec.degrees());
    let sim = observing(options, &format!("\"object\": \"field\", \"ra\": {ra}, \"dec\": {dec}")).await;
    // From now on its driver repeats the side of before.
    sim.simulator.world().fault(Kind::Telescope, Fault::stale().only(&["sideofpier"]));
    let before = slews(&sim);
    sim.until("turned over", MOST, |sim| side(sim) == PierSide::East && !sim.simulator.world().is_slewing()).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    sim.simulator.world().clear_faults();
    sim.until("the row observed", MOST, |sim| sim.ended(0).is_some()).await;
    let report = sim.ended(0).unwrap();
    assert!(!report.contains("stayed on its side"), "{report}");
    assert_eq!((slews(&sim) - before, frames(&sim)), (1, FRAMES), "turned over by one slew");
    sim.stop().await;
}
