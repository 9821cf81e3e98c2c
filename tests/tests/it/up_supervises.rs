//! `starmesh up` runs all four nodes, starts those again that hang, and on Ctrl-C leaves a closed dome and no process behind.
#![cfg(unix)]

use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use bus::Latest;
use contract::node::NodeState;
use contract::observatory::Alerts;
use contract::{Address, Key, NodeTopic, Payload, Role};
use test_support::{Harness, HarnessOptions, LIMIT, SITE, TELESCOPE, long_row};

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

#[tokio::test(flavor = "multi_thread")]
async fn a_dome_whose_data_folder_is_gone_stays_closed_until_a_person_opens_it_again() -> anyhow::Result<()> {
    let options = HarnessOptions { window_s: 18_000.0, ..HarnessOptions::default() };
    let harness = Harness::new(options, long_row).await?;
    let alerts: Latest<Alerts> = latest(&harness, Role::Observatory, "main", NodeTopic::Alerts).await?;
    let up = harness.up()?;
    let opened = harness.until("the dome opens on its first night", 90.0, Harness::is_open).await;
    let (_, log) = stop(&harness, up).await?;
    opened.map_err(|error| anyhow::anyhow!("{error}\n{log}"))?;

    std::fs::remove_dir_all(harness.path("data"))?;
    let again = harness.up()?;
    let is_lost = |_: &Harness| {
        alerts.get().is_some_and(|list| list.sample.body.alerts.iter().any(|alert| alert.id == "orders-lost"))
    };
    let closed = async {
        harness.until("it says that the orders are lost", 180.0, is_lost).await?;
        anyhow::ensure!(!harness.is_open(), "nobody knows whether it is to stay closed");
        harness.order(&["open-again", "--operator", "ana", "--reason", "nobody is up there"]).await?;
        harness.until("the dome opens again", 180.0, Harness::is_open).await
    };
    let closed = closed.await;
    let (_, log) = stop(&harness, again).await?;
    closed.map_err(|error| anyhow::anyhow!("{error:#}\n{log}"))?;
    assert!(log.contains("stays closed until ") && log.contains(" is gone)"), "{log}");
    Ok(())
}

/// Types a command until it prints what is wanted: nodes take some seconds to take the place of `up`.
async fn until_printed(harness: &Harness, words: &[&str], wanted: &str) -> anyhow::Result<()> {
    let began = Instant::now();
    loop {
        let printed = harness.starmesh(words).await.unwrap_or_else(|error| format!("{error:#}"));
        if printed.contains(wanted) {
            return Ok(());
        }
        anyhow::ensure!(began.elapsed() < LIMIT, "{words:?} never printed {wanted:?}:\n{printed}");
    }
}

/// Does a node publish that has not said that it ends?
fn runs(state: &Latest<NodeState>) -> bool {
    state.get().is_some_and(|state| state.sample.body.stopped.is_none())
}

#[tokio::test(flavor = "multi_thread")]
async fn device_nodes_of_an_up_that_was_killed_are_found_ordered_and_followed_by_the_next_up() -> anyhow::Result<()> {
    let harness = Harness::new(HarnessOptions::default(), long_row).await?;
    let guard: Latest<NodeState> = latest(&harness, Role::Device, "enclosure", NodeTopic::State).await?;
    let observatory: Latest<NodeState> = latest(&harness, Role::Observatory, "main", NodeTopic::State).await?;
    let mut up = harness.up()?;
    let found = async {
        harness.until("the nodes run", 90.0, |_| guard.get().is_some() && runs(&observatory)).await?;
        up.kill()?;
        up.wait()?;
        harness.until("the observatory node ends with `up`", 90.0, |_| !runs(&observatory)).await?;
        // Nobody names an address, and nothing is found by multicast.
        let status = ["status", "--no-multicast", "--seconds", "5"];
        until_printed(&harness, &status, "nodes of this telescope that answer: device/enclosure, device/main").await?;
        let address = format!("{SITE}/{TELESCOPE}");
        let close = ["order", &address, "close", "--no-multicast", "--operator", "ana", "--give-on", "0"];
        until_printed(&harness, &close, "verified closed by the guard").await
    };
    let found = found.await;
    // Whatever failed, it does not run on, and the next one ends what it left.
    let _ = up.kill();
    let _ = up.wait();
    let again = harness.up()?;
    let is_up = |harness: &Harness| {
        runs(&observatory)
            && std::fs::read_to_string(harness.path("up.log")).is_ok_and(|log| log.contains("5 of 5 nodes started"))
    };
    let runs_again = harness.until("the nodes of the next one run", 120.0, is_up).await;
    let (well, log) = stop(&harness, again).await?;
    found.map_err(|error| anyhow::anyhow!("{error:#}\n{log}"))?;
    runs_again?;
    assert!(well && log.contains("left the device node enclosure as process "), "{log}");
    assert!(log.contains(&format!("{SITE}/{TELESCOPE} works through its schedule by itself")), "{log}");
    Ok(())
}
