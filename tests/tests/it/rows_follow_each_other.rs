//! Between two `object` rows on one target nearly no time is lost, as measured by the times at which the simulated
//! camera began to expose.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::time::Duration;

use contract::Role;
use serde_json::json;
use simulator::{MountOptions, Simulator};
use test_support::{Harness, example};

const ROWS: usize = 6;
const FRAMES: u32 = 2;
const EXPOSURE_S: f64 = 0.5;
const READOUT_S: f64 = 0.2;
/// The most time in addition to the time of the devices.
const MOST: Duration = Duration::from_millis(500);

/// In real time, with devices that take no time themselves but for exposing and reading out.
fn world() -> simulator::Options {
    let mut world = simulator::Options {
        start: "2026-06-20T22:00:00Z".parse().unwrap(),
        latitude: units::Angle::from_degrees(56.773),
        longitude: units::Angle::from_degrees(24.404),
        ..Default::default()
    };
    world.mount = MountOptions { slew_deg_per_s: 1000.0, settle_s: 0.0, ..MountOptions::perfect() };
    (world.dome.slit, world.dome.shutter_s, world.dome.watchdog_s) = (None, 1.0, Some(120.0));
    let camera = &mut world.camera;
    (camera.width, camera.height, camera.pixel_um, camera.optics_fwhm_arcsec) = (256, 256, 54.0, 25.0);
    camera.readout_s = READOUT_S;
    world
}

/// The example's telescope, whose camera is not cooled and whose sky needs no dwell, and rows on one field.
fn files(simulator: &Simulator) -> (String, String) {
    let config = example("night/observatory.toml")
        .replace("127.0.0.1:11111", &simulator.address().to_string())
        .replace("temperature_c = -10\n", "")
        .replace("dwell_min = 1", "dwell_min = 0.02")
        .replace("name = \"mount\"\n", "name = \"mount\"\nsettle_s = 0.0\n");
    let rows = (0..ROWS).map(|row| {
        let value =
            json!({"object": "M 92", "ra": 259.281, "dec": 43.136, "exptime": EXPOSURE_S, "n": FRAMES, "filter": "V"});
        let row = json!({
            "device_name": "camera", "action_type": "object", "action_value": value,
            "start_time": format!("2026-06-20 22:00:0{row}"), "end_time": "2026-06-20 23:00:00",
        });
        format!("{row}\n")
    });
    (config + "\n[bus]\nmulticast = false\n[web]\nlisten = \"127.0.0.1:0\"\n", rows.collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_next_row_on_the_same_target_begins_within_half_a_second() -> anyhow::Result<()> {
    let mut harness = Harness::of_files(world(), files).await?;
    for role in [Role::Device, Role::Observatory, Role::Archive] {
        harness.start(role)?;
    }
    harness
        .until("the night ends", 90.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    let puts = harness.simulator.world().puts_since(0);
    let begun: Vec<_> = puts.iter().filter(|put| put.member == "startexposure" && put.error == Some(0)).collect();
    assert_eq!(begun.len(), ROWS * FRAMES as usize);
    let busy = Duration::from_secs_f64(EXPOSURE_S + READOUT_S);
    let gaps = |step: usize| {
        let pairs = begun.windows(2).enumerate().filter(move |(at, _)| (at + 1) % FRAMES as usize == step);
        let mut gaps: Vec<_> = pairs.map(|(_, pair)| (pair[1].at - pair[0].at).saturating_sub(busy)).collect();
        gaps.sort();
        gaps
    };
    let (within, between) = (gaps(1), gaps(0));
    println!("beyond what the devices take: between frames {within:?}, between rows {between:?}");
    // The requests to the devices meanwhile, for the last pair of rows.
    if let [.., last, next, _] = &begun[..] {
        for put in puts.iter().filter(|put| put.seq > last.seq && put.seq <= next.seq) {
            let at_ms = (put.at - last.at).as_secs_f64() * 1000.0;
            println!("{at_ms:6.0} ms {} {} {}", put.device.path(), put.member, put.parameters);
        }
    }
    assert_eq!(between.len(), ROWS - 1);
    // A test machine with other things to do lengthens some; a lost design lengthens all of them.
    assert!(between[between.len() / 4] <= MOST, "{between:?}");
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}
