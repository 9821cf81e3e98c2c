//! The effect of other programs on the bus on a node that asks, answers and listens: zenoh sessions with no code of
//! ours.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test ends at the first surprise")]

use std::collections::HashSet;
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bus::{AskError, Bus, Catch, Clock, Publisher, Service};
use contract::observatory::{NightState, Permit, Posture, Verdict};
use contract::{Accepted, Address, BootId, CommandId, Key, Order, OrderKind, Part, Reason, Refusal, Reply};
use serde_json::{Value, json};

/// What takes longer hangs, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);
/// Between two tries.
const PAUSE: Duration = Duration::from_millis(100);

async fn open(connect: Vec<String>) -> Bus {
    let config = config::Bus { listen: Vec::new(), connect, multicast: false };
    Bus::open(&config, Clock::machine_clock()).await.unwrap()
}

/// A program that is none of ours.
async fn stranger(connect: &[String]) -> zenoh::Session {
    let settings = json!({
        "mode": "peer", "connect": { "endpoints": connect }, "listen": { "endpoints": ["tcp/127.0.0.1:0"] },
        "scouting": { "multicast": { "enabled": false } },
    });
    zenoh::open(zenoh::Config::from_json5(&settings.to_string()).unwrap()).await.unwrap()
}

fn address() -> Address {
    Address::new("test", "alpha").unwrap()
}

fn order() -> Order {
    Order { id: CommandId::fresh(), from: "test".to_owned(), reason: String::new(), kind: OrderKind::Close, seen: None }
}

fn night() -> NightState {
    serde_json::from_value(json!({
        "robotic": false, "posture": Posture::Closed, "actions": [], "frames": 0, "open_s": 0.0, "speed": 1.0,
        "simulated": false, "ended": false,
    }))
    .unwrap()
}

/// An observatory node as the bus sees it: its night, and orders that it takes and counts.
struct Observatory {
    taken: Arc<Mutex<Vec<CommandId>>>,
    _night: Publisher<NightState>,
    _orders: Service,
}

impl Observatory {
    async fn start(bus: &Bus) -> Self {
        let publisher = bus.publisher(&Key::Observatory(address(), Part::Night)).await.unwrap();
        publisher.put(night()).await.unwrap();
        let taken: Arc<Mutex<Vec<CommandId>>> = Arc::default();
        let count = taken.clone();
        let key = Key::Order(address());
        let orders = bus.serve(&key, move |order: Result<Order, String>| {
            let count = count.clone();
            async move {
                let id = order.as_ref().map_or_else(|_| CommandId(String::new()), |order| order.id.clone());
                count.lock().unwrap().push(id);
                match order {
                    Ok(order) => Reply::Accepted(Accepted { id: order.id, token: None, not_written: None }),
                    Err(detail) => {
                        let id = CommandId(String::new());
                        Reply::Refusal(Refusal { id, reason: Reason::Malformed, detail })
                    }
                }
            }
        });
        Self { taken, _night: publisher, _orders: orders.await.unwrap() }
    }

    fn taken(&self) -> usize {
        self.taken.lock().unwrap().len()
    }

    fn has_taken(&self, order: &CommandId) -> bool {
        self.taken.lock().unwrap().contains(order)
    }
}

/// Answers every query of an expression with "accepted", as a queryable that calls itself complete.
async fn swallow(session: &zenoh::Session, expression: &str) -> zenoh::query::Queryable<()> {
    let runtime = tokio::runtime::Handle::current();
    let answer = move |query: zenoh::query::Query| {
        let asked: Value =
            query.payload().and_then(|bytes| serde_json::from_slice(&bytes.to_bytes()).ok()).unwrap_or_default();
        let reply = json!({"answer": "accepted", "id": asked["id"]}).to_string();
        let key = query.key_expr().clone().into_owned();
        runtime.spawn(async move { query.reply(key, reply).await });
    };
    session.declare_queryable(expression.to_owned()).complete(true).callback(answer).await.unwrap()
}

async fn ask(bus: &Bus, order: &Order) -> Result<Reply, AskError> {
    bus.ask::<_, Reply>(&Key::Order(address()), order, LIMIT).await
}

/// Asks until the parties know each other, and one answers in time for its answer to count.
async fn ask_until_taken(bus: &Bus) -> (Order, Reply) {
    let (began, mut last) = (Instant::now(), String::new());
    while began.elapsed() < LIMIT {
        let order = order();
        match ask(bus, &order).await {
            Ok(reply) => return (order, reply),
            Err(error) => last = error.to_string(),
        }
        tokio::time::sleep(PAUSE).await;
    }
    panic!("no order was taken within {LIMIT:?}: {last}");
}

