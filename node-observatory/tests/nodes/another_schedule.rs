//! Another schedule while the night goes on: by the file or by order, with nothing running or in the middle of a row.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use contract::device::camera::Command as Camera;
use contract::observatory::{RowState, RowStatus};
use contract::{OrderKind, Reason, Reply};
use node_observatory::schedule_file::versions::Versions;

use crate::MOST;
use crate::site::Site;

/// Near the zenith of the site at the start of the scenarios.
const TARGET: &str = r#""ra": 45.0, "dec": -24.6"#;

fn rows(site: &Site) -> Vec<RowState> {
    site.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default()
}

fn refused(site: &Site) -> Option<String> {
    site.schedule.get().and_then(|received| received.sample.body.refused)
}

fn file(site: &Site) -> PathBuf {
    site.folder.path().join("schedule.jsonl")
}

fn versions(site: &Site) -> Vec<(u64, String, String)> {
    let versions = Versions::within(&site.folder.path().join("data"), "callisto").list().unwrap();
    versions.into_iter().map(|stored| (stored.version, stored.author, stored.reason)).collect()
}

fn by_file(version: u64) -> (u64, String, String) {
    (version, "file".to_owned(), String::new())
}

const CALIBRATION: &str = r#"{"exptime": [0], "n": [1]}"#;
/// Rows whose time has not come.
pub const LATER: [(&str, &str, &str, &str); 3] = [
    ("calibration", CALIBRATION, "05:00:00", "06:00:00"),
    ("calibration", CALIBRATION, "06:00:00", "07:00:00"),
    ("calibration", CALIBRATION, "07:00:00", "08:00:00"),
];

