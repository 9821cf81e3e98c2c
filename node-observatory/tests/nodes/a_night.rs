//! The observatory node on a real bus, with fake devices: opens, observes, closes, goes on.

use std::sync::atomic::Ordering;
use std::time::Duration;

use contract::OrderKind;
use contract::device::camera::Command as Camera;
use contract::device::dome::{Command as Dome, Shutter};
use contract::device::telescope::Command as Mount;
use contract::observatory::{Posture, RowStatus};

use crate::MOST;
use crate::site::Site;

/// Near the zenith of the site at the start of the scenarios.
const TARGET: &str = r#""ra": 45.0, "dec": -24.6"#;

fn statuses(site: &Site) -> Vec<RowStatus> {
    let schedule = site.schedule.get().map(|received| received.sample.body);
    schedule.map(|schedule| schedule.rows.iter().map(|row| row.status).collect()).unwrap_or_default()
}

fn night_is(site: &Site, holds: impl Fn(&contract::observatory::NightState) -> bool) -> bool {
    site.night.get().is_some_and(|received| holds(&received.sample.body))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_opens_observes_and_ends_closed_and_parked() {
    let site = Site::new(50.0).await;
    let object =
        format!(r#"{{"object": "x", "exptime": 10, {TARGET}, "n": 3, "guiding": true, "metadata": {{"visit": 3}}}}"#);
    site.write_schedule(&[
        ("open", "{}", "03:00:00", "08:00:00"),
        ("object", &object, "03:00:00", "08:00:00"),
        ("calibration", r#"{"exptime": [0, 5], "n": [2, 1]}"#, "03:00:01", "08:00:00"),
    ]);
    let node = site.start().await;
    site.until("ended", MOST, |site| night_is(site, |night| night.ended)).await;

    assert_eq!(statuses(&site), [RowStatus::Finished; 3]);
    assert_eq!((site.shutter(), site.is_parked()), (Some(Shutter::Closed), true));
    let purposes: Vec<_> = site.purposes.lock().unwrap().iter().map(|(_, purpose)| purpose.clone()).collect();
    // Which row comes first is decided by when the sky is known.
    let of = |action: &str| {
        let of_row = purposes.iter().filter(|purpose| purpose.action == action);
        of_row.map(|purpose| (purpose.image_type.as_str(), purpose.sequence)).collect::<Vec<_>>()
    };
    assert_eq!(of("object"), [0, 1, 2].map(|sequence| ("Light Frame", sequence)));
    assert_eq!(of("calibration"), [("Bias Frame", 0), ("Bias Frame", 1), ("Dark Frame", 2)]);
    let first = purposes.iter().find(|purpose| purpose.action == "object").unwrap();
    assert_eq!((first.action.as_str(), first.object.as_deref(), first.row), ("object", Some("x"), Some(1)));
    assert_eq!((first.night.as_str(), first.ra_deg, first.dec_deg), ("20261120", Some(45.0), Some(-24.6)));
    assert_eq!(first.metadata["visit"], "3");
    assert_eq!(first.paired["Telescope"], "mount");
    let is_reported = |night: &contract::observatory::NightState| {
        night.frames == 6 && night.posture == Posture::Closed && night.actions.is_empty()
    };
    site.until("reported", MOST, |site| night_is(site, is_reported)).await;
    assert!(night_is(&site, |night| night.open_s > 0.0));
    let object = site.schedule.get().unwrap().sample.body.rows[1].clone();
    assert!(object.detail.contains("no frame could be guided on"), "its pixels are nowhere: {}", object.detail);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unsafe_sky_closes_at_once_and_a_safe_one_goes_on_counting() {
    let site = Site::new(20.0).await;
    let object = format!(r#"{{"object": "x", "exptime": 10, {TARGET}, "n": 4}}"#);
    site.write_schedule(&[("object", &object, "03:00:00", "08:00:00")]);
    // The second goes on until the sky is safe again.
    site.shutter_of_camera.hold_after(1);
    let node = site.start().await;
    site.until("in the second frame", MOST, |site| site.exposures() == 1 && site.is_exposing()).await;
    assert_eq!(site.shutter(), Some(Shutter::Open));
    site.dome.log.lock().unwrap().clear();

    site.set_safe(false);
    site.until("closed and parked", MOST, |site| site.shutter() == Some(Shutter::Closed) && site.is_parked()).await;
    let first = site.dome.log.lock().unwrap().first().map(|(_, command)| command.clone());
    assert_eq!(first, Some(Dome::CloseShutter));
    let aborts = |site: &Site| site.camera.log.lock().unwrap().iter().any(|(_, command)| *command == Camera::Abort);
    site.until("the exposure thrown away", MOST, |site| aborts(site) && !site.is_exposing()).await;
    site.until("interrupted", MOST, |site| statuses(site) == [RowStatus::Interrupted]).await;

    site.shutter_of_camera.let_go();
    site.set_safe(true);
    site.until("finished", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    assert_eq!(site.exposures(), 4, "no frame lost, none twice");
    site.until("ended", MOST, |site| night_is(site, |night| night.ended)).await;
    assert_eq!(site.shutter(), Some(Shutter::Closed));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_resumes_in_the_middle_of_an_exposure() {
    let site = Site::new(20.0).await;
    let object = format!(r#"{{"object": "x", "exptime": 10, {TARGET}, "n": 3}}"#);
    site.write_schedule(&[("object", &object, "03:00:00", "08:00:00")]);
    // The second goes on until the next incarnation is there.
    site.shutter_of_camera.hold_after(1);
    let node = site.start().await;
    site.until("in the second frame", MOST, |site| site.exposures() == 1 && site.is_exposing()).await;
    node.stop().await;
    let node = site.start().await;
    site.shutter_of_camera.let_go();
    site.until("ended", MOST, |site| night_is(site, |night| night.ended)).await;
    assert_eq!(site.exposures(), 3, "no frame lost, none twice");
    let mut sequence: Vec<_> = site.purposes.lock().unwrap().iter().map(|(_, purpose)| purpose.sequence).collect();
    sequence.dedup();
    assert_eq!(sequence.len(), 3, "no sequence number twice: {sequence:?}");
    let closed = site.dome.log.lock().unwrap().iter().filter(|(_, command)| *command == Dome::CloseShutter).count();
    assert_eq!(closed, 1, "a restart in a safe night does not shut the roof");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_does_not_end_is_told_before_anything_fails_and_the_next_step_ends_that() {
    let mut site = Site::new(20.0).await;
    site.more = "[faults]\noverdue_s = 0.1\n";
    let object = format!(r#"{{"object": "x", "exptime": 10, {TARGET}, "n": 2}}"#);
    site.write_schedule(&[("object", &object, "03:00:00", "08:00:00")]);
    site.shutter_of_camera.hold_after(0);
    let node = site.start().await;
    let overdue = |site: &Site| -> Option<String> {
        let alerts = site.alerts.get()?.sample.body.alerts;
        let is_it =
            |alert: &contract::observatory::Alert| alert.id.contains("step-overdue") && alert.returned_utc.is_none();
        alerts.into_iter().find(is_it).map(|alert| alert.cause)
    };
    let is_due = |night: &contract::observatory::NightState| {
        night.actions.iter().any(|action| action.step.starts_with("exposing") && action.expected_by_utc.is_some())
    };
    site.until("exposing, with its time", MOST, |site| night_is(site, is_due)).await;
    site.until("overdue", MOST, |site| overdue(site).is_some()).await;
    let cause = overdue(&site).unwrap();
    assert!(
        cause.starts_with("row 1 (object): \"exposing 1 of 2") && cause.contains("should have ended by 03:"),
        "{cause}"
    );
    site.shutter_of_camera.let_go();
    site.until("the next step", MOST, |site| overdue(site).is_none()).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn turning_the_robotic_switch_off_closes_and_on_goes_on() {
    let site = Site::new(20.0).await;
    let object = format!(r#"{{"object": "x", "exptime": 10, {TARGET}}}"#);
    site.write_schedule(&[("object", &object, "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until("exposing", MOST, |site| site.exposures() >= 1).await;
    site.order(OrderKind::Robotic(false)).await;
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed) && site.is_parked()).await;
    site.until("idle", MOST, |site| night_is(site, |night| !night.robotic && night.actions.is_empty())).await;
    let before = site.exposures();
    site.order(OrderKind::Robotic(true)).await;
    site.until("exposing again", MOST, |site| site.exposures() > before).await;
    site.order(OrderKind::Close).await;
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed) && site.is_parked()).await;
    assert!(night_is(&site, |night| !night.robotic));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_target_below_the_horizon_fails_clearly_and_the_night_goes_on() {
    let site = Site::new(50.0).await;
    site.write_schedule(&[
        ("object", r#"{"object": "north", "exptime": 1, "ra": 0, "dec": 85, "n": 1}"#, "03:00:00", "08:00:00"),
        ("calibration", r#"{"exptime": [0], "n": [1]}"#, "03:00:01", "08:00:00"),
    ]);
    let node = site.start().await;
    site.until("through", MOST, |site| statuses(site) == [RowStatus::Failed, RowStatus::Finished]).await;
    let detail = site.schedule.get().unwrap().sample.body.rows[0].detail.clone();
    assert!(detail.contains("below the horizon"), "{detail}");
    let slewed = site.mount.log.lock().unwrap().iter().any(|(_, command)| matches!(command, Mount::Slew { .. }));
    assert!(!slewed);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_schedule_leaves_the_old_one_and_is_reported() {
    let site = Site::new(1.0).await;
    let calibration = r#"{"exptime": [0], "n": [1]}"#;
    site.write_schedule(&[("calibration", calibration, "02:00:00", "05:00:00")]);
    let node = site.start().await;
    site.until("done", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    site.write_schedule(&[("calibratio", calibration, "02:00:00", "05:00:00")]);
    site.order(OrderKind::ReloadSchedule).await;
    let refused = |site: &Site| site.schedule.get().and_then(|received| received.sample.body.refused);
    site.until("refused", MOST, |site| refused(site).is_some()).await;
    assert!(refused(&site).unwrap().contains("did you mean \"calibration\"?"));
    assert_eq!(statuses(&site), [RowStatus::Finished]);
    site.write_schedule(&[
        ("calibration", calibration, "02:00:00", "05:00:00"),
        ("calibration", calibration, "02:00:00", "04:00:00"),
    ]);
    site.until("taken", MOST, |site| statuses(site) == [RowStatus::Finished; 2]).await;
    assert!(refused(&site).is_none());
    assert_eq!(site.exposures(), 2, "the row that was done is not done again");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hold_of_the_guard_is_ended_before_opening() {
    let site = Site::new(20.0).await;
    site.hold.store(true, Ordering::Relaxed);
    site.write_schedule(&[("open", "{}", "03:00:00", "08:00:00")]);
    let node = site.start().await;
    site.until("finished", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    let log = site.dome.log.lock().unwrap().clone();
    let commands: Vec<&Dome> = log.iter().map(|(_, command)| command).collect();
    assert_eq!(commands[..2], [&Dome::Resume, &Dome::OpenShutter], "{commands:?}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_is_silent_until_the_lease_is_free() {
    let site = Site::new(20.0).await;
    site.lease_held.store(true, Ordering::Relaxed);
    site.set_safe(false);
    site.dome.state.send_modify(|state| state.fields.shutter = contract::Datum::Known(Shutter::Open));
    let calibration = r#"{"exptime": [0], "n": [1]}"#;
    site.write_schedule(&[("calibration", calibration, "02:00:00", "05:00:00")]);
    let node = site.start().await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(site.dome.log.lock().unwrap().len(), 0, "whoever commands closes");
    assert!(site.night.get().is_none() && site.safety.get().is_none() && site.exposures() == 0);
    site.lease_held.store(false, Ordering::Relaxed);
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed)).await;
    site.until("done", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_monitor_closes_and_rows_that_need_no_sky_go_on() {
    let site = Site::new(1.0).await;
    let open = ("open", "{}", "02:00:00", "05:00:00");
    site.write_schedule(&[open]);
    let node = site.start().await;
    site.until("open", MOST, |site| site.shutter() == Some(Shutter::Open)).await;
    site.write_schedule(&[open, ("calibration", r#"{"exptime": [60], "n": [5]}"#, "02:30:00", "05:00:00")]);
    site.until("taken from the file", MOST, |site| statuses(site).len() == 2).await;
    site.monitor.state.send_modify(|state| {
        let reason = contract::NoData::new("timeout", "2 s");
        state.link = contract::Link::Lost { reason };
    });
    site.until("closed", MOST, |site| site.shutter() == Some(Shutter::Closed)).await;
    let lost = |site: &Site| {
        let reasons = site.safety.get().map(|received| received.sample.body.reasons).unwrap_or_default();
        reasons.first().is_some_and(|reason| reason.why.contains("link lost: timeout: 2 s"))
    };
    site.until("the reason published", MOST, lost).await;
    site.until("exposing all the same", MOST, Site::is_exposing).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_that_rests_for_a_silent_camera_goes_on_when_it_answers() {
    let mut site = Site::new(60.0).await;
    // Nobody sees the end of such a rest.
    site.more = "[faults]\nretries = 0\npause_s = 0.2\nrest_s = 3600\n";
    site.write_schedule(&[("calibration", r#"{"exptime": [1], "n": [2]}"#, "02:00:00", "09:00:00")]);
    let reason = contract::NoData::new("timeout", "2 s");
    site.camera.state.send_modify(|state| state.link = contract::Link::Lost { reason });
    let node = site.start().await;
    let rests = |site: &Site| {
        let schedule = site.schedule.get().map(|received| received.sample.body);
        schedule
            .is_some_and(|schedule| schedule.rows[0].detail.contains(", or when paranal/callisto/camera/cam answers"))
    };
    site.until("resting", MOST, rests).await;
    // Somebody else had the lease for a moment.
    let other = site.tokens.fetch_add(1, Ordering::SeqCst) + 1;
    let commands_again = |site: &Site| site.tokens.load(Ordering::SeqCst) > other && statuses(site).len() == 1;
    site.until("in command again", MOST, commands_again).await;
    site.until("resting under the new lease", MOST, rests).await;
    assert_eq!(site.exposures(), 0);
    site.camera.state.send_modify(|state| state.link = contract::Link::Connected);
    site.until("finished", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_roof_that_its_guard_has_shut_is_opened_again() {
    let site = Site::new(20.0).await;
    let object = format!(r#"{{"object": "x", "exptime": 10, {TARGET}, "n": 4}}"#);
    site.write_schedule(&[("object", &object, "03:00:00", "08:00:00")]);
    site.shutter_of_camera.hold_after(1);
    let node = site.start().await;
    site.until("exposing", MOST, |site| site.exposures() == 1).await;
    site.hold.store(true, Ordering::Relaxed);
    site.dome.state.send_modify(|state| state.fields.shutter = contract::Datum::Known(Shutter::Closed));
    site.shutter_of_camera.let_go();
    site.until("finished", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    let opened = site.dome.log.lock().unwrap().iter().filter(|(_, command)| *command == Dome::OpenShutter).count();
    assert!(opened >= 2, "{opened}");
    assert_eq!(site.exposures(), 4);
    node.stop().await;
}
