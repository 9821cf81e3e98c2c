//! A German mount is turned over between two frames once the next would end too far past the meridian, and the
//! telescope is proven to be on its target again; a mount that ignores the flip goes on until its own limit, and is not
//! slewed for ever.

#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

use std::time::Duration;

use bus::Catch;
use contract::device::camera::Frame;
use contract::device::telescope::PierSide;
use contract::observatory::{ActionNow, RowStatus};
use serde_json::{Value, json};
use sky::{EarthOrientation, Icrs, Observer, OfDate, Place};
use test_support::{Rig, RigOptions, row};
use units::Angle;

/// How long before the meridian the targets stand when the night begins, min: of the mount that ignores flips, and of
/// the one that turns over.
const BEFORE_MIN: [f64; 2] = [6.0, 13.0];
const FRAMES: u32 = 30;

fn options() -> RigOptions {
    let mut options = RigOptions::default();
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
    let mut rig = Rig::new(options(), rows).await?;
    rig.simulator.world().set_weather(simulator::Quantity::StarFwhm, Some(0.1));
    let expression =
        format!("{}/{}/{}/device/camera/*/frame", contract::key::ROOT, test_support::SITE, test_support::TELESCOPE);
    let frames = rig.bus.subscribe::<Frame>(&expression, Catch::All, 1000).await?;
    for role in [contract::Role::Device, contract::Role::Observatory] {
        rig.start(role)?;
    }
    let status = |rig: &Rig, row: usize| rig.schedule.get().map(|heard| heard.said.body.rows[row].status);
    let side = |rig: &Rig| rig.mount.get().and_then(|heard| heard.said.body.fields.pier_side.known().copied());
    let exposes = |rig: &Rig, row: u32| {
        let exposes = |now: &ActionNow| now.row == row && now.step.starts_with("exposing");
        rig.night.get().is_some_and(|heard| heard.said.body.actions.iter().any(exposes))
    };
    rig.until("frames of the first row", 60.0, |rig| exposes(rig, 1)).await?;
    assert_eq!(side(&rig), Some(PierSide::West), "it looks east");
    rig.simulator.world().ignore_flips(true);
    rig.until("the first row ends", 120.0, |rig| status(rig, 1) == Some(RowStatus::Finished)).await?;
    assert_eq!(side(&rig), Some(PierSide::West), "it looks east still");
    let stayed = rig.schedule.get().unwrap().said.body.rows[1].clone();
    assert_eq!(stayed.frames, FRAMES);
    assert!(stayed.detail.contains("stayed on its side of the pier"), "{stayed:?}");

    rig.simulator.world().ignore_flips(false);
    rig.until("frames of the second row", 60.0, |rig| exposes(rig, 2)).await?;
    assert_eq!(side(&rig), Some(PierSide::West));
    rig.until("the mount turns over", 90.0, |rig| side(rig) == Some(PierSide::East)).await?;
    rig.until("the second row ends", 90.0, |rig| status(rig, 2) == Some(RowStatus::Finished)).await?;
    assert_eq!(rig.schedule.get().unwrap().said.body.rows[2].frames, FRAMES, "none is lost and none doubled");
    // The frames by row and sort, in their order.
    let mut heard = Vec::new();
    while let Ok(frame) = tokio::time::timeout(Duration::from_millis(200), frames.hear()).await {
        let purpose = frame.said.body.purpose;
        heard.push((purpose.row.unwrap(), purpose.action));
    }
    let of_second: Vec<&str> = heard.iter().filter(|(row, _)| *row == 2).map(|(_, action)| action.as_str()).collect();
    let first = of_second.iter().position(|action| *action == "object").unwrap();
    let again = of_second[first..].iter().position(|action| *action == "pointing");
    assert!(again.is_some(), "after the flip it is proven again where it looks: {of_second:?}");
    rig.until("the dome ends shut", 90.0, Rig::is_shut).await?;
    Ok(())
}
