//! Whichever node dies, the dome closes.

use std::time::Duration;

use contract::Role;
use test_support::Rig;

#[tokio::test(flavor = "multi_thread")]
async fn the_guard_closes_when_the_observatory_is_killed() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.kill(Role::Observatory)?;
    // The permit lasts 5 s here; shutter travel and a noisy machine take the rest.
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

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn an_observatory_that_is_asked_to_end_closes_first() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    let well = rig.ask_to_end(Role::Observatory, Duration::from_secs(20)).await?;
    assert_eq!(rig.simulator.world().dome_open(), 0.0, "{}", rig.last_words());
    assert!(well, "{}", rig.last_words());
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_is_asked_to_end_closes_first() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    let well = rig.ask_to_end(Role::Device, Duration::from_secs(60)).await?;
    assert_eq!(rig.simulator.world().dome_open(), 0.0, "{}", rig.last_words());
    assert!(well, "{}", rig.last_words());
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn an_observatory_that_is_asked_to_end_beside_a_standby_leaves_the_roof_open() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.start_standby()?;
    // The standby publishes its state every 5 s.
    tokio::time::sleep(Duration::from_secs(7)).await;
    assert!(rig.ask_to_end(Role::Observatory, Duration::from_secs(20)).await?, "{}", rig.last_words());
    let ended = std::time::Instant::now();
    while ended.elapsed() < Duration::from_secs(10) {
        assert!(rig.simulator.world().dome_open() > 0.0, "it closed\n{}", rig.last_words());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Ok(())
}