/// Waits until so many rows are published.
pub async fn until_rows(site: &Site, count: usize) {
    site.until(&format!("{count} rows"), MOST, |site| rows(site).len() == count).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_change_while_nothing_runs_becomes_active_also_one_with_an_older_time() {
    let site = Site::new(1.0).await;
    site.write_schedule(&LATER[..1]);
    let node = site.start().await;
    until_rows(&site, 1).await;
    site.until("kept", MOST, |site| versions(site).len() == 1).await;

    site.write_schedule(&LATER[..2]);
    until_rows(&site, 2).await;

    // As a copy of last year's file would come: of an older time than the one in force.
    let stored = std::fs::read(file(&site)).unwrap();
    site.write_schedule(&LATER);
    let old = std::fs::File::options().write(true).open(file(&site)).unwrap();
    old.set_modified(SystemTime::now() - Duration::from_secs(400 * 86_400)).unwrap();
    drop(old);
    until_rows(&site, 3).await;
    let other = site.folder.path().join("older");
    std::fs::write(&other, stored).unwrap();
    let older = std::fs::File::options().write(true).open(&other).unwrap();
    older.set_modified(SystemTime::now() - Duration::from_secs(800 * 86_400)).unwrap();
    drop(older);
    std::fs::rename(&other, file(&site)).unwrap();
    until_rows(&site, 2).await;

    // Half of a file, and none at all: the rows stay, and the reason is published.
    std::fs::write(file(&site), "{\"device_name\": \"cam\", \"act").unwrap();
    site.until("refused", MOST, |site| refused(site).is_some_and(|why| why.contains("line 1"))).await;
    std::fs::remove_file(file(&site)).unwrap();
    site.until("gone", MOST, |site| refused(site).is_some_and(|why| why.contains("cannot be read"))).await;
    assert_eq!(rows(&site).len(), 2);
    site.write_schedule(&LATER);
    until_rows(&site, 3).await;
    assert_eq!(refused(&site), None);
    site.until("kept", MOST, |site| versions(site).len() == 5).await;
    assert_eq!(versions(&site), [1, 2, 3, 4, 5].map(by_file));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_at_work_goes_on_where_it_stays_and_ends_with_its_frame_where_it_is_taken_out() {
    let site = Site::new(20.0).await;
    let (x, y) = (
        format!(r#"{{"object": "x", "exptime": 10, {TARGET}}}"#),
        format!(r#"{{"object": "y", "exptime": 10, {TARGET}, "n": 2}}"#),
    );
    let (row_x, row_y) =
        (("object", x.as_str(), "02:59:00", "08:00:00"), ("object", y.as_str(), "02:59:00", "08:00:00"));
    site.write_schedule(&[row_x]);
    site.shutter_of_camera.hold_after(1);
    let node = site.start().await;
    site.until("in the second frame", MOST, |site| site.exposures() == 1 && site.is_exposing()).await;

    // A row before it: the one at work is at another place now, and its frames are counted there.
    site.write_schedule(&[("calibration", CALIBRATION, "01:00:00", "02:00:00"), row_x]);
    site.until("two rows", MOST, |site| rows(site).len() == 2).await;
    assert_eq!(rows(&site)[1].status, RowStatus::Running);
    site.shutter_of_camera.hold_after(3);
    site.until("counted at its place", MOST, |site| rows(site)[1].frames >= 3).await;
    let actions = site.night.get().unwrap().sample.body.actions;
    assert_eq!(actions.iter().map(|action| action.row).collect::<Vec<_>>(), [1]);
    assert_eq!(rows(&site)[0].frames, 0);

    // Another target: the frame under way is the last one of the old.
    site.until("in a frame", MOST, Site::is_exposing).await;
    site.write_schedule(&[row_y]);
    until_rows(&site, 1).await;
    site.shutter_of_camera.let_go();
    site.until("y is done", MOST, |site| {
        matches!(&rows(site)[..], [row] if row.object.as_deref() == Some("y") && row.status == RowStatus::Finished)
    })
    .await;
    let (begun, aborted) = {
        let log = site.camera.log.lock().unwrap();
        let count = |is: fn(&Camera) -> bool| log.iter().filter(|(_, command)| is(command)).count();
        (count(|command| matches!(command, Camera::Expose { .. })), count(|command| matches!(command, Camera::Abort)))
    };
    let of = |object: &str| {
        site.purposes.lock().unwrap().iter().filter(|(_, purpose)| purpose.object.as_deref() == Some(object)).count()
    };
    assert_eq!((aborted, of("y")), (0, 2));
    assert_eq!(of("x") + of("y"), begun, "every frame that was begun was ended");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_schedule_by_order_is_proven_put_whole_and_stored_with_author_and_reason() {
    let site = Site::new(1.0).await;
    site.write_schedule(&LATER[..1]);
    let node = site.start().await;
    until_rows(&site, 1).await;
    site.until("kept", MOST, |site| versions(site).len() == 1).await;
    let before = std::fs::read_to_string(file(&site)).unwrap();
    let refusal = |reply: Reply| match reply {
        Reply::Refusal(refusal) => (refusal.reason, refusal.detail),
        Reply::Accepted(accepted) => panic!("{accepted:?}"),
    };

    let bad = before.replace("calibration", "calibratio");
    let (reason, why) = refusal(site.order(OrderKind::PutSchedule { text: bad, instead_of: None }).await);
    assert_eq!(reason, Reason::Malformed);
    assert!(why.contains("line 1") && why.contains("did you mean \"calibration\"?"), "{why}");
    let (reason, why) =
        refusal(site.order(OrderKind::PutSchedule { text: " ".repeat(1_000_001), instead_of: None }).await);
    assert!(reason == Reason::Malformed && why.contains("at most 1000000"), "{why}");

    // A folder where the new file is to be written: as a disk that takes nothing.
    let good = format!("{before}{}", before.replace("05:00:00", "05:30:00"));
    let part = site.folder.path().join("schedule.jsonl.part");
    std::fs::create_dir(&part).unwrap();
    let (reason, why) = refusal(site.order(OrderKind::PutSchedule { text: good.clone(), instead_of: None }).await);
    assert!(reason == Reason::NotNow && why.contains("nothing was changed"), "{why}");
    std::fs::remove_dir(&part).unwrap();
    assert_eq!(std::fs::read_to_string(file(&site)).unwrap(), before);
    assert_eq!(versions(&site), [by_file(1)]);
    assert_eq!(rows(&site).len(), 1);

    let accepted = site.order(OrderKind::PutSchedule { text: good.clone(), instead_of: None }).await;
    assert!(matches!(accepted, Reply::Accepted(_)), "{accepted:?}");
    until_rows(&site, 2).await;
    assert_eq!(std::fs::read_to_string(file(&site)).unwrap(), good);
    assert_eq!(versions(&site), [by_file(1), (2, "test".to_owned(), "a test".to_owned())]);
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_names_the_schedule_it_replaces_does_not_replace_another_one() {
    let site = Site::new(1.0).await;
    site.write_schedule(&LATER[..1]);
    let node = site.start().await;
    until_rows(&site, 1).await;
    let sha256 = |site: &Site| site.schedule.get().unwrap().sample.body.sha256;
    let seen = sha256(&site);
    let text = std::fs::read_to_string(file(&site)).unwrap();
    let put = |end: &str| text.replace("06:00:00", end);
    let order = async |text: String, instead_of: Option<String>| match site
        .order(OrderKind::PutSchedule { text, instead_of })
        .await
    {
        Reply::Accepted(_) => Ok(()),
        Reply::Refusal(refusal) => Err((refusal.reason, refusal.detail)),
    };
    order(put("06:10:00"), seen.clone()).await.unwrap();
    // Of two who saw the same, the second comes too late, also at once.
    let (reason, why) = order(put("06:20:00"), seen.clone()).await.unwrap_err();
    assert!(reason == Reason::WrongState && why.contains("another schedule is in force"), "{why}");
    assert_eq!(std::fs::read_to_string(file(&site)).unwrap(), put("06:10:00"));
    // A person may have written the file a moment ago; half of a file counts for nothing.
    site.until("taken", MOST, |site| sha256(site) != seen).await;
    let now = sha256(&site);
    std::fs::write(file(&site), put("06:30:00")).unwrap();
    assert_eq!(order(put("06:40:00"), now.clone()).await.unwrap_err().0, Reason::WrongState);
    site.until("read", MOST, |site| sha256(site) != now).await;
    let now = sha256(&site);
    std::fs::write(file(&site), "{\"device_name\": \"cam\", \"act").unwrap();
    order(put("06:50:00"), now).await.unwrap();
    assert_eq!(std::fs::read_to_string(file(&site)).unwrap(), put("06:50:00"));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reason_of_any_length_closes_and_a_long_one_loosens_nothing() {
    let site = Site::new(1.0).await;
    site.write_schedule(&LATER[..1]);
    let node = site.start().await;
    until_rows(&site, 1).await;
    let order = async |kind: OrderKind, reason: String| {
        let order =
            contract::Order { id: contract::CommandId::fresh(), from: "web/ana".to_owned(), reason, kind, seen: None };
        crate::site::ask(&site.bus, &site.address, &order).await
    };
    let long = "e".repeat(501);
    let refused = order(OrderKind::ReloadSchedule, long.clone()).await;
    assert!(
        matches!(&refused, Reply::Refusal(refusal) if refusal.reason == Reason::Malformed && refusal.detail.contains("at most 500")),
        "{refused:?}"
    );
    assert!(matches!(order(OrderKind::ReloadSchedule, "e".repeat(500)).await, Reply::Accepted(_)));
    assert!(matches!(order(OrderKind::StayClosed(true), long).await, Reply::Accepted(_)));
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_schedule_file_that_is_not_there_is_an_alert_while_the_switch_is_on_and_reload_says_so() {
    let site = Site::new(1.0).await;
    let node = site.start().await;
    let cause = |site: &Site| {
        let alerts = site.alerts.get().map(|received| received.sample.body.alerts).unwrap_or_default();
        let found = alerts.into_iter().find(|alert| alert.id == "schedule-refused" && alert.returned_utc.is_none());
        found.map(|alert| alert.cause).unwrap_or_default()
    };
    let reloads = async |site: &Site| match site.order(OrderKind::ReloadSchedule).await {
        Reply::Accepted(_) => None,
        Reply::Refusal(refusal) => Some(refusal.detail),
    };
    site.until("an alert", MOST, |site| cause(site).contains("there is no such file")).await;
    let why = reloads(&site).await.unwrap();
    assert!(why.contains("schedule.jsonl: there is no such file; write the schedule there"), "{why}");
    assert!(matches!(site.order(OrderKind::Robotic(false)).await, Reply::Accepted(_)));
    site.until("no alert while the switch is off", MOST, |site| cause(site).is_empty()).await;
    site.write_schedule(&LATER[..1]);
    assert_eq!(reloads(&site).await, None);
    until_rows(&site, 1).await;
    std::fs::remove_file(file(&site)).unwrap();
    site.until("an alert", MOST, |site| cause(site).contains("the rows that were read last stay in force")).await;
    let why = reloads(&site).await.unwrap();
    assert!(why.contains("the file is gone; the rows that were read last stay in force"), "{why}");
    site.write_schedule(&LATER);
    assert_eq!(reloads(&site).await, None);
    site.until("no alert", MOST, |site| cause(site).is_empty()).await;
    node.stop().await;
}
