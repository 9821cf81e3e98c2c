//! A person's order holds whatever the sky, the schedule and a restart do.

use contract::Role;
use test_support::{Harness, HarnessOptions, long_row};

#[tokio::test(flavor = "multi_thread")]
async fn what_is_ordered_to_stay_closed_stays_closed_until_it_is_taken_back() -> anyhow::Result<()> {
    let mut harness = Harness::at_open_dome().await?;
    harness.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    harness.until("the dome is shut by the order", 30.0, Harness::is_shut).await?;
    let reason = |harness: &Harness| {
        let sample = harness.safety.fresh(std::time::Duration::from_secs(5));
        sample.is_some_and(|safety| {
            safety.sample.body.reasons.iter().any(|reason| reason.why.contains("people on the roof"))
        })
    };
    harness.until("the verdict says who and why", 10.0, reason).await?;

    harness.kill(Role::Observatory)?;
    harness.start(Role::Observatory)?;
    harness.until("the new incarnation knows the order", 30.0, |harness| harness.is_shut() && reason(harness)).await?;
    // The safety dwell is 3 s here: without the order the dome would open again.
    tokio::time::sleep(std::time::Duration::from_secs(8)).await;
    assert!(harness.is_shut() && reason(&harness));

    harness.order(&["open-again"]).await?;
    harness.until("the night goes on", 60.0, Harness::is_open).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn one_limit_can_be_done_without_and_no_safety_monitor() -> anyhow::Result<()> {
    let harness = Harness::at_open_dome().await?;
    let refused =
        harness.order(&["override", "safetymonitor/monitor", "--reason", "it lies"]).await.unwrap_err().to_string();
    assert!(refused.contains("weather/Humidity") && refused.contains("sun"), "{refused}");
    assert!(harness.order(&["override", "weather/Humidity"]).await.is_err(), "without a reason");

    harness.order(&["override", "weather/Humidity", "--reason", "the sensor is broken"]).await?;
    harness.simulator.world().fault(simulator::Kind::ObservingConditions, simulator::Fault::nan());
    let advises =
        |harness: &Harness| harness.safety.get().is_some_and(|safety| !safety.sample.body.advisories.is_empty());
    harness.until("the broken sensor is reported", 30.0, advises).await?;
    assert!(harness.is_open(), "and closes nothing");

    harness.order(&["restore", "weather/Humidity"]).await?;
    harness.until("the restored limit closes", 30.0, Harness::is_shut).await?;
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_read_only_data_folder_refuses_what_it_cannot_keep_and_closes_all_the_same() -> anyhow::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    let mut harness = Harness::new(HarnessOptions::default(), long_row).await?;
    harness.start(Role::Device)?;
    let data = harness.start_standby_apart()?;
    harness.until("the dome opens on a safe sky", 60.0, Harness::is_open).await?;
    let id = "override/weather/Humidity";
    harness.order(&["override", "weather/Humidity", "--reason", "the sensor is broken"]).await?;
    let write = |mode| std::fs::set_permissions(&data, std::fs::Permissions::from_mode(mode));
    write(0o555)?;
    for order in [vec!["ack", id], vec!["override", "sun", "--reason", "x"], vec!["shelve", id, "--reason", "x"]] {
        let refused = harness.order(&order).await.unwrap_err().to_string();
        assert!(refused.contains("the disk does not take it"), "{order:?}: {refused}");
    }
    harness.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    harness.until("the dome is shut by the order", 30.0, Harness::is_shut).await?;
    let refused = harness.order(&["open-again"]).await.unwrap_err().to_string();
    assert!(refused.contains("the disk does not take it"), "{refused}");
    write(0o755)?;
    harness.order(&["ack", id]).await?;
    harness.order(&["open-again"]).await?;
    harness.until("the night goes on", 60.0, Harness::is_open).await?;
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}
