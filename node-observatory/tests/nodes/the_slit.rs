//! The dome's slit on a real bus, with a fake dome that turns as fast as it is ordered.

use std::time::{Duration, Instant};

use bus::Catch;
use contract::device::camera::Command as Camera;
use contract::device::dome::{Command as Dome, Shutter};
use contract::observatory::{FrameFacts, RowStatus};
use contract::{Datum, Topic};

use crate::MOST;
use crate::site::Site;

/// Some 45 deg high in the east, and in the west, at the start of the scenarios.
pub const EAST: &str = r#""ra": 95.0, "dec": -24.6"#;
pub const WEST: &str = r#""ra": 355.0, "dec": -24.6"#;

pub fn object(name: &str, target: &str, n: u32) -> String {
    format!(r#"{{"object": "{name}", "exptime": 10, {target}, "n": {n}}}"#)
}

fn status(site: &Site, row: usize) -> Option<RowStatus> {
    site.schedule.get().and_then(|received| received.sample.body.rows.get(row).map(|row| row.status))
}

fn detail(site: &Site, row: usize) -> String {
    site.schedule.get().map(|received| received.sample.body.rows[row].detail.clone()).unwrap_or_default()
}

fn dome_log(site: &Site) -> Vec<Dome> {
    site.dome.log.lock().unwrap().iter().map(|(_, command)| command.clone()).collect()
}

/// When and where to each turn was asked.
pub fn turns(site: &Site) -> Vec<(Instant, f64)> {
    let log = site.dome.log.lock().unwrap();
    let turn = |(at, command): &(Instant, Dome)| match command {
        Dome::SlewToAzimuth { azimuth_deg } => Some((*at, *azimuth_deg)),
        _ => None,
    };
    log.iter().filter_map(turn).collect()
}

fn exposures(site: &Site) -> Vec<Instant> {
    let log = site.camera.log.lock().unwrap();
    log.iter().filter(|(_, command)| matches!(command, Camera::Expose { .. })).map(|(at, _)| *at).collect()
}

fn alert_stands(site: &Site, id: &str) -> bool {
    site.alerts.get().is_some_and(|received| {
        received.sample.body.alerts.iter().any(|alert| alert.id == id && alert.returned_utc.is_none())
    })
}

/// The dome slips: it is far from where it was, and reports it.
fn slip(site: &Site) {
    site.dome.state.send_modify(|state| {
        let stands_deg = state.fields.azimuth_deg.known().copied().unwrap();
        state.fields.azimuth_deg = Datum::Known((stands_deg + 90.0) % 360.0);
    });
}

/// When each exposure was aborted.
fn aborts(site: &Site) -> Vec<Instant> {
    let log = site.camera.log.lock().unwrap();
    log.iter().filter(|(_, command)| *command == Camera::Abort).map(|(at, _)| *at).collect()
}

/// From a dome whose slit is in the north: some 100 deg to each target.
fn is_east(azimuth_deg: f64) -> bool {
    (75.0..120.0).contains(&azimuth_deg)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_slit_turns_before_the_shutter_opens_and_no_frame_begins_before_it_is_clear() {
    // 5 deg/s at 10 x: the way from east to west takes about 3.4 s of machine time, the slew of the mount 50 ms; and in
    // that time the targets go no way that a dome would have to follow, also on a busy machine.
    let site = Site::with_dome(10.0, Some(5.0)).await;
    let (east, west) = (object("east", EAST, 2), object("west", WEST, 2));
    site.write_schedule(&[("object", &east, "03:00:00", "08:00:00"), ("object", &west, "03:00:01", "08:00:00")]);
    let node = site.start().await;
    site.until("west observed", MOST, |site| status(site, 1) == Some(RowStatus::Finished)).await;

    let log = dome_log(&site);
    let opened = log.iter().position(|command| *command == Dome::OpenShutter).unwrap();
    assert!(matches!(log[0], Dome::SlewToAzimuth { azimuth_deg } if is_east(azimuth_deg)), "{log:?}");
    assert_eq!(opened, 1, "the shutter opens after the turn and nothing else: {log:?}");
    let (turns, frames) = (turns(&site), exposures(&site));
    assert_eq!(frames.len(), 4);
    let to_west = turns.iter().find(|(_, azimuth_deg)| (240.0..285.0).contains(azimuth_deg)).unwrap();
    let slewed = site.mount.log.lock().unwrap().iter().filter(|(_, c)| format!("{c:?}").contains("Slew")).count();
    assert_eq!((slewed, turns.len()), (2, 2), "one turn for each slew, to its end: {turns:?}");
    // 140 deg and more at 5 deg/s and 10 x.
    let waited = frames[2].duration_since(to_west.0);
    assert!(waited >= Duration::from_millis(2800), "the first frame in the west began {waited:?} after the turn");
    assert!(!alert_stands(&site, "dome-not-turned/dome"));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_that_does_not_turn_stays_shut_with_a_clear_word_and_opens_when_it_turns_again() {
    let mut site = Site::with_dome(50.0, Some(0.0)).await;
    site.more = "[faults]\nretries = 0\nrest_s = 1\n";
    site.write_schedule(&[("object", &object("east", EAST, 2), "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until("postponed", MOST, |site| status(site, 0) == Some(RowStatus::Interrupted)).await;
    let message = detail(&site, 0);
    assert!(message.contains("paranal/callisto/dome/dome: not done with slew_to_azimuth"), "{message}");
    assert!(!dome_log(&site).contains(&Dome::OpenShutter) && site.exposures() == 0);
    site.until("alerted", MOST, |site| alert_stands(site, "dome-not-turned/dome")).await;
    *site.turn_deg_per_s.lock().unwrap() = Some(5.0);
    site.until("observed", MOST, |site| status(site, 0) == Some(RowStatus::Finished)).await;
    site.until("calm", MOST, |site| !alert_stands(site, "dome-not-turned/dome")).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_that_hangs_while_it_follows_closes_all_the_same_and_is_not_turned_any_more() {
    let site = Site::with_dome(20.0, Some(5.0)).await;
    site.shutter_of_camera.hold_after(0);
    let (east, west) = (object("east", EAST, 1), object("west", WEST, 5));
    site.write_schedule(&[("object", &east, "03:00:00", "08:00:00"), ("object", &west, "03:00:01", "08:00:00")]);
    let node = site.start().await;
    site.until("exposing in the east", MOST, Site::is_exposing).await;
    *site.turn_deg_per_s.lock().unwrap() = Some(0.0);
    site.shutter_of_camera.let_go();
    site.until("a turn to the west that hangs", MOST, |site| turns(site).len() >= 2).await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(exposures(&site).len(), 1, "nothing is exposed through a slit that stands elsewhere");

    site.set_safe(false);
    site.until("closed and parked", MOST, |site| site.shutter() == Some(Shutter::Closed) && site.is_parked()).await;
    assert!(site.turned.lock().unwrap().len() <= 1, "it closed while it hung");
    let closed = site.dome.log.lock().unwrap().len();
    tokio::time::sleep(Duration::from_secs(3)).await;
    let later = dome_log(&site)[closed..].to_vec();
    assert!(!later.iter().any(|command| matches!(command, Dome::SlewToAzimuth { .. })), "{later:?}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_exposure_behind_a_dome_that_is_too_slow_is_ended_and_taken_again_when_the_slit_is_there() {
    // 3600 s are 36 s here: a tenth of the light is lost after 4 s, three quarters of it are in after 27 s.
    let mut site = Site::with_dome(100.0, Some(50.0)).await;
    site.more = "[faults]\npause_s = 0.2\n";
    let long = format!(r#"{{"object": "east", "exptime": 3600, {EAST}, "n": 1}}"#);
    site.write_schedule(&[("object", &long, "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until("exposing", MOST, Site::is_exposing).await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    *site.turn_deg_per_s.lock().unwrap() = Some(0.0);
    let slipped = Instant::now();
    slip(&site);
    site.until("ended", MOST, |site| !aborts(site).is_empty()).await;
    // A late report is no fault.
    let took = aborts(&site)[0].duration_since(slipped);
    assert!(took >= Duration::from_millis(1900), "{took:?}");
    site.until("alerted", MOST, |site| alert_stands(site, "dome-not-turned/dome")).await;
    assert_eq!(exposures(&site).len(), 1, "nothing is exposed through a slit that stands elsewhere");
    *site.turn_deg_per_s.lock().unwrap() = Some(50.0);
    // What is taken again need not take its time.
    site.shutter_of_camera.hurries.store(true, std::sync::atomic::Ordering::SeqCst);
    site.until("taken again", MOST, |site| status(site, 0) == Some(RowStatus::Finished)).await;
    let (turned, frames) = (*site.turned.lock().unwrap().last().unwrap(), exposures(&site));
    assert_eq!((frames.len(), site.exposures(), aborts(&site).len()), (2, 1, 1));
    assert!(frames[1] >= turned && turned > slipped, "it begins when the slit is there");
    assert_eq!(site.schedule.get().unwrap().sample.body.rows[0].frames, 1);
    site.until("calm", MOST, |site| !alert_stands(site, "dome-not-turned/dome")).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_exposure_that_is_nearly_done_is_let_end_and_what_it_lost_is_published_with_it() {
    // It begins when 94 % are done, by the word of its camera: 36 s are left, which are 18 s here: a dome that is noticed late on a busy machine still hides one percent.
    let site = Site::with_dome(2.0, Some(50.0)).await;
    site.shutter_of_camera.is_done_percent.store(94, std::sync::atomic::Ordering::SeqCst);
    let long = format!(r#"{{"object": "east", "exptime": 600, {EAST}, "n": 1}}"#);
    site.write_schedule(&[("object", &long, "03:00:00", "08:00:00")]);
    let facts = site.bus.subscribe::<FrameFacts>(Topic::Facts.everywhere(), Catch::All, 10).await.unwrap();
    let node = site.start().await;
    site.until("exposing", MOST, Site::is_exposing).await;
    let exposure = site.camera.state.borrow().fields.exposure.clone().unwrap();
    *site.turn_deg_per_s.lock().unwrap() = Some(0.0);
    slip(&site);
    let published = tokio::time::timeout(MOST, facts.recv()).await.unwrap().sample.body;
    assert_eq!(published.frame, exposure.id);
    assert!(published.dome_hid_percent.is_some_and(|lost| (1.0..7.0).contains(&lost)), "{published:?}");
    site.until("finished", MOST, |site| status(site, 0) == Some(RowStatus::Finished)).await;
    assert_eq!((exposures(&site).len(), site.exposures(), aborts(&site)), (1, 1, vec![]));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_that_can_slave_is_slaved_before_it_opens() {
    let mut site = Site::with_dome(50.0, Some(5.0)).await;
    site.dome_block = "follow = \"slave\"";
    site.write_schedule(&[("object", &object("east", EAST, 1), "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until("observed", MOST, |site| status(site, 0) == Some(RowStatus::Finished)).await;
    let log = dome_log(&site);
    assert_eq!(log[..2], [Dome::Slave { on: true }, Dome::OpenShutter], "{log:?}");
    assert_eq!(turns(&site), []);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_whose_site_turns_it_is_let_alone() {
    for (block, slaved) in [("follow = \"off\"", false), ("", true)] {
        let mut site = Site::with_dome(50.0, Some(5.0)).await;
        site.dome_block = block;
        site.dome.state.send_modify(|state| state.fields.slaved = Datum::Known(slaved));
        site.write_schedule(&[("object", &object("east", EAST, 1), "03:00:00", "08:00:00")]);
        let node = site.start().await;
        site.until("observed", MOST, |site| status(site, 0) == Some(RowStatus::Finished)).await;
        let log = dome_log(&site);
        assert!(turns(&site).is_empty() && !log.iter().any(|c| matches!(c, Dome::Slave { .. })), "{block}: {log:?}");
        node.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_turns_nothing() {
    let site = Site::with_dome(20.0, Some(5.0)).await;
    site.lease_held.store(true, std::sync::atomic::Ordering::Relaxed);
    site.dome.state.send_modify(|state| state.fields.shutter = Datum::Known(Shutter::Open));
    site.mount.state.send_modify(|state| {
        (state.fields.ra_deg, state.fields.dec_deg) = (Datum::Known(95.0), Datum::Known(-24.6));
        (state.fields.tracking, state.fields.at_park) = (Datum::Known(true), Datum::Known(false));
    });
    site.write_schedule(&[("object", &object("east", EAST, 1), "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until_up("main").await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(dome_log(&site), []);
    node.stop().await;
}
