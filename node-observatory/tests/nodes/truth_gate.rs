//! Frames that do not show where they look: none counts, unless the row or the site allows it.

use contract::observatory::{RowState, RowStatus};

use crate::MOST;
use crate::site::Site;

/// Near the zenith of the site at the start of the scenarios.
const TARGET: &str = r#""exptime": 1, "ra": 45.0, "dec": -24.6, "pointing": true"#;

fn rows(site: &Site) -> Vec<RowState> {
    site.schedule.get().map(|received| received.sample.body.rows).unwrap_or_default()
}

fn alerts(site: &Site) -> Vec<String> {
    let published = site.alerts.get().map(|received| received.sample.body.alerts);
    published.unwrap_or_default().into_iter().map(|alert| alert.id).collect()
}

/// Frames of a row, by ASTRATYP.
fn frames(site: &Site, row: u32, action: &str) -> usize {
    let purposes = site.purposes.lock().unwrap();
    purposes.iter().filter(|(_, purpose)| purpose.row == Some(row) && purpose.action == action).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_frame_counts_where_none_shows_where_it_looks_unless_the_row_allows_it() {
    let mut site = Site::new(20.0).await;
    site.more = "[pointing]\non_failure = \"skip\"\nattempts = 3\n";
    let (proven, unverified) = (
        format!(r#"{{"object": "x", {TARGET}, "n": 2}}"#),
        format!(r#"{{"object": "y", {TARGET}, "n": 2, "unverified": true}}"#),
    );
    site.write_schedule(&[
        ("object", &proven, "03:00:00", "08:00:00"),
        ("object", &unverified, "03:00:01", "08:00:00"),
        ("pointing_model", r#"{"n": 2, "exptime": 1}"#, "03:00:02", "08:00:00"),
    ]);
    let node = site.start().await;
    site.until("at the first row's end", MOST, |site| {
        rows(site).first().is_some_and(|row| row.status == RowStatus::Failed)
    })
    .await;
    let row = rows(&site).remove(0);
    assert_eq!(row.frames, 0, "{row:?}");
    assert!(row.detail.contains("where cam looks is not proven: not fetched"), "{row:?}");
    assert_eq!(
        (frames(&site, 0, "pointing"), frames(&site, 0, "object")),
        (3, 0),
        "it skipped, and was not tried again"
    );
    site.until("alerted", MOST, |site| alerts(site).contains(&"pointing-unproven/cam".to_owned())).await;

    site.until("at the second row's end", MOST, |site| {
        rows(site).get(1).is_some_and(|row| row.status == RowStatus::Finished)
    })
    .await;
    let row = rows(&site).remove(1);
    assert_eq!((row.frames, frames(&site, 1, "pointing"), frames(&site, 1, "object")), (2, 3, 2), "{row:?}");
    assert!(row.detail.contains("not proven"), "it is reported: {row:?}");
    // All have numbers of their own.
    let purposes = site.purposes.lock().unwrap().clone();
    let numbers = purposes.iter().filter(|(_, purpose)| purpose.row == Some(1)).map(|(_, purpose)| purpose.sequence);
    assert_eq!(numbers.collect::<Vec<_>>(), [0, 1, 2, 3, 4]);

    site.until("at the run's end", MOST, |site| rows(site).get(2).is_some_and(|row| row.status == RowStatus::Failed))
        .await;
    let row = rows(&site).remove(2);
    assert!(row.frames == 2 && row.detail.contains("none of 2 frames shows where cam looks"), "{row:?}");
    node.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unproven_row_rests_and_is_tried_again_while_its_window_is_open() {
    let mut site = Site::new(20.0).await;
    site.more = "[pointing]\nattempts = 1\n[faults]\nretries = 1\npause_s = 0.2\nrest_s = 1.0\n";
    site.write_schedule(&[("object", &format!(r#"{{"object": "x", {TARGET}, "n": 2}}"#), "03:00:00", "08:00:00")]);
    let node = site.start().await;
    // One try and one more, a rest, and again.
    site.until("tried again after a rest", MOST, |site| frames(site, 0, "pointing") >= 3).await;
    let row = rows(&site).remove(0);
    assert!(row.frames == 0 && !matches!(row.status, RowStatus::Failed | RowStatus::Finished), "{row:?}");
    assert_eq!(frames(&site, 0, "object"), 0);
    node.stop().await;
}
