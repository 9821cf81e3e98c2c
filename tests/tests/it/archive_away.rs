//! Frames wait for the archive; none is lost, none is doubled.

use std::collections::HashSet;

use contract::Role;
use serde_json::json;
use test_support::{Rig, RigOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_that_was_away_stores_every_frame_once() -> anyhow::Result<()> {
    let mut rig = Rig::new(RigOptions::default(), |world| {
        vec![row("open", json!({})), object(world, "Kept field", 10.0, 12), row("complete_headers", json!({}))]
    })
    .await?;
    rig.start_all()?;
    let stored = rig.stored().await?;
    let frames = |rig: &Rig| rig.night.get().map_or(0, |night| night.said.body.frames);
    rig.until("three frames are taken", 90.0, |rig| frames(rig) >= 3).await?;
    rig.kill(Role::Archive)?;
    rig.until("eight frames are taken without an archive", 60.0, |rig| frames(rig) >= 8).await?;
    rig.start(Role::Archive)?;
    rig.until("the night ends", 120.0, |rig| rig.night.get().is_some_and(|night| night.said.body.ended)).await?;
    rig.until("all files are there", 30.0, |rig| rig.fits().len() >= 12).await?;
    assert_eq!(rig.fits().len(), 12);

    let mut complete = HashSet::new();
    while complete.len() < 12 {
        let heard = tokio::time::timeout(std::time::Duration::from_secs(60), stored.hear()).await?;
        if heard.said.body.header_complete {
            complete.insert(heard.said.body.frame.0);
        }
    }
    let database = rusqlite::Connection::open(rig.path("data/archive.db"))?;
    let rows: i64 = database.query_row("SELECT count(*) FROM images WHERE complete_hdr = 1", [], |row| row.get(0))?;
    assert_eq!(rows, 12);
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    Ok(())
}
