//! Whichever node dies, the dome closes.

use std::time::Duration;

use contract::Role;
use test_support::Harness;

#[tokio::test(flavor = "multi_thread")]
async fn the_guard_closes_when_the_observatory_is_killed() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    harness.kill(Role::Observatory)?;
    // The permit lasts 5 s here; shutter travel and a noisy machine take the rest.
    harness.until("the guard closes by itself", 30.0, Harness::is_shut).await?;
    let holds = |harness: &Harness| {
        let guard = harness.guard.get().map(|guard| guard.sample.body);
        guard.is_some_and(|guard| !guard.may_be_open && guard.hold)
    };
    harness.until("the guard shows that it holds the dome", 10.0, holds).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_starts_at_an_open_dome_closes_it_without_a_permit() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    harness.kill(Role::Observatory)?;
    harness.kill(Role::Device)?;
    assert!(harness.simulator.world().dome_open() > 0.0, "nobody was left to close");
    harness.start(Role::Device)?;
    harness.until("the new device node closes", 40.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_observatory_takes_over_and_opens_again() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    harness.kill(Role::Observatory)?;
    harness.until("the guard closes by itself", 30.0, Harness::is_shut).await?;
    harness.start(Role::Observatory)?;
    let token = |harness: &Harness| harness.guard.get().map_or(0, |guard| guard.sample.body.token);
    harness.until("the new commander has the next token", 40.0, |harness| token(harness) >= 2).await?;
    harness.until("the guard lets the newest commander open", 60.0, Harness::is_open).await?;
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn an_observatory_that_is_asked_to_end_closes_first() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    let well = harness.ask_to_end(Role::Observatory, Duration::from_secs(20)).await?;
    assert_eq!(harness.simulator.world().dome_open(), 0.0, "{}", harness.last_words());
    assert!(well, "{}", harness.last_words());
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_device_node_that_is_asked_to_end_closes_first() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    let well = harness.ask_to_end(Role::Device, Duration::from_secs(60)).await?;
    assert_eq!(harness.simulator.world().dome_open(), 0.0, "{}", harness.last_words());
    assert!(well, "{}", harness.last_words());
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn an_observatory_that_is_asked_to_end_alongside_a_standby_leaves_the_roof_open() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    harness.start_standby()?;
    // The standby publishes its state every 5 s.
    tokio::time::sleep(Duration::from_secs(7)).await;
    assert!(harness.ask_to_end(Role::Observatory, Duration::from_secs(20)).await?, "{}", harness.last_words());
    let ended = std::time::Instant::now();
    while ended.elapsed() < Duration::from_secs(10) {
        assert!(harness.simulator.world().dome_open() > 0.0, "it closed\n{}", harness.last_words());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Ok(())
}
