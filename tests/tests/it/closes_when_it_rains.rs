//! Rain closes the dome, and a dry dwell opens it again.

use serde_json::json;
use test_support::{Harness, HarnessOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn closes_when_it_rains_and_opens_again() -> anyhow::Result<()> {
    let mut harness = Harness::new(HarnessOptions::default(), |world| {
        vec![row("open", json!({})), object(world, "Wet field", 20.0, 500)]
    })
    .await?;
    harness.start_all()?;
    harness.until("the dome opens on a safe sky", 60.0, Harness::is_open).await?;
    let frames = |harness: &Harness| harness.night.get().map_or(0, |night| night.sample.body.frames);
    harness.until("two frames are taken", 60.0, |harness| frames(harness) >= 2).await?;

    harness.simulator.world().rain(true);
    harness.until("the dome is shut in the rain", 30.0, Harness::is_shut).await?;
    harness.until("the mount is parked in the rain", 30.0, Harness::is_parked).await?;
    let before = frames(&harness);
    tokio::time::sleep(std::time::Duration::from_secs(4)).await;
    assert!(frames(&harness) <= before + 1, "at most the frame that was being read out");
    assert!(harness.is_shut());

    harness.simulator.world().rain(false);
    harness.until("the dome opens after the dwell", 60.0, Harness::is_open).await?;
    harness.until("the row goes on", 60.0, |harness| frames(harness) > before + 1).await?;

    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}
