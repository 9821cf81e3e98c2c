//! Moving parts take the time of their speed.

use sky::{Icrs, separation};

use crate::client::{Site, options};

/// High in the south over Paranal at the tests' hour.
const RA_H: f64 = 3.0;
const DEC_DEG: f64 = -30.0;

#[tokio::test]
async fn a_slew_takes_time_and_arrives() {
    let site = Site::connected(options(20.0), &["telescope"]).await;
    assert_eq!(
        site.try_put("telescope", "slewtocoordinatesasync", "RightAscension=3&Declination=-30").await,
        (200, 0x408)
    );
    site.put("telescope", "unpark", "").await;
    assert_eq!(
        site.try_put("telescope", "slewtocoordinatesasync", "RightAscension=3&Declination=-30").await,
        (200, 0x40B)
    );
    site.put("telescope", "tracking", "Tracking=true").await;
    assert_eq!(
        site.try_put("telescope", "slewtocoordinatesasync", "RightAscension=25&Declination=-30").await,
        (200, 0x401)
    );
    assert_eq!(site.answer("telescope", "targetdeclination").await["ErrorNumber"], 0x402);
    let started = site.world().now();
    site.put("telescope", "slewtocoordinatesasync", &format!("RightAscension={RA_H}&Declination={DEC_DEG}")).await;
    assert_eq!(site.get("telescope", "slewing").await, true);
    site.until("telescope", "slewing", false).await;
    let sky_s = site.world().now().seconds_since(started);
    // Some 90 deg at 6 deg/s and 2 s to settle.
    assert!((8.0..60.0).contains(&sky_s), "{sky_s}");
    let ra = site.get("telescope", "rightascension").await.as_f64().unwrap();
    let dec = site.get("telescope", "declination").await.as_f64().unwrap();
    assert!((ra - RA_H).abs() < 1e-6 && (dec - DEC_DEG).abs() < 1e-6, "{ra} {dec}");
    let truth = site.simulator.world().looks_at();
    assert!(separation(&truth, &Icrs::from_degrees(RA_H * 15.0, DEC_DEG)).arcseconds() < 0.1);
    let altitude = site.get("telescope", "altitude").await.as_f64().unwrap();
    assert!((60.0..90.0).contains(&altitude), "{altitude}");
    site.put("telescope", "park", "").await;
    assert_eq!(site.get("telescope", "atpark").await, false);
    site.until("telescope", "atpark", true).await;
    assert_eq!(site.get("telescope", "tracking").await, false);
}

#[tokio::test]
async fn an_imperfect_mount_misses_and_a_sync_mends_it() {
    let mut imperfect = options(50.0);
    imperfect.mount = simulator::MountOptions { pointing_error_arcmin: 3.0, ..imperfect.mount };
    let site = Site::connected(imperfect, &["telescope"]).await;
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "tracking", "Tracking=true").await;
    site.put("telescope", "slewtocoordinates", &format!("RightAscension={RA_H}&Declination={DEC_DEG}")).await;
    assert_eq!(site.get("telescope", "slewing").await, false, "the old method answers when it is done");
    let target = Icrs::from_degrees(RA_H * 15.0, DEC_DEG);
    let truth = site.simulator.world().looks_at();
    let missed = separation(&truth, &target).arcseconds();
    assert!((10.0..600.0).contains(&missed), "{missed}");
    let form = format!("RightAscension={}&Declination={}", truth.ra.hours(), truth.dec.degrees());
    site.put("telescope", "synctocoordinates", &form).await;
    site.put("telescope", "slewtocoordinates", &format!("RightAscension={RA_H}&Declination={DEC_DEG}")).await;
    let left = separation(&site.simulator.world().looks_at(), &target).arcseconds();
    assert!(left < 0.2 * missed, "{left} of {missed}");
}

#[tokio::test]
async fn a_mount_that_ignores_flips_looks_west_from_the_side_for_the_east() {
    let site = Site::connected(options(50.0), &["telescope"]).await;
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "tracking", "Tracking=true").await;
    let sidereal_h = site.get("telescope", "siderealtime").await.as_f64().unwrap();
    let side_at = async |hour_angle_h: f64| {
        let ra_h = (sidereal_h - hour_angle_h).rem_euclid(24.0);
        site.put("telescope", "slewtocoordinates", &format!("RightAscension={ra_h}&Declination=-10")).await;
        site.get("telescope", "sideofpier").await.as_i64().unwrap()
    };
    let east = side_at(-1.0).await;
    site.order("world/flip", r#"{"ignored": true}"#).await;
    assert_eq!(side_at(1.0).await, east);
    site.simulator.world().clear_faults();
    assert_ne!(side_at(1.0).await, east);
}

