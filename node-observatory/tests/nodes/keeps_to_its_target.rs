//! Mounts that do not do what they say: the end of a row, its frames and the dome do not depend on it.

use std::sync::atomic::Ordering;

use bus::Catch;
use contract::device::dome::Shutter;
use contract::device::telescope::BeyondLimit;
use contract::observatory::{Alerts, RowState, RowStatus};
use contract::{Datum, Key, Part};

use crate::MOST;
use crate::site::Site;

/// Near the zenith of the site at the start of the scenarios.
const TARGET: &str = r#""exptime": 5, "ra": 45.0, "dec": -24.6"#;

fn row(site: &Site, index: usize) -> Option<RowState> {
    site.schedule.get()?.sample.body.rows.get(index).cloned()
}

fn has_alert(site: &Site, id: &str) -> bool {
    let published = site.alerts.get().map(|received| received.sample.body.alerts);
    published.unwrap_or_default().iter().any(|alert| alert.id == id)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_is_finished_when_its_frames_are_taken_though_its_mount_goes_on_tracking() {
    let site = Site::new(100.0).await;
    site.tracks_on.store(true, Ordering::Relaxed);
    site.write_schedule(&[
        ("object", &format!(r#"{{"object": "x", {TARGET}, "n": 2}}"#), "03:00:00", "09:00:00"),
        ("object", &format!(r#"{{"object": "y", {TARGET}, "n": 2}}"#), "03:00:01", "09:00:00"),
    ]);
    let node = site.start().await;
    for index in [0, 1] {
        site.until("finished", MOST, |site| {
            row(site, index).is_some_and(|row| row.status == RowStatus::Finished && row.frames == 2)
        })
        .await;
        // It is published on another key than the row, so it may be read after it.
        site.until("alerted", MOST, |site| has_alert(site, "mount-tracks-on/mount")).await;
    }
    assert_eq!(site.exposures(), 4, "no row came back");
    site.until("parked", MOST, Site::is_parked).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_leaves_its_place_by_its_own_coordinates_spoils_one_frame_and_goes_back() {
    let site = Site::new(20.0).await;
    // It is active while one frame is taken only: all that is published is read.
    let key = Key::Observatory(site.address.clone(), Part::Alerts);
    let published = site.bus.subscribe::<Alerts>(&key.to_string(), Catch::Newest, 1000).await.unwrap();
    let target = r#""exptime": 60, "ra": 45.0, "dec": -24.6"#;
    site.write_schedule(&[("object", &format!(r#"{{"object": "x", {target}, "n": 4}}"#), "03:00:00", "09:00:00")]);
    let node = site.start().await;
    site.until("exposed twice", MOST, |site| site.exposures() >= 2).await;
    let mut commanded = None;
    site.mount.state.send_modify(|state| {
        commanded = state.fields.ra_deg.known().copied();
        state.fields.ra_deg = state.fields.ra_deg.clone().map(|ra| ra + 0.1);
    });
    site.until("finished", MOST, |site| row(site, 0).is_some_and(|row| row.status == RowStatus::Finished)).await;
    assert_eq!((row(&site, 0).map(|row| row.frames), site.exposures()), (Some(4), 5), "one frame does not count");
    let alerted = async {
        while !published.recv().await.sample.body.alerts.iter().any(|alert| alert.id == "mount-left-its-place/mount") {}
    };
    tokio::time::timeout(MOST, alerted).await.unwrap();
    let back = site.mount.state.borrow().fields.ra_deg.clone();
    assert!(back.known().zip(commanded).is_some_and(|(back, before)| (back - before).abs() < 0.01), "it went back");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mount_that_nothing_stops_at_its_limit_ends_the_exposure_and_closes_the_dome() {
    let site = Site::new(20.0).await;
    site.write_schedule(&[("object", &format!(r#"{{"object": "x", {TARGET}}}"#), "03:00:00", "09:00:00")]);
    let node = site.start().await;
    site.until("exposed", MOST, |site| site.exposures() >= 1).await;
    site.mount.state.send_modify(|state| {
        let why = "altitude 19.9 deg, the limit is 20 deg".to_owned();
        state.fields.beyond_limit = Some(BeyondLimit { why, not_stopped: true });
    });
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed)).await;
    site.until("parked", MOST, Site::is_parked).await;
    // It is opened again only when the mount is stopped.
    assert_eq!(site.shutter(), Some(Shutter::Closed));
    let exposed = site.exposures();
    site.mount.state.send_modify(|state| {
        state.fields.beyond_limit = None;
        state.fields.at_park = Datum::Known(true);
    });
    site.until("exposing again", MOST, |site| site.exposures() > exposed).await;
    node.stop().await;
}
