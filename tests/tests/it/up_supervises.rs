//! `starmesh up` runs all four nodes, and on Ctrl-C leaves a closed dome and no process behind.
#![cfg(unix)]

use std::process::Command;
use std::time::{Duration, Instant};

use test_support::{Harness, HarnessOptions, long_row};

#[tokio::test(flavor = "multi_thread")]
async fn up_runs_a_telescope_and_closes_it_when_it_is_stopped() -> anyhow::Result<()> {
    let harness = Harness::new(HarnessOptions::default(), long_row).await?;
    let mut up = harness.up()?;
    let opened = harness.until("the dome opens under `starmesh up`", 90.0, Harness::is_open).await;

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
    opened.map_err(|error| anyhow::anyhow!("{error}\n{log}"))?;
    assert!(status.success());
    assert!(ended.is_some_and(|status| status.success()), "{ended:?}\n{log}");
    assert_eq!(harness.simulator.world().dome_open(), 0.0, "the guard closed before the device node ended\n{log}");
    assert!(!log.contains("next start"), "no node ended by itself\n{log}");
    Ok(())
}