#[tokio::test]
async fn a_guide_pulse_moves_by_rate_times_time() {
    let site = Site::connected(options(10.0), &["telescope"]).await;
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "tracking", "Tracking=true").await;
    site.put("telescope", "slewtocoordinates", &format!("RightAscension={RA_H}&Declination={DEC_DEG}")).await;
    let before = site.simulator.world().looks_at();
    site.put("telescope", "pulseguide", "Direction=0&Duration=4000").await;
    assert_eq!(site.get("telescope", "ispulseguiding").await, true);
    site.until("telescope", "ispulseguiding", false).await;
    let after = site.simulator.world().looks_at();
    let north = (after.dec - before.dec).arcseconds();
    assert!((north - 4.0 * 7.5205).abs() < 0.05, "{north}");
    assert!((after.ra - before.ra).arcseconds().abs() < 0.01);
}

#[tokio::test]
async fn the_shutter_travels() {
    let site = Site::connected(options(30.0), &["dome"]).await;
    assert_eq!(site.get("dome", "shutterstatus").await, 1);
    let started = site.world().now();
    site.put("dome", "openshutter", "").await;
    assert_eq!(site.get("dome", "shutterstatus").await, 2);
    site.until("dome", "shutterstatus", 0).await;
    let sky_s = site.world().now().seconds_since(started);
    assert!((29.9..35.0).contains(&sky_s), "{sky_s}");
    assert_eq!(site.simulator.world().dome_open(), 1.0);
    site.put("dome", "closeshutter", "").await;
    assert_eq!(site.get("dome", "shutterstatus").await, 3);
    site.until("dome", "shutterstatus", 1).await;
    site.put("dome", "slewtoazimuth", "Azimuth=150").await;
    assert_eq!(site.get("dome", "slewing").await, true);
    site.put("dome", "abortslew", "").await;
    site.until("dome", "slewing", false).await;
    assert!(site.get("dome", "azimuth").await.as_f64().unwrap() < 149.0);
    assert_eq!(site.get("dome", "atpark").await, false);
    site.put("dome", "park", "").await;
    site.until("dome", "atpark", true).await;
}

#[tokio::test]
async fn a_slaved_dome_follows_the_telescope() {
    let site = Site::connected(options(60.0), &["dome", "telescope"]).await;
    site.put("dome", "slaved", "Slaved=true").await;
    assert_eq!(site.try_put("dome", "slewtoazimuth", "Azimuth=10").await, (200, 0x409));
    site.put("telescope", "unpark", "").await;
    site.put("telescope", "slewtoaltazasync", "Azimuth=120&Altitude=40").await;
    site.until("telescope", "slewing", false).await;
    site.until("dome", "slewing", false).await;
    let azimuth = site.get("dome", "azimuth").await.as_f64().unwrap();
    assert!((azimuth - 120.0).abs() < 1.0, "{azimuth}");
}

#[tokio::test]
async fn the_rest_of_the_light_path_moves_too() {
    let site =
        Site::connected(options(100.0), &["focuser", "filterwheel", "rotator", "covercalibrator", "switch", "camera"])
            .await;
    site.put("focuser", "move", "Position=20000").await;
    site.put("filterwheel", "position", "Position=3").await;
    assert_eq!(site.get("filterwheel", "position").await, -1);
    site.put("rotator", "moveabsolute", "Position=270").await;
    site.put("covercalibrator", "closecover", "").await;
    site.put("covercalibrator", "calibratoron", "Brightness=100").await;
    site.put("switch", "setswitchvalue", "Id=2&Value=40").await;
    site.put("camera", "setccdtemperature", "SetCCDTemperature=-10").await;
    site.put("camera", "cooleron", "CoolerOn=true").await;
    assert!(site.get("camera", "ccdtemperature").await.as_f64().unwrap() > 0.0);
    site.until("focuser", "position", 20_000).await;
    site.until("filterwheel", "position", 3).await;
    site.until("rotator", "ismoving", false).await;
    assert_eq!(site.get("rotator", "position").await, 270.0);
    site.until("covercalibrator", "coverstate", 1).await;
    site.until("covercalibrator", "calibratorstate", 3).await;
    assert_eq!(site.get("switch", "getswitchvalue?Id=2").await, 40.0);
    assert_eq!(site.try_put("switch", "setswitch", "Id=3&State=false").await, (200, 0x400));
    assert_eq!(site.try_put("filterwheel", "position", "Position=9").await, (200, 0x401));
    for _ in 0..500 {
        if site.get("camera", "ccdtemperature").await.as_f64().unwrap() < -9.9 {
            assert!(site.get("camera", "coolerpower").await.as_f64().unwrap() > 20.0);
            return;
        }
        site.pass(1.0).await;
    }
    panic!("the camera does not cool");
}
