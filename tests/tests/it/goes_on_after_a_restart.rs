//! A killed observatory node continues after its restart where it was.

use contract::Role;
use serde_json::json;
use test_support::{Harness, HarnessOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_observatory_counts_the_frames_that_were_taken() -> anyhow::Result<()> {
    let mut harness = Harness::new(HarnessOptions::default(), |world| {
        vec![row("open", json!({})), object(world, "Long field", 15.0, 10)]
    })
    .await?;
    harness.start_all()?;
    let taken = |harness: &Harness| {
        let rows = harness.schedule.get().map(|schedule| schedule.sample.body.rows).unwrap_or_default();
        rows.iter().find(|row| row.action == "object").map_or(0, |row| row.frames)
    };
    harness.until("four frames are taken", 90.0, |harness| taken(harness) >= 4).await?;
    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    harness
        .until("the night ends", 150.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    assert_eq!(taken(&harness), 10);
    // The frame that was under way when the node died may be one more, never one less.
    let files = harness.fits().len();
    assert!((10..=11).contains(&files), "{files} files");
    Ok(())
}
