//! The imperfections that guiding and focusing meet in a real machine: play in the gears, pulses on both sides of the
//! pier, a guide scope.

use simulator::{GuideCameraOptions, Options};

use crate::client::{Site, options};
use crate::images::{alone, expected, expose_with, observing};

/// The guide rate that the mount reports when no client has set one, arcsec per second.
const GUIDE_ARCSEC_PER_S: f64 = 0.5 * 15.041_067;

/// A mount that looks at a star of this hour angle, tracking.
async fn tracking(options: Options, hour_angle_h: f64) -> Site {
    let site = Site::connected(options, &["telescope"]).await;
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "tracking", "Tracking=true").await;
    let sidereal_h = site.get("telescope", "siderealtime").await.as_f64().unwrap();
    let ra_h = (sidereal_h - hour_angle_h).rem_euclid(24.0);
    site.put("telescope", "slewtocoordinates", &format!("RightAscension={ra_h}&Declination=-10")).await;
    site
}

/// Pulses (0 north, 1 south, 2 east, 3 west); answers how far the telescope went east and north, arcsec.
async fn pulse(site: &Site, direction: u8, duration_ms: u32) -> (f64, f64) {
    let before = site.simulator.world().looks_at();
    site.put("telescope", "pulseguide", &format!("Direction={direction}&Duration={duration_ms}")).await;
    site.until("telescope", "ispulseguiding", false).await;
    let after = site.simulator.world().looks_at();
    ((after.ra - before.ra).wrapped_signed().arcseconds() * before.dec.cos(), (after.dec - before.dec).arcseconds())
}

fn near(value: f64, expected: f64) -> bool {
    (value - expected).abs() < 0.05
}

#[tokio::test]
async fn a_reversal_in_declination_is_lost_in_the_gear_and_the_encoder_does_not_see_it() {
    for hour_angle_h in [-1.0, 1.0] {
        let mut sloppy = options(20.0);
        sloppy.mount.dec_backlash_arcsec = 2.0 * GUIDE_ARCSEC_PER_S;
        let site = tracking(sloppy, hour_angle_h).await;
        // From any state that the slew left: drive north for longer than the play.
        pulse(&site, 0, 3000).await;
        let reported = site.get("telescope", "declination").await.as_f64().unwrap();
        let (_, north) = pulse(&site, 0, 1000).await;
        assert!(near(north, GUIDE_ARCSEC_PER_S), "going on loses nothing: {north}");
        let (_, north) = pulse(&site, 1, 1500).await;
        assert!(near(north, 0.0), "inside the play: {north}");
        let (_, north) = pulse(&site, 1, 1500).await;
        assert!(near(north, -GUIDE_ARCSEC_PER_S), "half a second of play was left: {north}");
        let moved = site.get("telescope", "declination").await.as_f64().unwrap() - reported;
        assert!(near(moved * 3600.0, -2.0 * GUIDE_ARCSEC_PER_S), "the encoder counts the motor: {moved}");
        let (_, north) = pulse(&site, 0, 3000).await;
        assert!(near(north, GUIDE_ARCSEC_PER_S), "and back: {north}");
        let (east, _) = pulse(&site, 2, 1000).await;
        let (west, _) = pulse(&site, 3, 1000).await;
        let expected = GUIDE_ARCSEC_PER_S * (-10.0_f64).to_radians().cos();
        assert!(near(east, expected) && near(west, -expected), "none in right ascension: {east} {west}");
    }
}

#[tokio::test]
async fn where_a_slew_ends_depends_on_the_way_it_came() {
    let mut sloppy = options(50.0);
    sloppy.mount.dec_backlash_arcsec = 20.0;
    let site = tracking(sloppy, 1.0).await;
    let ra_h = site.get("telescope", "rightascension").await.as_f64().unwrap();
    let mut looks_at_deg = Vec::new();
    for from_deg in [-30.0, 10.0] {
        for dec_deg in [from_deg, -10.0] {
            site.put("telescope", "slewtocoordinates", &format!("RightAscension={ra_h}&Declination={dec_deg}")).await;
        }
        looks_at_deg.push(site.simulator.world().looks_at().dec.degrees());
    }
    let from_south_arcsec = (looks_at_deg[0] + 10.0) * 3600.0;
    let from_north_arcsec = (looks_at_deg[1] + 10.0) * 3600.0;
    assert!(near(from_south_arcsec, -10.0) && near(from_north_arcsec, 10.0), "{from_south_arcsec} {from_north_arcsec}");
}

