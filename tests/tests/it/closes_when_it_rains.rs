//! Rain closes the dome, and a dry dwell opens it again.

use serde_json::json;
use test_support::{Rig, RigOptions, object, row};

#[tokio::test(flavor = "multi_thread")]
async fn closes_when_it_rains_and_opens_again() -> anyhow::Result<()> {
    let mut rig =
        Rig::new(RigOptions::default(), |world| vec![row("open", json!({})), object(world, "Wet field", 20.0, 500)])
            .await?;
    rig.start_all()?;
    rig.until("the dome opens on a safe sky", 60.0, Rig::is_open).await?;
    let frames = |rig: &Rig| rig.night.get().map_or(0, |night| night.said.body.frames);
    rig.until("two frames are taken", 60.0, |rig| frames(rig) >= 2).await?;

    rig.simulator.world().rain(true);
    rig.until("the dome is shut in the rain", 30.0, Rig::is_shut).await?;
    rig.until("the mount is parked in the rain", 30.0, Rig::is_parked).await?;
    let before = frames(&rig);
    tokio::time::sleep(std::time::Duration::from_secs(4)).await;
    assert!(frames(&rig) <= before + 1, "at most the frame that was being read out");
    assert!(rig.is_shut());

    rig.simulator.world().rain(false);
    rig.until("the dome opens after the dwell", 60.0, Rig::is_open).await?;
    rig.until("the row goes on", 60.0, |rig| frames(rig) > before + 1).await?;

    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    Ok(())
}
