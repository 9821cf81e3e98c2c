//! `starmesh up` runs all four nodes, starts those again that hang, and on Ctrl-C leaves a closed dome and no process behind.
#![cfg(unix)]

use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bus::Latest;
use contract::node::NodeState;
use contract::observatory::Alerts;
use contract::{Address, Key, NodeTopic, Payload, Role};
use test_support::{Harness, HarnessOptions, SITE, TELESCOPE, long_row};

/// What a node of the test's telescope publishes.
async fn latest<T: Payload>(harness: &Harness, role: Role, id: &str, topic: NodeTopic) -> anyhow::Result<Latest<T>> {
    Ok(harness.bus.latest(&Key::Node(Address::new(SITE, TELESCOPE)?, role, id.parse()?, topic)).await?)
}

/// Presses Ctrl-C and waits for the end; returns whether it was one in good order, and the log.
async fn stop(harness: &Harness, mut up: Child) -> anyhow::Result<(bool, String)> {
    let status = Command::new("kill").args(["-INT", &up.id().to_string()]).status()?;
    let began = Instant::now();
    let mut ended = None;
    while ended.is_none() && began.elapsed() < Duration::from_secs(90) {
        tokio::time::sleep(Duration::from_millis(100)).await;
        ended = up.try_wait()?;
    }
    let log = std::fs::read_to_string(harness.path("up.log"))?;
    if ended.is_none() {
        up.kill()?;
    }
    Ok((status.success() && ended.is_some_and(|status| status.success()), log))
}

#[tokio::test(flavor = "multi_thread")]
async fn up_runs_a_telescope_and_closes_it_when_it_is_stopped_and_each_node_reports_that_it_was() -> anyhow::Result<()>
{
    let harness = Harness::new(HarnessOptions::default(), long_row).await?;
    let nodes =
        [(Role::Observatory, "main"), (Role::Device, "enclosure"), (Role::Device, "main"), (Role::Archive, "main")];
    let mut states: Vec<Latest<NodeState>> = Vec::new();
    for (role, id) in nodes {
        states.push(latest(&harness, role, id, NodeTopic::State).await?);
    }
    let up = harness.up()?;
    let opened = harness.until("the dome opens under `starmesh up`", 90.0, Harness::is_open).await;
    let (well, log) = stop(&harness, up).await?;
    opened.map_err(|error| anyhow::anyhow!("{error}\n{log}"))?;
    assert!(well, "{log}");
    assert_eq!(harness.simulator.world().dome_open(), 0.0, "the guard closed before the device node ended\n{log}");
    assert!(!log.contains("next start"), "no node ended by itself\n{log}");
    let last = |state: &Latest<NodeState>| state.get().and_then(|state| state.sample.body.stopped);
    harness.until("each last state arrives", 60.0, |_| states.iter().all(|state| last(state).is_some())).await?;
    for (state, closed) in states.iter().zip([Some(true), Some(true), None, None]) {
        let stopped = last(state).context("it has arrived")?;
        assert!(stopped.by.starts_with("starmesh up on ") && stopped.closed == closed, "{stopped:?}");
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_hangs_under_up_is_ended_and_started_again_and_an_alert_reports_it() -> anyhow::Result<()> {
    let harness = Harness::new(HarnessOptions::default(), long_row).await?;
    let state: Latest<NodeState> = latest(&harness, Role::Archive, "main", NodeTopic::State).await?;
    let alerts: Latest<Alerts> = latest(&harness, Role::Device, "starmesh-up", NodeTopic::Alerts).await?;
    let up = harness.up()?;
    let pid = |state: &Latest<NodeState>| state.get().map(|state| state.sample.body.pid);
    let hung = async {
        harness.until("the archive node runs", 90.0, |_| pid(&state).is_some()).await?;
        let before = pid(&state);
        let status = Command::new("kill").args(["-STOP", &before.unwrap_or_default().to_string()]).status()?;
        anyhow::ensure!(status.success(), "the archive node could not be stopped");
        harness.until("another archive node runs", 180.0, |_| pid(&state) != before).await?;
        let is_raised = |alerts: &Latest<Alerts>| {
            alerts.get().is_some_and(|list| list.sample.body.alerts.iter().any(|a| a.id == "node-ends/archive/main"))
        };
        harness.until("`up` reports it", 60.0, |_| is_raised(&alerts)).await
    };
    let hung = hung.await;
    let (well, log) = stop(&harness, up).await?;
    hung.map_err(|error| anyhow::anyhow!("{error}\n{log}"))?;
    assert!(well && log.contains("it did not report for 20 s"), "{log}");
    Ok(())
}
