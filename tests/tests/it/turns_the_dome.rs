//! The dome's slit is where the telescope looks, as the light shows that reaches the camera in the simulated world.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use serde_json::json;
use simulator::SlitOptions;
use sky::{EarthOrientation, Horizontal, Observer, Place};
use test_support::{Harness, HarnessOptions, Rows, row};

/// A target at this altitude and azimuth at the start.
fn field(
    world: &simulator::Options,
    name: &str,
    altitude: f64,
    azimuth: f64,
    n: u32,
) -> (&'static str, serde_json::Value) {
    let place = Place::new(world.latitude, world.longitude, world.elevation_m).unwrap();
    let observer = Observer::new(&place, &EarthOrientation::default(), world.start).unwrap();
    let target = observer.to_icrs(&Horizontal::from_degrees(altitude, azimuth));
    let (ra_deg, dec_deg) = (target.ra.wrapped_positive().degrees(), target.dec.degrees());
    row("object", json!({ "object": name, "ra": ra_deg, "dec": dec_deg, "exptime": 60.0, "n": n }))
}

/// Hours in the north-east up to the meridian, then one frame in the west.
fn far_apart(world: &simulator::Options) -> Rows {
    vec![field(world, "North-east", 45.0, 40.0, 120), field(world, "West", 60.0, 280.0, 3)]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_dome_follows_a_german_mount_through_hours_without_a_hidden_second() -> anyhow::Result<()> {
    let mut options = HarnessOptions { window_s: 6.0 * 3600.0, ..Default::default() };
    options.world.speed = 60.0;
    options.world.dome.turn_deg_per_s = 1.0;
    options.world.mount.arm_m = 0.45;
    let axes_m = [0.1, -0.15, 0.2];
    options.world.dome.slit = Some(SlitOptions { radius_m: 2.5, width_m: 1.2, past_zenith_m: 0.6, axes_m });
    options.mount_block = "aperture_m = 0.35\narm_m = 0.45\n";
    options.dome_block = "slit = { width_m = 1.2, radius_m = 2.5, east_m = 0.1, north_m = -0.15, up_m = 0.2 }\n";
    let mut harness = Harness::new(options, far_apart).await?;
    for role in [contract::Role::Device, contract::Role::Observatory] {
        harness.start(role)?;
    }
    harness
        .until("the night ends", 400.0, |harness| {
            harness.night.get().is_some_and(|received| received.sample.body.ended)
        })
        .await?;
    let rows = harness.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default();
    assert!(rows.iter().all(|row| row.status == contract::observatory::RowStatus::Finished), "{rows:?}");
    let world = harness.simulator.world().state();
    let (dome, exposed_s) = (&world["dome"], world["dome"]["exposed_s"].as_f64().unwrap_or_default());
    println!("turns {}, turned {:.0} deg, exposed {exposed_s:.0} s", dome["turns"], dome["turned_deg"]);
    assert!(exposed_s > 120.0 * 60.0, "{dome}");
    assert_eq!(dome["vignetted_s"], 0.0, "{dome}");
    // To the first field, after it through some 40 deg in two hours, and to the second; a follower at 2 deg turns 20
    // times.
    assert!(dome["turns"].as_u64().is_some_and(|turns| (3..=7).contains(&turns)), "{dome}");
    let puts = harness.simulator.world().puts_since(0);
    let first = |member: &str| puts.iter().find(|put| put.member == member).map(|put| put.seq).unwrap_or(u64::MAX);
    assert!(first("slewtoazimuth") < first("openshutter"), "the slit turns before the shutter opens");
    Ok(())
}
