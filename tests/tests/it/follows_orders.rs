//! A person's order holds whatever the sky, the schedule and a restart do.

use contract::Role;
use test_support::{Rig, RigOptions, long_row};

#[tokio::test(flavor = "multi_thread")]
async fn what_is_ordered_to_stay_closed_stays_closed_until_it_is_taken_back() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome().await?;
    rig.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    rig.until("the dome is shut by the order", 30.0, Rig::is_shut).await?;
    let reason = |rig: &Rig| {
        let said = rig.safety.fresh(std::time::Duration::from_secs(5));
        said.is_some_and(|safety| {
            safety.said.body.reasons.iter().any(|reason| reason.why.contains("people on the roof"))
        })
    };
    rig.until("the verdict says who and why", 10.0, reason).await?;

    rig.kill(Role::Observatory)?;
    rig.start(Role::Observatory)?;
    rig.until("the new life knows the order", 30.0, |rig| rig.is_shut() && reason(rig)).await?;
    // The safety dwell is 3 s here: without the order the dome would open again.
    tokio::time::sleep(std::time::Duration::from_secs(8)).await;
    assert!(rig.is_shut() && reason(&rig));

    rig.order(&["open-again"]).await?;
    rig.until("the night goes on", 60.0, Rig::is_open).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn one_limit_can_be_done_without_and_no_safety_monitor() -> anyhow::Result<()> {
    let rig = Rig::at_open_dome().await?;
    let refused =
        rig.order(&["override", "safetymonitor/monitor", "--reason", "it lies"]).await.unwrap_err().to_string();
    assert!(refused.contains("weather/Humidity") && refused.contains("sun"), "{refused}");
    assert!(rig.order(&["override", "weather/Humidity"]).await.is_err(), "without a reason");

    rig.order(&["override", "weather/Humidity", "--reason", "the sensor is broken"]).await?;
    rig.simulator.world().fault(simulator::Kind::ObservingConditions, simulator::Fault::nan());
    let told = |rig: &Rig| rig.safety.get().is_some_and(|safety| !safety.said.body.advisories.is_empty());
    rig.until("the broken sensor is told", 30.0, told).await?;
    assert!(rig.is_open(), "and closes nothing");

    rig.order(&["heed", "weather/Humidity"]).await?;
    rig.until("the heeded limit closes", 30.0, Rig::is_shut).await?;
    Ok(())
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_read_only_data_folder_refuses_what_it_cannot_keep_and_closes_all_the_same() -> anyhow::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    let mut rig = Rig::new(RigOptions::default(), long_row).await?;
    rig.start(Role::Device)?;
    let data = rig.start_standby_apart()?;
    rig.until("the dome opens on a safe sky", 60.0, Rig::is_open).await?;
    let id = "override/weather/Humidity";
    rig.order(&["override", "weather/Humidity", "--reason", "the sensor is broken"]).await?;
    let write = |mode| std::fs::set_permissions(&data, std::fs::Permissions::from_mode(mode));
    write(0o555)?;
    for order in [vec!["ack", id], vec!["override", "sun", "--reason", "x"], vec!["shelve", id, "--reason", "x"]] {
        let refused = rig.order(&order).await.unwrap_err().to_string();
        assert!(refused.contains("the disk does not take it"), "{order:?}: {refused}");
    }
    rig.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    rig.until("the dome is shut by the order", 30.0, Rig::is_shut).await?;
    let refused = rig.order(&["open-again"]).await.unwrap_err().to_string();
    assert!(refused.contains("the disk does not take it"), "{refused}");
    write(0o755)?;
    rig.order(&["ack", id]).await?;
    rig.order(&["open-again"]).await?;
    rig.until("the night goes on", 60.0, Rig::is_open).await?;
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    Ok(())
}
