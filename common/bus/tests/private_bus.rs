//! Two real sessions on a private loopback bus: what the rest of the house relies on.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends at the first surprise")]

use std::time::{Duration, Instant};

use bus::{AskError, Bus, Catch, Clock, Quality};
use contract::observatory::{Permit, Verdict};
use contract::{
    Accepted, Address, BootId, Command, CommandId, Key, Kind, Order, OrderKind, Reason, Refusal, Reply, device::dome,
};

/// What takes longer hangs, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

async fn open(connect: Vec<String>) -> Bus {
    let config = config::Bus { listen: Vec::new(), connect, multicast: false };
    Bus::open(&config, Clock::machine_clock()).await.unwrap()
}

/// Two sessions that know each other.
async fn pair() -> (Bus, Bus) {
    let first = open(Vec::new()).await;
    let second = open(first.locators().await).await;
    for one in [&first, &second] {
        until_it_meets(1, one).await;
    }
    (first, second)
}

async fn until_it_meets(peers: usize, bus: &Bus) {
    let began = Instant::now();
    while bus.peers().await < peers {
        let met = bus.peers().await;
        assert!(began.elapsed() < LIMIT, "{met} of {peers} sessions on one loopback were met within {LIMIT:?}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn address() -> Address {
    Address::new("test", "alpha").unwrap()
}

fn permit(number: u64) -> Permit {
    let guard_boot_id = BootId::fresh();
    Permit { verdict: Verdict::Safe, commander: "o".to_owned(), token: 1, guard_number: number, guard_boot_id }
}

fn order(id: &str) -> Order {
    Order {
        id: CommandId(id.to_owned()),
        from: "test".to_owned(),
        reason: String::new(),
        kind: OrderKind::Close,
        seen: None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_receives_the_newest_state_at_once() {
    let (first, second) = pair().await;
    let key = Key::Permit(address(), "dome".parse().unwrap());
    let publisher = first.publisher_as::<Permit>(&key, Quality::State { cache: 1 }).await.unwrap();
    publisher.put(permit(1)).await.unwrap();
    publisher.put(permit(2)).await.unwrap();
    let mut latest = second.latest::<Permit>(&key).await.unwrap();
    // While two sessions still exchange their subscriptions, zenoh sends everything: the first may come late, never
    // last.
    let newest = async {
        while latest.get().is_none_or(|received| received.sample.seq < 1) {
            latest.changed().await;
        }
    };
    tokio::time::timeout(LIMIT, newest).await.unwrap();
    assert_eq!(latest.get().unwrap().sample.body.guard_number, 2);
    assert!(latest.fresh(LIMIT).is_some());
    let got = second.get_all::<Permit>(&key.to_string(), LIMIT).await;
    assert_eq!(got.len(), 1, "a plain get is answered too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_subscriber_that_wants_all_receives_what_was_published_before() {
    let (first, second) = pair().await;
    let key = Key::Permit(address(), "dome".parse().unwrap());
    let publisher = first.publisher_as::<Permit>(&key, Quality::Event { cache: 100 }).await.unwrap();
    for number in 0..10 {
        publisher.put(permit(number)).await.unwrap();
    }
    let all = second.subscribe::<Permit>(&key.to_string(), Catch::All, 100).await.unwrap();
    // While two sessions still exchange their declarations, zenoh sends everything: a late one may come first.
    let mut received = Vec::new();
    while received.len() < 10 {
        let next = tokio::time::timeout(LIMIT, all.recv()).await.unwrap();
        received.push(next.sample.body.guard_number);
    }
    received.sort_unstable();
    assert!(received.iter().copied().eq(0..10), "{received:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_joins_while_much_is_published_receives_each_once() {
    for round in 0..3 {
        let first = open(Vec::new()).await;
        let key = Key::Permit(address(), "dome".parse().unwrap());
        let publisher = first.publisher_as::<Permit>(&key, Quality::State { cache: 5000 }).await.unwrap();
        let saying = tokio::spawn(async move {
            for number in 0..600 {
                publisher.put(permit(number)).await.unwrap();
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
            publisher
        });
        tokio::time::sleep(Duration::from_millis(300)).await;
        // The first new payloads come before the answer about those of before.
        let second = open(first.locators().await).await;
        let all = second.subscribe::<Permit>(&key.to_string(), Catch::All, 5000).await.unwrap();
        let mut received = Vec::new();
        while received.len() < 600 {
            let next = tokio::time::timeout(LIMIT, all.recv()).await;
            let missing = || (0..600).filter(|number| !received.contains(number)).collect::<Vec<u64>>();
            received.push(next.unwrap_or_else(|_| panic!("round {round}: {:?}", missing())).sample.body.guard_number);
        }
        let _publisher = saying.await.unwrap();
        received.sort_unstable();
        assert!(received.iter().copied().eq(0..600), "round {round}: some were received twice");
        assert_eq!(all.missing(), 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_subscriber_loses_the_oldest_and_stalls_nobody() {
    let (first, second) = pair().await;
    let key = Key::Permit(address(), "dome".parse().unwrap());
    let slow = second.subscribe::<Permit>(&key.to_string(), Catch::Newest, 4).await.unwrap();
    let quick = second.subscribe::<Permit>(&key.to_string(), Catch::Newest, 1000).await.unwrap();
    let publisher = first.publisher_as::<Permit>(&key, Quality::Urgent).await.unwrap();
    // The first samples may be published before the subscriptions are known.
    let (mut newest, mut received) = (0, 0);
    let filling = async {
        while received < 30 {
            newest += 1;
            publisher.put(permit(newest)).await.unwrap();
            received += u64::from(tokio::time::timeout(Duration::from_millis(2), quick.recv()).await.is_ok());
        }
        // Both receive the same samples, one callback after the other: who has the next one, has left this one behind for both.
        publisher.put(permit(newest + 1)).await.unwrap();
        let mut last = 0;
        while last < newest + 1 {
            last = quick.recv().await.sample.body.guard_number;
            received += 1;
        }
        while slow.lost() + 4 < received {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    tokio::time::timeout(LIMIT, filling).await.unwrap();
    let oldest = slow.recv().await.sample.body.guard_number;
    assert!(oldest == newest - 3 || oldest == newest - 2, "only the newest four of {newest} are left: {oldest}");
    assert!(slow.lost() + 5 >= received, "{} of {received}", slow.lost());
}

/// Commands are answered by the program that publishes the state.
async fn writer(bus: &Bus, key: &Key) -> bus::Publisher<Permit> {
    let publisher = bus.publisher_as(key, Quality::State { cache: 1 }).await.unwrap();
    publisher.put(permit(0)).await.unwrap();
    publisher
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_is_accepted_or_refused_at_once() {
    let (first, second) = pair().await;
    let device = address().device(Kind::Dome, &"dome".parse().unwrap());
    let answer = |command: Result<Command<dome::Command>, String>| async move {
        match command {
            Ok(command) if command.action == dome::Command::CloseShutter => {
                Reply::Accepted(Accepted { id: command.id, token: None, not_written: None })
            }
            Ok(command) => {
                Reply::Refusal(Refusal { id: command.id, reason: Reason::NoPermit, detail: "no permit".to_owned() })
            }
            Err(detail) => Reply::Refusal(Refusal { id: CommandId(String::new()), reason: Reason::Malformed, detail }),
        }
    };
    let _state = writer(&first, &Key::State(device.clone())).await;
    let _service = first.serve(&Key::Command(device.clone()), answer).await.unwrap();
    let ask = |action| Command { id: CommandId::fresh(), from: "test".to_owned(), token: None, boot_id: None, action };
    let timeout = LIMIT;
    let close = ask(dome::Command::CloseShutter);
    // A service is not known everywhere at once; until then the outcome is unknown, and asking again is harmless.
    let began = Instant::now();
    let until_known = async |action: &Command<dome::Command>| loop {
        let answered = second.command(&device, action, timeout).await;
        if !matches!(answered, Err(AskError::Unknown { .. })) || began.elapsed() > LIMIT {
            break answered;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(until_known(&close).await.unwrap().id, close.id);
    let open = ask(dome::Command::OpenShutter);
    let refused = until_known(&open).await.unwrap_err();
    assert!(
        matches!(refused, AskError::Refused { refusal: Refusal { reason: Reason::NoPermit, .. }, .. }),
        "{refused}"
    );
    let malformed: Reply =
        second.ask(&Key::Command(device.clone()), &serde_json::json!({"id": 1}), timeout).await.unwrap();
    assert!(matches!(malformed, Reply::Refusal(Refusal { reason: Reason::Malformed, .. })), "{malformed:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_question_that_nobody_receives_is_unknown_not_refused() {
    let (_first, second) = pair().await;
    let error = second.ask::<_, Reply>(&Key::Order(address()), &order("1"), Duration::from_secs(2)).await.unwrap_err();
    assert!(matches!(error, AskError::Unknown { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handler_that_never_answers_is_given_up() {
    ask_one_that_never_answers().await;
}

/// How long the question took.
async fn ask_one_that_never_answers() -> Duration {
    let (first, second) = pair().await;
    let key = Key::Order(address());
    let _service = first.serve(&key, |_: Result<Order, String>| std::future::pending::<Reply>()).await.unwrap();
    let (question, asked) = (order("1"), Instant::now());
    let asking = second.ask::<_, Reply>(&key, &question, Duration::from_millis(500));
    let error = tokio::time::timeout(LIMIT, asking).await.unwrap().unwrap_err();
    assert!(matches!(error, AskError::Unknown { .. }), "{error}");
    asked.elapsed()
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_handler_that_is_too_slow_is_unknown_in_time() {
        let took = ask_one_that_never_answers().await;
        assert!(took < Duration::from_secs(10), "{took:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_visits_two_networks_meets_all_of_both_and_joins_them_not() {
    let ((first, second), (third, fourth)) = (pair().await, pair().await);
    let connect = [first.locators().await, third.locators().await].concat();
    let config = config::Bus { listen: Vec::new(), connect, multicast: false };
    let visitor = Bus::visit(&config, Clock::machine_clock()).await.unwrap();
    // Also those that it has no address of.
    until_it_meets(4, &visitor).await;
    for one in [&first, &second, &third, &fourth] {
        until_it_meets(2, one).await;
    }
    // Who was introduced to somebody meets him at once; on a slow machine this shows less.
    tokio::time::sleep(Duration::from_secs(2)).await;
    for one in [&first, &second, &third, &fourth] {
        assert_eq!(one.peers().await, 2, "its neighbour and the visitor");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_several_takes_the_address_of_one_that_has_ended_and_a_newcomer_meets_all_of_them_there() {
    let holder = open(Vec::new()).await;
    let address = holder.locators().await;
    let config = config::Bus { listen: address.clone(), connect: Vec::new(), multicast: false };
    let first = Bus::open(&config, Clock::machine_clock()).await.unwrap();
    let second = Bus::open(&config, Clock::machine_clock()).await.unwrap();
    for one in [&first, &second] {
        until_it_meets(2, one).await;
    }
    holder.close().await;
    let config = config::Bus { listen: Vec::new(), connect: address, multicast: false };
    let newcomer = Bus::visit(&config, Clock::machine_clock()).await.unwrap();
    until_it_meets(2, &newcomer).await;
}
