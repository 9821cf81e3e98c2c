//! A killed observatory node continues after its restart where it was.

use contract::Role;
use serde_json::json;
use test_support::{Rig, RigOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_observatory_counts_the_frames_that_were_taken() -> anyhow::Result<()> {
    let mut rig =
        Rig::new(RigOptions::default(), |world| vec![row("open", json!({})), object(world, "Long field", 15.0, 10)])
            .await?;
    rig.start_all()?;
    let taken = |rig: &Rig| {
        let rows = rig.schedule.get().map(|schedule| schedule.said.body.rows).unwrap_or_default();
        rows.iter().find(|row| row.action == "object").map_or(0, |row| row.frames)
    };
    rig.until("four frames are taken", 90.0, |rig| taken(rig) >= 4).await?;
    rig.kill(Role::Observatory)?;
    rig.start(Role::Observatory)?;
    rig.until("the night ends", 150.0, |rig| rig.night.get().is_some_and(|night| night.said.body.ended)).await?;
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    assert_eq!(taken(&rig), 10);
    // The frame that was under way when the node died may be one more, never one less.
    let files = rig.fits().len();
    assert!((10..=11).contains(&files), "{files} files");
    Ok(())
}
