//! The knowledge of the sky survives the observatory node: a restarted node does not wait for inputs that are known to
//! be good, and waits for the whole remaining dwell of the others.

use std::time::{Duration, Instant};

use contract::Role;
use contract::observatory::Verdict;
use simulator::Quantity;
use test_support::{Harness, HarnessOptions, Lateness};

/// Five minutes of the sky, half a minute of the machine.
const DWELL_MIN: f64 = 5.0;
const DWELL: Duration = Duration::from_secs(30);

fn options() -> HarnessOptions {
    HarnessOptions { permit_valid_s: 15.0, weather_dwell_min: DWELL_MIN, ..HarnessOptions::default() }
}

fn verdict(harness: &Harness) -> Option<Verdict> {
    harness.safety.fresh(Duration::from_secs(3)).map(|safety| safety.sample.body.verdict)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_observatory_under_a_good_sky_closes_nothing() -> anyhow::Result<()> {
    let mut harness = Harness::new(options(), test_support::long_row).await?;
    harness.start(Role::Device)?;
    harness.start(Role::Observatory)?;
    harness.until("the dome opens on a safe sky", 120.0, Harness::is_open).await?;
    let before = harness.simulator.world().puts_since(0).last().map_or(0, |put| put.seq);
    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    let (began, lateness) = (Instant::now(), Lateness::begin());
    harness.until("the verdict is safe again", 15.0, |harness| verdict(harness) == Some(Verdict::Safe)).await?;
    assert!(began.elapsed() < lateness.bound(DWELL / 2), "{:?} without the dwell", began.elapsed());
    // A dwell later it would have closed.
    tokio::time::sleep(Duration::from_secs(16)).await;
    let puts = harness.simulator.world().puts_since(before);
    assert!(!puts.iter().any(|put| put.member == "closeshutter"), "nobody closes: {puts:?}\n{}", harness.last_words());
    assert!(harness.is_open());

    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 40.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sky_that_was_bad_within_the_dwell_keeps_a_restarted_observatory_waiting() -> anyhow::Result<()> {
    let mut harness = Harness::new(options(), test_support::long_row).await?;
    harness.start(Role::Device)?;
    harness.start(Role::Observatory)?;
    harness.until("the dome opens on a safe sky", 120.0, Harness::is_open).await?;
    harness.simulator.world().set_weather(Quantity::Humidity, Some(100.0));
    harness.until("the dome is shut", 40.0, Harness::is_shut).await?;
    harness.simulator.world().set_weather(Quantity::Humidity, None);
    let good = Instant::now();
    tokio::time::sleep(DWELL / 2).await;

    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    let (restarted, lateness) = (Instant::now(), Lateness::begin());
    harness
        .until("the verdict is safe again", 90.0, |harness| {
            assert!(verdict(harness) != Some(Verdict::Safe) || good.elapsed() >= DWELL, "{:?}", good.elapsed());
            verdict(harness) == Some(Verdict::Safe)
        })
        .await?;
    assert!(
        restarted.elapsed() < lateness.bound(DWELL),
        "{:?}: only the rest of the dwell is waited for",
        restarted.elapsed()
    );
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 40.0, Harness::is_shut).await?;
    Ok(())
}
