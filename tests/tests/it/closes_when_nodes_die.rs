//! Whoever dies, the dome closes.

use contract::Role;
use tests::Rig;

#[tokio::test(flavor = "multi_thread")]
async fn the_guard_closes_when_the_observatory_is_killed() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.kill(Role::Observatory)?;
    // the permit lasts 5 s here; shutter travel and a noisy machine take the rest
    rig.until("the guard closes by itself", 30.0, Rig::is_shut).await?;
    let holds = |rig: &Rig| {
        let guard = rig.guard.get().map(|guard| guard.said.body);
        guard.is_some_and(|guard| !guard.may_be_open && guard.hold)
    };
    rig.until("the guard tells that it holds the dome", 10.0, holds).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_starts_at_an_open_dome_closes_it_without_a_permit() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.kill(Role::Observatory)?;
    rig.kill(Role::Device)?;
    assert!(rig.simulator.world().dome_open() > 0.0, "nobody was left to close");
    rig.start(Role::Device)?;
    rig.until("the new device node closes", 40.0, Rig::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_observatory_takes_over_and_opens_again() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.kill(Role::Observatory)?;
    rig.until("the guard closes by itself", 30.0, Rig::is_shut).await?;
    rig.start(Role::Observatory)?;
    let token = |rig: &Rig| rig.guard.get().map_or(0, |guard| guard.said.body.token);
    rig.until("the new commander has the next token", 40.0, |rig| token(rig) >= 2).await?;
    rig.until("the guard lets the newest commander open", 60.0, Rig::is_open).await?;
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    Ok(())
}
