//! Two observatory nodes for one telescope: one commands, the other takes over before the permit runs out.

use std::time::{Duration, Instant};

use bus::Catch;
use contract::device::dome;
use contract::node::NodeState;
use contract::observatory::{OperatorOrders, Permit};
use contract::{Address, BootId, Command, CommandId, Key, Kind, NodeTopic, Part, Role};
use test_support::{Harness, HarnessOptions, Lateness, SITE, TELESCOPE, long_row};

#[tokio::test(flavor = "multi_thread")]
async fn a_hot_standby_takes_over_and_the_dome_stays_open() -> anyhow::Result<()> {
    let mut harness =
        Harness::at_open_dome_with(HarnessOptions { permit_valid_s: 10.0, ..HarnessOptions::default() }).await?;
    let guard = |harness: &Harness| harness.guard.fresh(Duration::from_secs(5)).map(|guard| guard.sample.body);
    let commander = |harness: &Harness| {
        guard(harness).and_then(|guard| guard.permits.first().map(|permit| permit.commander.clone()))
    };
    harness.start_standby()?;
    // It must receive every input and fill its dwell before it can take over.
    tokio::time::sleep(Duration::from_secs(20)).await;
    assert_eq!(commander(&harness).as_deref(), Some("observatory/alpha/main"), "the first goes on commanding");
    assert!(harness.is_open());
    let token = guard(&harness).map_or(0, |guard| guard.token);

    let before = harness.simulator.world().puts_since(0).last().map_or(0, |put| put.seq);

    harness.kill(Role::Observatory)?;
    let taken = |harness: &Harness| guard(harness).is_some_and(|guard| guard.token > token);
    let lateness = Lateness::begin();
    let took = harness.until("the standby has the next token", 12.0, taken).await?;
    harness
        .until("its permits reach the guard", 5.0, |harness| {
            commander(harness).as_deref() == Some("observatory/alpha/second")
        })
        .await?;
    assert!(took < lateness.bound(Duration::from_millis(8500)), "{took:?}: 8 s, and a look of the test");
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert!(harness.is_open(), "the roof need not close");
    let puts = harness.simulator.world().puts_since(before);
    assert!(
        !puts.iter().any(|put| put.member == "closeshutter"),
        "and nobody asked it to: {puts:?}\n{}",
        harness.last_words()
    );

    // The second node reacts to everything that the first one reacted to.
    harness.simulator.world().set_unsafe(true);
    harness.until("the standby closes", 30.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_nodes_with_one_name_the_younger_leaves() -> anyhow::Result<()> {
    let harness = Harness::at_open_dome().await?;
    let token = |harness: &Harness| harness.guard.get().map_or(0, |guard| guard.sample.body.token);
    let before = token(&harness);
    let twin = harness.run_to_end(Role::Observatory, "main", Duration::from_secs(20)).await?;
    assert!(twin.contains("another observatory node with id") && twin.contains("--id"), "{twin}");
    assert!(harness.is_open(), "the older one goes on");
    assert_eq!(token(&harness), before, "and commands");
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}

/// Both have one name, and neither receives the other's lease before it claims its own: the first is stopped as it
/// starts.
#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn of_two_processes_with_one_name_one_has_the_lease_at_a_time() -> anyhow::Result<()> {
    let mut harness =
        Harness::new(HarnessOptions { permit_valid_s: 10.0, ..HarnessOptions::default() }, long_row).await?;
    let address = Address::new(SITE, TELESCOPE)?;
    let permits = Key::Permit(address.clone(), "dome".parse()?).to_string();
    let permits = harness.bus.subscribe::<Permit>(&permits, Catch::Newest, 1000).await?;
    let state = Key::Node(address, Role::Observatory, "main".parse()?, NodeTopic::State);
    let state = harness.bus.latest::<NodeState>(&state).await?;
    harness.start(Role::Device)?;
    harness.until("the guard speaks", 30.0, |harness| harness.guard.get().is_some()).await?;
    harness.start(Role::Observatory)?;
    harness.until("the first has a session", 30.0, |_| state.get().is_some()).await?;
    harness.stop_in_its_tracks(Role::Observatory)?;
    let first = state.get().map(|received| received.sample.boot_id);
    harness.start_twin()?;
    let received = tokio::time::timeout(Duration::from_secs(40), permits.recv()).await?;
    assert_ne!(Some(&received.sample.boot_id), first.as_ref(), "the first has not claimed yet");

    harness.go_on(Role::Observatory)?;
    let (mut last, mut changes): ((BootId, u64, Instant), _) =
        ((received.sample.boot_id, received.sample.body.token, Instant::now()), 0);
    let until = Instant::now() + Duration::from_secs(14);
    while let Ok(received) = tokio::time::timeout_at(until.into(), permits.recv()).await {
        let (boot_id, token) = (received.sample.boot_id, received.sample.body.token);
        if boot_id != last.0 {
            changes += 1;
            let silence = last.2.elapsed();
            assert!(silence > Duration::from_millis(4500), "{boot_id} commands {silence:?} after {} spoke", last.0);
            assert!(token > last.1, "with a token of its own");
        } else {
            assert!(token >= last.1, "no token goes back");
        }
        last = (boot_id, token, Instant::now());
    }
    assert!(changes <= 1, "the lease changed hands {changes} times");
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_with_its_own_disk_keeps_closed_what_was_ordered_to_stay_closed() -> anyhow::Result<()> {
    let mut harness =
        Harness::at_open_dome_with(HarnessOptions { permit_valid_s: 10.0, ..HarnessOptions::default() }).await?;
    let data = harness.start_standby_apart()?;
    let key = Key::Observatory(Address::new(SITE, TELESCOPE)?, Part::OperatorOrders);
    let orders = harness.bus.latest::<OperatorOrders>(&key).await?;
    tokio::time::sleep(Duration::from_secs(8)).await;
    harness.order(&["stay-closed", "--reason", "people on the roof"]).await?;
    harness.until("the dome is shut by the order", 30.0, Harness::is_shut).await?;
    let token = orders.get().and_then(|received| received.sample.body.token);

    harness.kill(Role::Observatory)?;
    let taken = |_: &Harness| orders.get().is_some_and(|received| received.sample.body.token > token);
    harness.until("the standby commands", 30.0, taken).await?;
    let written = std::fs::read_to_string(data.join(format!("operator-orders-{TELESCOPE}.json")))?;
    assert!(written.contains("people on the roof"), "{written}");
    // The safety dwell is 3 s here: without the order the dome would open.
    tokio::time::sleep(Duration::from_secs(8)).await;
    assert!(harness.is_shut(), "{}", harness.last_words());
    harness.order(&["open-again"]).await?;
    harness.until("the night goes on", 60.0, Harness::is_open).await?;
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}

/// Killed between the grant of its first token and the record of it on its disk: the arbiter and the disk are in that
/// state.
#[tokio::test(flavor = "multi_thread")]
async fn a_process_that_was_ended_as_it_was_granted_the_lease_costs_no_night() -> anyhow::Result<()> {
    let mut harness =
        Harness::new(HarnessOptions { permit_valid_s: 10.0, ..HarnessOptions::default() }, long_row).await?;
    harness.start(Role::Device)?;
    harness.until("the guard speaks", 30.0, |harness| harness.guard.get().is_some()).await?;
    let dome = Address::new(SITE, TELESCOPE)?.device(Kind::Dome, &"dome".parse()?);
    let (from, boot_id) = ("observatory/alpha/main".to_owned(), Some(BootId::fresh()));
    let claim = Command { id: CommandId::fresh(), from, token: None, boot_id, action: dome::Command::Claim };
    let granted = harness.bus.command(&dome, &claim, Duration::from_secs(5)).await?;
    assert_eq!(granted.token, Some(1));
    let note = harness.path("data").join(format!("claim-{TELESCOPE}-main.json"));
    std::fs::write(&note, serde_json::json!({ "claim": claim.id }).to_string())?;

    harness.start(Role::Observatory)?;
    harness.until("the dome opens: nobody can have been ordered anything", 60.0, Harness::is_open).await?;
    assert!(harness.guard.get().is_some_and(|guard| guard.sample.body.token == 2));
    assert!(!note.exists(), "who commands has taken its note back");
    harness.simulator.world().set_unsafe(true);
    harness.until("the dome ends shut", 60.0, Harness::is_shut).await?;
    Ok(())
}