#[tokio::test]
async fn north_is_north_on_both_sides_of_the_pier_unless_the_mount_reverses_it() {
    let site = tracking(options(20.0), -1.0).await;
    assert_eq!(site.get("telescope", "sideofpier").await, 1);
    let (_, north) = pulse(&site, 0, 1000).await;
    assert!(near(north, GUIDE_ARCSEC_PER_S), "{north}");
    site.put("telescope", "guideratedeclination", "GuideRateDeclination=0.001").await;
    let (_, north) = pulse(&site, 0, 1000).await;
    assert!(near(north, 3.6), "the guide rate that is reported is the one that acts: {north}");
    assert_eq!(site.order("world/mount", r#"{"dec_pulses_reverse_west": true}"#).await, 200);
    let (_, north) = pulse(&site, 0, 1000).await;
    assert!(near(north, -3.6), "{north}");
    let (east, _) = pulse(&site, 2, 1000).await;
    assert!(east > 7.0, "right ascension is not reversed: {east}");
    let other = tracking(
        Options {
            mount: simulator::MountOptions { dec_pulses_reverse_west: true, ..options(20.0).mount },
            ..options(20.0)
        },
        1.0,
    )
    .await;
    let (_, north) = pulse(&other, 0, 1000).await;
    assert!(near(north, GUIDE_ARCSEC_PER_S), "with the tube east of the pier the motor turns north: {north}");
    site.simulator.world().clear_faults();
    let (_, north) = pulse(&site, 0, 1000).await;
    assert!(near(north, 3.6), "{north}");
}

#[tokio::test]
async fn a_slewing_mount_refuses_pulses() {
    let site = tracking(options(1.0), 1.0).await;
    site.put("telescope", "slewtocoordinatesasync", "RightAscension=3&Declination=-60").await;
    assert_eq!(site.try_put("telescope", "pulseguide", "Direction=0&Duration=1000").await, (200, 0x40B));
}

#[tokio::test]
async fn a_focuser_with_play_stands_elsewhere_than_it_reports_when_it_came_from_above() {
    let mut sloppy = options(100.0);
    sloppy.focus.backlash_steps = 80.0;
    let site = Site::connected(sloppy, &["focuser"]).await;
    let defocus = async || site.control("world").await["camera"]["defocus_steps"].as_f64().unwrap();
    let go = async |position: i32| {
        site.put("focuser", "move", &format!("Position={position}")).await;
        site.until("focuser", "ismoving", false).await;
        assert_eq!(site.get("focuser", "position").await, position);
    };
    go(25_100).await;
    let outward = defocus().await;
    go(25_050).await;
    // The air cools, and the focus with it, while this goes on: some tenths of a step.
    assert!((defocus().await - outward).abs() < 1.0, "inside the play");
    go(24_900).await;
    go(25_100).await;
    assert!((defocus().await - outward).abs() < 1.0, "from below again");
    go(25_300).await;
    go(25_100).await;
    assert!((defocus().await - outward - 80.0).abs() < 1.0, "{} {outward}", defocus().await);
    assert_eq!(site.order("world/focuser", r#"{"backlash_steps": 0}"#).await, 200);
    assert!((defocus().await - outward).abs() < 1.0);
    assert_eq!(site.order("world/focuser", r#"{"backlash_steps": -4}"#).await, 400);
    assert_eq!(site.order("world/mount", r#"{"dec_backlash_arcsec": "much"}"#).await, 400);
}

#[tokio::test]
async fn a_guide_camera_sees_its_own_field_at_its_own_angle_while_the_main_one_exposes() {
    let mut both = options(30.0);
    let mut guide = GuideCameraOptions::default();
    guide.camera.mirrored = true;
    both.guide_camera = Some(guide);
    let site = observing(both, 5.5, -2.0).await;
    assert_eq!(site.try_put("camera/1", "startexposure", "Duration=2&Light=true").await, (200, 0x407));
    site.put("camera/1", "connected", "Connected=true").await;
    site.put("camera", "startexposure", "Duration=200&Light=true").await;
    let image = expose_with(&site, "camera/1", 5.0, true).await;
    assert_eq!(site.get("camera", "camerastate").await, 2, "the main camera goes on");
    assert_eq!((image.width, image.height), (1280, 960));

    let truth = site.control("world").await;
    let center = sky::Icrs::from_degrees(
        truth["guide_camera"]["ra_deg"].as_f64().unwrap(),
        truth["guide_camera"]["dec_deg"].as_f64().unwrap(),
    );
    let apart = sky::separation(&center, &site.simulator.world().looks_at()).degrees() * 60.0;
    assert!((apart - 12.0_f64.hypot(7.0)).abs() < 0.01, "{apart}");
    let angle_deg = if site.get("telescope", "sideofpier").await == 1 { 197.0 } else { 17.0 };
    let stars = alone(&expected(center, &guide.camera, angle_deg));
    let seen: Vec<_> = stars.iter().filter(|star| star.2 > 6.5 && star.2 < 9.5).take(6).collect();
    assert_eq!(seen.len(), 6, "{stars:?}");
    for (x, y, mag) in seen {
        let (cx, cy, peak) = image.centroid(x.round(), y.round());
        assert!(peak > 100.0, "no star of {mag} at {x} {y}: {peak}");
        assert!((cx - x).hypot(cy - y) < 0.4, "{mag} mag expected at {x:.2} {y:.2}, seen at {cx:.2} {cy:.2}");
    }
}

#[tokio::test]
async fn a_guide_camera_is_listed_and_can_fail_by_itself_and_without_one_there_is_no_camera_1() {
    let with = Site::start(Options { guide_camera: Some(GuideCameraOptions::default()), ..options(1.0) }).await;
    let url = |site: &Site| format!("http://{}/management/v1/configureddevices", site.simulator.address());
    let text = with.http.get(url(&with)).send().await.unwrap().text().await.unwrap();
    let devices: serde_json::Value = serde_json::from_str(&text).unwrap();
    let cameras = devices["Value"].as_array().unwrap().iter().filter(|device| device["DeviceType"] == "Camera");
    let numbers: Vec<_> = cameras.map(|device| device["DeviceNumber"].as_u64().unwrap()).collect();
    assert_eq!(numbers, [0, 1]);
    assert_eq!(with.order("faults/guidecamera", r#"{"error": 1280}"#).await, 200);
    assert_eq!(with.answer("camera/1", "name").await["ErrorNumber"], 1280);
    assert_eq!(with.get("camera", "name").await, "Simulated Camera");

    let without = Site::start(options(1.0)).await;
    assert_eq!(without.http.get(without.url("camera/1", "name")).send().await.unwrap().status(), 400);
}
