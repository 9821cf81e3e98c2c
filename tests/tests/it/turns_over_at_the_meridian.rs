//! A German mount is turned over between two frames once the next would end too far past the meridian, and the
//! telescope is proven to be on its target again; a mount that ignores the flip goes on until its own limit, and is not
//! slewed for ever.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::time::Duration;

use bus::Catch;
use contract::device::camera::Frame;
use contract::device::telescope::PierSide;
use contract::observatory::{ActionNow, RowStatus};
use contract::{Address, Topic};
use serde_json::{Value, json};
use sky::{EarthOrientation, Icrs, Observer, OfDate, Place};
use test_support::{Harness, HarnessOptions, row};
use units::Angle;

/// How long before the meridian the targets stand when the night begins, min: of the mount that ignores flips, and of
/// the one that turns over.
const BEFORE_MIN: [f64; 2] = [6.0, 13.0];
const FRAMES: u32 = 30;

fn options() -> HarnessOptions {
    let mut options = HarnessOptions::default();
    // The sky moves while the nodes start: the first target must still be before the meridian then.
    options.world.speed = 10.0;
    options.world.dome.slit = None;
    let camera = &mut options.world.camera;
    (camera.width, camera.height, camera.pixel_um) = (512, 512, 13.5 * 4.0);
    camera.optics_fwhm_arcsec = 25.0;
    let mount = &mut options.world.mount;
    (mount.pointing_error_arcmin, mount.scatter_arcsec, mount.slew_deg_per_s) = (8.0, 2.0, 20.0);
    options.mount_block = "meridian_flip = true\nmeridian_flip_min = 1.0\n";
    options
}

/// A place that culminates so many minutes after the start.
fn before_the_meridian(world: &simulator::Options, minutes: f64) -> Icrs {
    let place = Place::new(world.latitude, world.longitude, world.elevation_m).unwrap();
    let observer = Observer::new(&place, &EarthOrientation::default(), world.start).unwrap();
    let ra = observer.sidereal_time() + Angle::from_hours(minutes / 60.0);
    observer.of_date_to_icrs(&OfDate { ra, dec: Angle::from_degrees(-45.0) })
}

fn target(world: &simulator::Options, name: &str, minutes: f64, pointing: bool) -> (&'static str, Value) {
    let at = before_the_meridian(world, minutes);
    let (ra, dec) = (at.ra.wrapped_positive().degrees(), at.dec.degrees());
    row("object", json!({ "object": name, "ra": ra, "dec": dec, "exptime": 10, "n": FRAMES, "pointing": pointing }))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_is_turned_over_once_and_one_that_ignores_it_is_not_asked_again() -> anyhow::Result<()> {
    let rows = |world: &simulator::Options| {
        let [stays, turns] = BEFORE_MIN;
        vec![row("open", json!({})), target(world, "stays", stays, false), target(world, "turns", turns, true)]
    };
    let mut harness = Harness::new(options(), rows).await?;
    harness.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(0.1));
    let address = Address::new(test_support::SITE, test_support::TELESCOPE)?;
    let frames = harness.bus.subscribe::<Frame>(Topic::Frame.at(&address), Catch::All, 1000).await?;
    for role in [contract::Role::Device, contract::Role::Observatory] {
        harness.start(role)?;
    }
    let status =
        |harness: &Harness, row: usize| harness.schedule.get().map(|received| received.sample.body.rows[row].status);
    let side = |harness: &Harness| {
        harness.mount.get().and_then(|received| received.sample.body.fields.pier_side.known().copied())
    };
    let exposes = |harness: &Harness, row: u32| {
        let exposes = |now: &ActionNow| now.row == row && now.step.starts_with("exposing");
        harness.night.get().is_some_and(|received| received.sample.body.actions.iter().any(exposes))
    };
    harness.until("frames of the first row", 60.0, |harness| exposes(harness, 1)).await?;
    assert_eq!(side(&harness), Some(PierSide::West), "it looks east");
    harness.simulator.world().ignore_flips(true);
    harness.until("the first row ends", 120.0, |harness| status(harness, 1) == Some(RowStatus::Finished)).await?;
    assert_eq!(side(&harness), Some(PierSide::West), "it looks east still");
    let stayed = harness.schedule.get().unwrap().sample.body.rows[1].clone();
    assert_eq!(stayed.frames, FRAMES);
    assert!(stayed.detail.contains("stayed on its side of the pier"), "{stayed:?}");

    harness.simulator.world().ignore_flips(false);
    harness.until("frames of the second row", 60.0, |harness| exposes(harness, 2)).await?;
    assert_eq!(side(&harness), Some(PierSide::West));
    harness.until("the mount turns over", 90.0, |harness| side(harness) == Some(PierSide::East)).await?;
    harness.until("the second row ends", 90.0, |harness| status(harness, 2) == Some(RowStatus::Finished)).await?;
    assert_eq!(harness.schedule.get().unwrap().sample.body.rows[2].frames, FRAMES, "none is lost and none doubled");
    // The frames by row and sort, in their order.
    let mut received = Vec::new();
    while let Ok(frame) = tokio::time::timeout(Duration::from_millis(200), frames.recv()).await {
        let purpose = frame.sample.body.purpose;
        received.push((purpose.row.unwrap(), purpose.action));
    }
    let of_second: Vec<&str> =
        received.iter().filter(|(row, _)| *row == 2).map(|(_, action)| action.as_str()).collect();
    let first = of_second.iter().position(|action| *action == "object").unwrap();
    let again = of_second[first..].iter().position(|action| *action == "pointing");
    assert!(again.is_some(), "after the flip it is proven again where it looks: {of_second:?}");
    harness.until("the dome ends shut", 90.0, Harness::is_shut).await?;
    Ok(())
}
