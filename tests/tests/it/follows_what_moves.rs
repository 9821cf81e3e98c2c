//! The Moon, an asteroid and a satellite are followed by the rates of the mount: the simulated telescope looks where
//! the body is, for two minutes of each, and follows the stars again afterwards, also when rain ends the row.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::time::Duration;

use contract::observatory::RowStatus;
use serde_json::{Value, json};
use sky::moving::{Orbit, Satellite, Shape, When};
use sky::{Body, EarthOrientation, Observer, Place, separation};
use test_support::{Harness, HarnessOptions, row};
use units::{Angle, Utc};

/// Each body is followed for so long, sky s.
const FOLLOWED_S: f64 = 120.0;
const EXPOSURE_S: f64 = 20.0;
/// How far from it the telescope may look meanwhile.
const OFFSET_ARCSEC: f64 = 1.0;

fn options() -> HarnessOptions {
    let mut options = HarnessOptions::default();
    options.world.speed = 10.0;
    options.more = "[names]\nonline = false\n".to_owned();
    options.world.dome.slit = None;
    options.world.mount = simulator::MountOptions { slew_deg_per_s: 20.0, ..simulator::MountOptions::perfect() };
    options
}

fn observer(world: &simulator::Options, at: Utc) -> Observer {
    let place = Place::new(world.latitude, world.longitude, world.elevation_m).unwrap();
    Observer::new(&place, &EarthOrientation::default(), at).unwrap()
}

/// The first of these that stands high from now on for the test's length.
fn high(world: &simulator::Options, mut bodies: impl Iterator<Item = (Value, Body)>) -> (Value, Body) {
    let stands = |body: &Body| {
        [0.0, 1800.0].into_iter().all(|later_s| {
            let observer = observer(world, world.start.plus_seconds(later_s));
            body.seen(&observer).is_ok_and(|seen| observer.to_horizontal(&seen.icrs).altitude.degrees() > 35.0)
        })
    };
    bodies.find(|(_, body)| stands(body)).unwrap()
}

/// An asteroid of the main belt, wherever along its orbit it must be to stand high.
fn asteroid(world: &simulator::Options) -> (Value, Body) {
    let epoch = 2_461_365.5;
    let orbits = (0..24).map(|step| {
        let m_deg = f64::from(step) * 15.0;
        let elements = json!({
            "a_au": 2.36, "e": 0.09, "i_deg": 7.14, "node_deg": 103.7, "peri_deg": 151.5, "m_deg": m_deg, "epoch_jd": epoch,
        });
        let angles = [7.14, 103.7, 151.5].map(Angle::from_degrees);
        let when = When::MeanAnomaly { anomaly: Angle::from_degrees(m_deg), epoch };
        let orbit = Orbit::new(Shape::SemiMajorAxis(2.36), 0.09, (angles[0], angles[1], angles[2]), when).unwrap();
        (json!({ "object": "asteroid", "elements": elements }), Body::Orbit(orbit))
    });
    high(world, orbits)
}

/// A satellite that goes round in two weeks, wherever along its orbit it must be to stand high.
fn satellite(world: &simulator::Options) -> (Value, Body) {
    let orbits = (0..24).map(|step| {
        let first = with_sum("1 43435U 18038A   26324.50000000  .00000000  00000-0  00000+0 0  999".to_owned());
        let anomaly = f64::from(step) * 15.0;
        let second = with_sum(format!("2 43435  30.0000  60.0000 3000000 120.0000 {anomaly:8.4}  0.0730000000001"));
        let lines = format!("{first}\n{second}");
        let body = Body::Satellite(Box::new(Satellite::from_lines(&lines).unwrap()));
        (json!({ "object": "satellite", "lookup_name": "TLE", "tle": lines }), body)
    });
    high(world, orbits)
}

/// A line of elements with its checksum: digits, and 1 for each minus.
fn with_sum(line: String) -> String {
    let line = format!("{line:<68}");
    let sum: u32 = line.chars().map(|c| c.to_digit(10).unwrap_or(u32::from(c == '-'))).sum();
    format!("{line}{}", sum % 10)
}

#[tokio::test(flavor = "multi_thread")]
async fn moving_targets_are_held_within_an_arcsecond_and_the_mount_then_follows_the_stars() -> anyhow::Result<()> {
    let world = options().world;
    let moon = (json!({ "object": "Moon", "lookup_name": "Moon" }), Body::Moon);
    let targets = [moon, asteroid(&world), satellite(&world)];
    let rows = |_: &simulator::Options| {
        let frames = |value: &Value| {
            let mut value = value.clone();
            (value["exptime"], value["n"]) = (json!(EXPOSURE_S), json!((FOLLOWED_S / EXPOSURE_S) as u32 + 1));
            row("object", value)
        };
        let mut rows = vec![row("open", json!({}))];
        // No service is asked for this name: the row rests, and all others go on.
        rows.push(row("object", json!({ "object": "Vega", "lookup_name": "Vega", "exptime": EXPOSURE_S, "n": 1 })));
        rows.extend(targets.iter().map(|(value, _)| frames(value)));
        // A row that never ends by itself.
        let mut endless = targets[0].0.clone();
        endless["exptime"] = json!(EXPOSURE_S);
        rows.push(row("object", endless));
        rows
    };
    let mut harness = Harness::new(options(), rows).await?;
    for role in [contract::Role::Device, contract::Role::Observatory] {
        harness.start(role)?;
    }
    for (number, (value, body)) in (2_u32..).zip(&targets) {
        let exposing = |harness: &Harness| {
            harness.night.get().is_some_and(|received| {
                received.sample.body.actions.iter().any(|now| now.row == number && now.step.starts_with("exposing"))
            })
        };
        harness.until(&format!("frames of {}", value["object"]), 90.0, exposing).await?;
        let (began, _) = harness.simulator.world().looks_at_when();
        let (mut worst, mut looks) = (0.0_f64, 0);
        loop {
            let (now, icrs) = harness.simulator.world().looks_at_when();
            if now.seconds_since(began) > FOLLOWED_S {
                break;
            }
            let off_arcsec = separation(&icrs, &body.seen(&observer(&world, now))?.icrs).arcseconds();
            (worst, looks) = (worst.max(off_arcsec), looks + 1);
            assert!(
                off_arcsec < OFFSET_ARCSEC,
                "{}: {off_arcsec} arcsec off\n{}",
                value["object"],
                harness.last_words()
            );
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        println!("{}: at most {worst:.3} arcsec off in {looks} looks", value["object"]);
        assert!(looks > 50, "{looks}");
        let ended = |harness: &Harness| {
            harness
                .schedule
                .get()
                .is_some_and(|received| received.sample.body.rows[number as usize].status == RowStatus::Finished)
        };
        harness.until("the row ends", 30.0, ended).await?;
    }
    let rested = harness.schedule.get().unwrap().sample.body.rows[1].clone();
    assert!(rested.status != RowStatus::Finished && rested.detail.contains("not been looked up"), "{rested:?}");
    // The endless row: the Moon again, until it rains.
    harness
        .until("the Moon is followed", 60.0, |harness| harness.simulator.world().rates_arcsec_per_s()[0] > 0.1)
        .await?;
    harness.simulator.world().set_weather(simulator::Quantity::RainRate, Some(3.0));
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    harness.until("the mount ends parked", 60.0, Harness::is_parked).await?;
    assert_eq!(harness.simulator.world().rates_arcsec_per_s(), [0.0; 2], "{}", harness.last_words());
    Ok(())
}
