//! Two observatory nodes for one telescope: one commands, the other takes over before the permit runs out.

use std::time::{Duration, Instant};

use bus::Catch;
use contract::device::dome;
use contract::node::NodeState;
use contract::observatory::{Permit, StandingOrders};
use contract::{Address, BootId, Command, CommandId, Key, Kind, NodeTopic, Part, Role};
use test_support::{Lateness, Rig, RigOptions, SITE, TELESCOPE, long_row};

#[tokio::test(flavor = "multi_thread")]
async fn a_hot_standby_takes_over_and_the_dome_stays_open() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome_with(RigOptions { permit_valid_s: 10.0, ..RigOptions::default() }).await?;
    let guard = |rig: &Rig| rig.guard.fresh(Duration::from_secs(5)).map(|guard| guard.said.body);
    let commander =
        |rig: &Rig| guard(rig).and_then(|guard| guard.permits.first().map(|permit| permit.commander.clone()));
    rig.start_standby()?;
    // It must receive every input and fill its dwell before it can take over.
    tokio::time::sleep(Duration::from_secs(20)).await;
    assert_eq!(commander(&rig).as_deref(), Some("observatory/alpha/main"), "the first goes on commanding");
    assert!(rig.is_open());
    let token = guard(&rig).map_or(0, |guard| guard.token);

    let before = rig.simulator.world().puts_since(0).last().map_or(0, |put| put.seq);

    rig.kill(Role::Observatory)?;
    let taken = |rig: &Rig| guard(rig).is_some_and(|guard| guard.token > token);
    let lateness = Lateness::begin();
    let took = rig.until("the standby has the next token", 12.0, taken).await?;
    rig.until("its permits reach the guard", 5.0, |rig| commander(rig).as_deref() == Some("observatory/alpha/second"))
        .await?;
    assert!(took < lateness.bound(Duration::from_millis(8500)), "{took:?}: 8 s, and a look of the test");
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert!(rig.is_open(), "the roof need not close");
    let puts = rig.simulator.world().puts_since(before);
    assert!(
        !puts.iter().any(|put| put.member == "closeshutter"),
        "and nobody asked it to: {puts:?}\n{}",
        rig.last_words()
    );

    // The second node reacts to everything that the first one reacted to.
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

/// Both have one name, and neither receives the other's lease before it claims its own: the first is stopped as it
/// starts.
#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn of_two_processes_with_one_name_one_has_the_lease_at_a_time() -> anyhow::Result<()> {
    let mut rig = Rig::new(RigOptions { permit_valid_s: 10.0, ..RigOptions::default() }, long_row).await?;
    let address = Address::new(SITE, TELESCOPE)?;
    let permits = Key::Permit(address.clone(), "dome".parse()?).to_string();
    let permits = rig.bus.subscribe::<Permit>(&permits, Catch::Newest, 1000).await?;
    let state = Key::Node(address, Role::Observatory, "main".parse()?, NodeTopic::State);
    let state = rig.bus.latest::<NodeState>(&state).await?;
    rig.start(Role::Device)?;
    rig.until("the guard speaks", 30.0, |rig| rig.guard.get().is_some()).await?;
    rig.start(Role::Observatory)?;
    rig.until("the first has a session", 30.0, |_| state.get().is_some()).await?;
    rig.stop_in_its_tracks(Role::Observatory)?;
    let first = state.get().map(|said| said.said.boot_id);
    rig.start_twin()?;
    let heard = tokio::time::timeout(Duration::from_secs(40), permits.hear()).await?;
    assert_ne!(Some(&heard.said.boot_id), first.as_ref(), "the first has not claimed yet");

    rig.go_on(Role::Observatory)?;
    let (mut last, mut changes): ((BootId, u64, Instant), _) =
        ((heard.said.boot_id, heard.said.body.token, Instant::now()), 0);
    let until = Instant::now() + Duration::from_secs(14);
    while let Ok(heard) = tokio::time::timeout_at(until.into(), permits.hear()).await {
        let (life, token) = (heard.said.boot_id, heard.said.body.token);
        if life != last.0 {
            changes += 1;
            let silence = last.2.elapsed();
            assert!(silence > Duration::from_millis(4500), "{life} commands {silence:?} after {} spoke", last.0);
            assert!(token > last.1, "with a token of its own");
        } else {
            assert!(token >= last.1, "no token goes back");
        }
        last = (life, token, Instant::now());
    }
    assert!(changes <= 1, "the lease changed hands {changes} times");
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 60.0, Rig::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_with_its_own_disk_keeps_closed_what_was_ordered_to_stay_closed() -> anyhow::Result<()> {
    let mut rig = Rig::at_open_dome_with(RigOptions { permit_valid_s: 10.0, ..RigOptions::default() }).await?;
    let data = rig.start_standby_apart()?;
    let key = Key::Observatory(Address::new(SITE, TELESCOPE)?, Part::Standing);
    let standing = rig.bus.latest::<StandingOrders>(&key).await?;
    tokio::time::sleep(Duration::from_secs(8)).await;
    rig.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    rig.until("the dome is shut by the order", 30.0, Rig::is_shut).await?;
    let token = standing.get().and_then(|said| said.said.body.token);

    rig.kill(Role::Observatory)?;
    let taken = |_: &Rig| standing.get().is_some_and(|said| said.said.body.token > token);
    rig.until("the standby commands", 30.0, taken).await?;
    let written = std::fs::read_to_string(data.join(format!("standing-{TELESCOPE}.json")))?;
    assert!(written.contains("people on the roof"), "{written}");
    // The safety dwell is 3 s here: without the order the dome would open.
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert!(rig.is_shut(), "{}", rig.last_words());
    rig.order(&["open-again"]).await?;
    rig.until("the night goes on", 60.0, Rig::is_open).await?;
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 60.0, Rig::is_shut).await?;
    Ok(())
}

/// Killed between the grant of its first token and the record of it on its disk: the arbiter and the disk are in that
/// state.
#[tokio::test(flavor = "multi_thread")]
async fn a_life_that_was_ended_as_it_was_granted_the_lease_costs_no_night() -> anyhow::Result<()> {
    let mut rig = Rig::new(RigOptions { permit_valid_s: 10.0, ..RigOptions::default() }, long_row).await?;
    rig.start(Role::Device)?;
    rig.until("the guard speaks", 30.0, |rig| rig.guard.get().is_some()).await?;
    let dome = Address::new(SITE, TELESCOPE)?.device(Kind::Dome, &"dome".parse()?);
    let (from, boot_id) = ("observatory/alpha/main".to_owned(), Some(BootId::fresh()));
    let claim = Command { id: CommandId::fresh(), from, token: None, boot_id, action: dome::Command::Claim };
    let granted = rig.bus.command(&dome, &claim, Duration::from_secs(5)).await?;
    assert_eq!(granted.token, Some(1));
    let note = rig.path("data").join(format!("claim-{TELESCOPE}-main.json"));
    std::fs::write(&note, serde_json::json!({ "claim": claim.id }).to_string())?;

    rig.start(Role::Observatory)?;
    rig.until("the dome opens: nobody can have been ordered anything", 60.0, Rig::is_open).await?;
    assert!(rig.guard.get().is_some_and(|guard| guard.said.body.token == 2));
    assert!(!note.exists(), "who commands has taken its note back");
    rig.simulator.world().set_unsafe(true);
    rig.until("the dome ends shut", 60.0, Rig::is_shut).await?;
    Ok(())
}
