//! Orders about one row: done without, and run again.

use contract::device::dome::Shutter;
use contract::observatory::{RowState, RowStatus};
use contract::{OrderKind, OrderedRow, Reason, Reply};

use crate::MOST;
use crate::site::Site;

fn rows(site: &Site) -> Vec<RowState> {
    site.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default()
}

fn statuses(site: &Site) -> Vec<RowStatus> {
    rows(site).iter().map(|row| row.status).collect()
}

fn skip(row: u32) -> OrderKind {
    OrderKind::Skip(OrderedRow { row, of: None })
}

fn repeat(row: u32) -> OrderKind {
    OrderKind::Repeat(OrderedRow { row, of: None })
}

async fn accepted(site: &Site, kind: OrderKind) {
    let reply = site.order(kind.clone()).await;
    assert!(matches!(reply, Reply::Accepted(_)), "{kind:?}: {reply:?}");
}

async fn refused(site: &Site, kind: OrderKind) -> (Reason, String) {
    match site.order(kind.clone()).await {
        Reply::Refusal(refusal) => (refusal.reason, refusal.detail),
        accepted @ Reply::Accepted(_) => panic!("{kind:?}: {accepted:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_at_work_is_skipped_after_its_frame_and_rows_run_again_by_order_also_after_a_restart() {
    let site = Site::new(20.0).await;
    let object = r#"{"object": "x", "exptime": 10, "ra": 45.0, "dec": -24.6, "n": 3}"#;
    site.write_schedule(&[
        ("object", object, "03:00:00", "08:00:00"),
        ("calibration", r#"{"exptime": [0], "n": [2]}"#, "03:20:00", "08:00:00"),
        ("calibration", r#"{"exptime": [0], "n": [1]}"#, "07:00:00", "08:00:00"),
    ]);
    site.shutter_of_camera.hold_after(1);
    let node = site.start().await;
    let is_at_work = |site: &Site| statuses(site).first() == Some(&RowStatus::Running);
    let in_second = |site: &Site| is_at_work(site) && site.exposures() == 1 && site.is_exposing();
    site.until("in the second frame", MOST, in_second).await;
    let (reason, why) = refused(&site, repeat(0)).await;
    assert_eq!((reason, why.as_str()), (Reason::WrongState, "row 1 is under way; to begin it anew, skip it first"));
    accepted(&site, skip(0)).await;
    assert!(site.is_exposing(), "its frame is not lost");
    // One that has not begun.
    accepted(&site, skip(2)).await;
    site.until("done without", MOST, |site| statuses(site).get(2) == Some(&RowStatus::Skipped)).await;
    site.shutter_of_camera.let_go();
    use RowStatus::{Finished, Skipped};
    site.until("the next row", MOST, |site| statuses(site) == [Skipped, Finished, Skipped]).await;
    assert_eq!(site.exposures(), 2 + 2);
    assert_eq!(rows(&site)[0].detail, "skipped by test: a test");

    // A restart does not begin it again.
    node.stop().await;
    let node = site.start().await;
    site.until("as before", MOST, |site| statuses(site) == [Skipped, Finished, Skipped]).await;

    let (reason, why) = refused(&site, skip(1)).await;
    assert_eq!((reason, why.as_str()), (Reason::WrongState, "row 2 has ended already: it is finished"));
    let (reason, why) = refused(&site, skip(7)).await;
    assert_eq!((reason, why.as_str()), (Reason::Malformed, "there is no row 8: the schedule in force has 3 rows"));
    let of_another = OrderKind::Skip(OrderedRow { row: 2, of: Some("abc".to_owned()) });
    let (reason, why) = refused(&site, of_another).await;
    assert!(reason == Reason::WrongState && why.starts_with("another schedule is in force"), "{why}");

    accepted(&site, repeat(1)).await;
    site.until("two frames anew", MOST, |site| site.exposures() == 6 && statuses(site)[1] == Finished).await;
    // It lacked one.
    accepted(&site, repeat(0)).await;
    site.until("its last frame", MOST, |site| statuses(site) == [Finished, Finished, Skipped]).await;
    assert_eq!((site.exposures(), rows(&site)[0].frames, rows(&site)[1].frames), (7, 3, 2));
    site.until("closed again", MOST, |site| site.shutter() == Some(Shutter::Closed)).await;

    node.stop().await;
    let node = site.start().await;
    site.until("as before", MOST, |site| statuses(site) == [Finished, Finished, Skipped]).await;
    assert_eq!(site.exposures(), 7, "a restart takes nothing again");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_row_that_rests_is_tried_at_once_by_order() {
    let mut site = Site::new(60.0).await;
    // Nobody sees the end of such a rest, nor that the camera answers again.
    site.more = "[faults]\nretries = 0\npause_s = 3600\nrest_s = 3600\n";
    site.write_schedule(&[("calibration", r#"{"exptime": [1], "n": [2]}"#, "02:00:00", "09:00:00")]);
    let reason = contract::NoData::new("timeout", "2 s");
    site.camera.state.send_modify(|state| state.link = contract::Link::Lost { reason });
    let node = site.start().await;
    site.until("resting", MOST, |site| statuses(site) == [RowStatus::Interrupted]).await;
    site.camera.state.send_modify(|state| state.link = contract::Link::Connected);
    accepted(&site, repeat(0)).await;
    site.until("finished", MOST, |site| statuses(site) == [RowStatus::Finished]).await;
    node.stop().await;
}