/// Waits until this program knows so many others.
async fn has_met(stranger: &zenoh::Session, others: usize) {
    let began = Instant::now();
    while stranger.info().peers_zid().await.count() < others {
        assert!(began.elapsed() < LIMIT, "{others} programs were not met");
        tokio::time::sleep(PAUSE).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_stranger_that_calls_itself_complete_takes_no_order_away() {
    let own = open(Vec::new()).await;
    let observatory = Observatory::start(&own).await;
    let asker = open(own.locators().await).await;
    ask_until_taken(&asker).await;
    let stranger = stranger(&[own.locators().await, asker.locators().await].concat()).await;
    let _swallowing = swallow(&stranger, "starmesh/**/order").await;
    has_met(&stranger, 2).await;
    // The others learn of its claim.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let fresh = open(
        [own.locators().await, stranger.info().locators().await.iter().map(ToString::to_string).collect()].concat(),
    )
    .await;
    ask_until_taken(&fresh).await;
    for bus in [&asker, &fresh] {
        for _ in 0..10 {
            let (order, reply) = ask_until_taken(bus).await;
            match reply {
                Reply::Accepted(accepted) => assert_eq!(accepted.id, order.id),
                Reply::Refusal(refusal) => panic!("{refusal}"),
            }
            assert!(observatory.has_taken(&order.id), "accepted by somebody else");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_only_a_stranger_answers_is_unknown() {
    let asker = open(Vec::new()).await;
    let stranger = stranger(&asker.locators().await).await;
    let _swallowing = swallow(&stranger, "starmesh/**/order").await;
    has_met(&stranger, 1).await;
    // The asker learns of its claim.
    tokio::time::sleep(Duration::from_secs(1)).await;
    for _ in 0..3 {
        let error = ask(&asker, &order()).await.unwrap_err();
        assert!(matches!(error, AskError::Unknown { .. }), "{error}");
    }
    // It also claims the state of the telescope: then it is the only one that there is, and still no order was taken.
    let own = open(asker.locators().await).await;
    let observatory = Observatory::start(&own).await;
    ask_until_taken(&asker).await;
    let _claiming = swallow(&stranger, "starmesh/**/night/state").await;
    let liar = stranger
        .declare_queryable("starmesh/v1/test/alpha/observatory/order")
        .complete(true)
        .callback({
            let runtime = tokio::runtime::Handle::current();
            move |query| {
                let key = query.key_expr().clone().into_owned();
                runtime.spawn(async move { query.reply(key, json!({"answer": "refusal"}).to_string()).await });
            }
        })
        .await
        .unwrap();
    let fresh = open([own.locators().await, asker.locators().await].concat()).await;
    ask_until_contested(&fresh).await;
    assert!(observatory.taken() > 0, "the node has it all the same");
    drop(liar);
}

async fn ask_until_contested(bus: &Bus) {
    let (began, mut last) = (Instant::now(), String::new());
    while began.elapsed() < LIMIT {
        match ask(bus, &order()).await {
            Err(AskError::Contested { count: 2.., .. }) => return,
            other => last = format!("{other:?}"),
        }
        tokio::time::sleep(PAUSE).await;
    }
    panic!("two programs claim one telescope, and no alert reports it; the last answer: {last}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_look_at_everything_is_no_order_and_no_question() {
    let own = open(Vec::new()).await;
    let observatory = Observatory::start(&own).await;
    let reader = open(own.locators().await).await;
    ask_until_taken(&reader).await;
    let taken = observatory.taken();
    let tail = reader.subscribe::<Value>("starmesh/**", Catch::Newest, 100).await.unwrap();
    let stranger = stranger(&own.locators().await).await;
    let mut keys = Vec::new();
    let began = Instant::now();
    while !keys.iter().any(|key: &String| key.ends_with("/night/state")) {
        assert!(began.elapsed() < LIMIT, "states are answered: {keys:?}");
        for expression in ["starmesh/**", "starmesh/v1/test/alpha/observatory/*", "starmesh/v1/*/*/observatory/order"] {
            let asked = stranger.get(expression).target(zenoh::query::QueryTarget::All).timeout(LIMIT);
            let replies = asked.await.unwrap();
            while let Ok(reply) = replies.recv_async().await {
                keys.extend(reply.result().map(|sample| sample.key_expr().to_string()));
            }
        }
        tokio::time::sleep(PAUSE).await;
    }
    assert!(!keys.iter().any(|key| key.ends_with("/order")), "{keys:?}");
    // The key itself, with nothing asked: a refusal, and nothing for the node to note.
    let replies = stranger.get("starmesh/v1/test/alpha/observatory/order").timeout(LIMIT).await.unwrap();
    let reply = replies.recv_async().await.unwrap();
    let body = reply.result().unwrap().payload().to_bytes().into_owned();
    assert!(String::from_utf8(body).unwrap().contains("nothing was asked"));
    assert_eq!(observatory.taken(), taken, "a reader changed something");
    drop(tail);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_message_of_many_megabytes_reaches_nobody_and_ours_still_do() {
    let own = open(Vec::new()).await;
    let everything = own.subscribe::<Value>("starmesh/v1/**", Catch::Newest, 1000).await.unwrap();
    let other = open(own.locators().await).await;
    let key = Key::Permit(address(), "dome".parse().unwrap());
    let publisher = other.publisher::<Permit>(&key).await.unwrap();
    let stranger = stranger(&own.locators().await).await;
    has_met(&stranger, 1).await;
    let before = resident_bytes();
    let text = "x".repeat(60_000_000);
    let large = json!({"boot_id": "b", "seq": 0, "at_utc": "2026-11-22T00:00:00Z", "large": text}).to_string();
    for _ in 0..3 {
        let sent = stranger.put("starmesh/v1/test/alpha/device/dome/d/state", large.clone());
        sent.congestion_control(zenoh::qos::CongestionControl::Block).await.unwrap();
    }
    let began = Instant::now();
    let mut permits = 0;
    while permits < 5 {
        assert!(began.elapsed() < LIMIT, "{permits} permits came");
        let guard_boot_id = BootId::fresh();
        let permit = Permit {
            verdict: Verdict::Safe,
            commander: "o".to_owned(),
            token: 1,
            guard_number: permits,
            guard_boot_id,
        };
        publisher.put(permit).await.unwrap();
        if let Ok(received) = tokio::time::timeout(Duration::from_millis(500), everything.recv()).await {
            assert!(received.sample.body.get("large").is_none(), "it was taken");
            permits += 1;
        }
    }
    let grown = resident_bytes().saturating_sub(before);
    // This process is also the sender: three copies of the text are its own.
    assert!(grown < 500_000_000, "{grown} bytes");
}

fn resident_bytes() -> usize {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split(' ').nth(1).and_then(|pages| pages.parse::<usize>().ok()).unwrap_or_default() * 4096
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nodes_that_were_given_the_same_address_all_start_and_all_meet() {
    let free = free_address();
    let config = config::Bus { listen: vec![format!("tcp/{free}")], connect: Vec::new(), multicast: false };
    let mut nodes = Vec::new();
    for opened in futures_util::future::join_all((0..5).map(|_| Bus::open(&config, Clock::machine_clock()))).await {
        nodes.push(opened.unwrap());
    }
    let visitor = open(vec![format!("tcp/{free}")]).await;
    all_receive_from_each_other(&nodes.iter().chain([&visitor]).collect::<Vec<_>>(), "five nodes and a visitor").await;
    // The program that has the address ends: one of the others has it now.
    let holder = bus_that_listens(&nodes, &free.to_string()).await.unwrap();
    nodes.remove(holder).close().await;
    let late = open(vec![format!("tcp/{free}")]).await;
    all_receive_from_each_other(
        &nodes.iter().chain([&visitor, &late]).collect::<Vec<_>>(),
        "four nodes and two visitors",
    )
    .await;
}

/// An address that no program gets that asks for any free port, and that is this process's own.
fn free_address() -> SocketAddr {
    let first = 10_000 + u16::try_from(std::process::id() % 20_000).unwrap();
    let mut addresses = (first..32_000).map(|port| SocketAddr::from(([127, 0, 0, 1], port)));
    addresses.find(|address| TcpListener::bind(address).is_ok()).unwrap()
}

async fn bus_that_listens(nodes: &[Bus], address: &str) -> Option<usize> {
    for (at, bus) in nodes.iter().enumerate() {
        if bus.locators().await.iter().any(|locator| locator.contains(address)) {
            return Some(at);
        }
    }
    None
}

/// Each publishes again and again until each has received something of all others. The number of peers does not show
/// it: a program that has just ended may be counted for a while.
async fn all_receive_from_each_other(nodes: &[&Bus], who: &str) {
    let mut publishers = Vec::new();
    let mut subscribers = Vec::new();
    for (number, bus) in nodes.iter().enumerate() {
        let key = Key::Permit(address(), format!("of-{number}").parse().unwrap());
        publishers.push(bus.publisher::<Permit>(&key).await.unwrap());
        let subscriber = bus.subscribe::<Permit>("starmesh/v1/**", Catch::Newest, 1000).await.unwrap();
        subscribers.push((bus.boot_id(), subscriber));
    }
    let senders: HashSet<BootId> = nodes.iter().map(|bus| bus.boot_id().clone()).collect();
    let mut missing: Vec<HashSet<BootId>> = vec![senders; nodes.len()];
    let began = Instant::now();
    for guard_number in 0.. {
        assert!(
            began.elapsed() < LIMIT,
            "{who} do not all receive from each other within {LIMIT:?}; of whom each has nothing: {missing:#?}"
        );
        for publisher in &publishers {
            let commander = "main".to_owned();
            let guard_boot_id = BootId::fresh();
            let permit = Permit { verdict: Verdict::Safe, commander, token: 1, guard_number, guard_boot_id };
            publisher.put(permit).await.unwrap();
        }
        tokio::time::sleep(Duration::from_millis(250)).await;
        for ((own, subscriber), missing) in subscribers.iter().zip(&mut missing) {
            missing.remove(*own);
            while let Ok(received) = tokio::time::timeout(Duration::ZERO, subscriber.recv()).await {
                missing.remove(&received.sample.boot_id);
            }
        }
        if missing.iter().all(HashSet::is_empty) {
            return;
        }
    }
}
