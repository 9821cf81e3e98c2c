//! Frames wait for the archive; none is lost, none is doubled.

use std::collections::HashSet;

use contract::Role;
use serde_json::json;
use test_support::{Harness, HarnessOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_that_was_away_stores_every_frame_once() -> anyhow::Result<()> {
    let mut harness = Harness::new(HarnessOptions::default(), |world| {
        vec![row("open", json!({})), object(world, "Kept field", 10.0, 12), row("complete_headers", json!({}))]
    })
    .await?;
    harness.start_all()?;
    let stored = harness.stored().await?;
    let frames = |harness: &Harness| harness.night.get().map_or(0, |night| night.sample.body.frames);
    harness.until("three frames are taken", 90.0, |harness| frames(harness) >= 3).await?;
    harness.kill(Role::Archive)?;
    harness.until("eight frames are taken without an archive", 60.0, |harness| frames(harness) >= 8).await?;
    harness.start(Role::Archive)?;
    harness
        .until("the night ends", 120.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    harness.until("all files are there", 30.0, |harness| harness.fits().len() >= 12).await?;
    assert_eq!(harness.fits().len(), 12);

    let mut complete = HashSet::new();
    while complete.len() < 12 {
        let received = tokio::time::timeout(std::time::Duration::from_secs(60), stored.recv()).await?;
        if received.sample.body.header_complete {
            complete.insert(received.sample.body.frame.0);
        }
    }
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    let rows: i64 = database.query_row("SELECT count(*) FROM images WHERE complete_hdr = 1", [], |row| row.get(0))?;
    assert_eq!(rows, 12);
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}
