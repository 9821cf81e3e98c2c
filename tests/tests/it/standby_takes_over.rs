//! Two observatory nodes for one telescope: one commands, the other takes over before the permit runs out.

use std::time::Duration;

use contract::Role;
use tests::{Rig, RigOptions};

#[tokio::test(flavor = "multi_thread")]
async fn a_hot_standby_takes_over_and_the_dome_stays_open() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome_with(RigOptions { permit_valid_s: 10.0, ..RigOptions::default() }).await?;
    let guard = |rig: &Rig| rig.guard.fresh(Duration::from_secs(5)).map(|guard| guard.said.body);
    let commander =
        |rig: &Rig| guard(rig).and_then(|guard| guard.permits.first().map(|permit| permit.commander.clone()));
    rig.start_standby()?;
    // it must hear everything and fill its dwell before it can be of use
    tokio::time::sleep(Duration::from_secs(12)).await;
    assert_eq!(commander(&rig).as_deref(), Some("observatory/alpha/main"), "the first goes on commanding");
    assert!(rig.is_open());
    let token = guard(&rig).map_or(0, |guard| guard.token);

    let before = rig.simulator.world().puts_since(0).last().map_or(0, |put| put.seq);

    rig.kill(Role::Observatory)?;
    let taken = |rig: &Rig| guard(rig).is_some_and(|guard| guard.token > token);
    let took = rig.until("the standby has the next token", 12.0, taken).await?;
    rig.until("its permits reach the guard", 5.0, |rig| commander(rig).as_deref() == Some("observatory/alpha/second"))
        .await?;
    assert!(took < Duration::from_secs(9), "{took:?}: 8 s, and a noisy machine");
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert!(rig.is_open(), "the roof need not close");
    let puts = rig.simulator.world().puts_since(before);
    assert!(
        !puts.iter().any(|put| put.member == "closeshutter"),
        "and nobody asked it to: {puts:?}\n{}",
        rig.last_words()
    );

    // nothing is lost of what the first one guarded
    rig.simulator.world().set_unsafe(true);
    rig.until("the standby closes", 30.0, Rig::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_nodes_with_one_name_the_younger_leaves() -> anyhow::Result<()> {
    let rig = Rig::at_open_dome().await?;
    let token = |rig: &Rig| rig.guard.get().map_or(0, |guard| guard.said.body.token);
    let before = token(&rig);
    let twin = rig.run_to_end(Role::Observatory, "main", Duration::from_secs(20)).await?;
    assert!(twin.contains("another observatory node with id") && twin.contains("--id"), "{twin}");
    assert!(rig.is_open(), "the older one goes on");
    assert_eq!(token(&rig), before, "and commands");
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 30.0, Rig::is_shut).await?;
    Ok(())
}
