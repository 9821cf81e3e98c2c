//! Hosts that are off: their links end, and what the others send arrives all the while.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use bus::{Bus, Catch, Clock, Publisher, Subscriber};
use contract::node::NodeState;
use contract::{Address, Key, NodeTopic, Role};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

/// Which thread closes a link is chance; two of them receive here.
const DEAD: usize = 4;

async fn open(connect: Vec<String>) -> Bus {
    let config = config::Bus { listen: Vec::new(), connect, multicast: false };
    let bus = Bus::open(&config, Clock::machine_clock()).await.unwrap();
    let mended = bus.clone();
    tokio::spawn(async move { mended.keep_mending().await });
    bus
}

/// A way to an address that, when it is stopped, neither takes nor ends anything, as that of a host that is off.
async fn way_to(locator: &str, stopped: watch::Receiver<bool>) -> String {
    let there: SocketAddr = locator.strip_prefix("tcp/").unwrap().parse().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let here = format!("tcp/{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let far = TcpStream::connect(there).await.unwrap();
            let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
            tokio::spawn(carry(near_in, far_out, stopped.clone()));
            tokio::spawn(carry(far_in, near_out, stopped.clone()));
        }
    });
    here
}

async fn is_stopped(stopped: &mut watch::Receiver<bool>) {
    stopped.wait_for(|stopped| *stopped).await.map(drop).unwrap_or_default();
}

async fn carry(
    mut from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    mut stopped: watch::Receiver<bool>,
) {
    let mut bytes = vec![0; 65536];
    loop {
        tokio::select! {
            biased;
            () = is_stopped(&mut stopped) => std::future::pending::<()>().await,
            read = from.read(&mut bytes) => match read {
                Ok(0) | Err(_) => return,
                Ok(count) => to.write_all(&bytes[..count]).await.unwrap_or_default(),
            },
        }
    }
}

fn key(node: &str) -> Key {
    Key::Node(Address::new("test", "alpha").unwrap(), Role::Archive, node.parse().unwrap(), NodeTopic::State)
}

fn state(bytes: usize) -> NodeState {
    NodeState {
        role: Role::Archive,
        version: "x".repeat(bytes),
        host: String::new(),
        pid: 1,
        uptime_s: 1.0,
        speed: 1.0,
        figures: BTreeMap::new(),
        stopped: None,
    }
}

/// What takes longer hangs, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

/// A node that hosts are linked to, all of which go off but one, which sends ten times a second.
struct Scene {
    listener: Bus,
    received: Subscriber<NodeState>,
    _hosts: Vec<(Bus, Option<Subscriber<NodeState>>)>,
    _stop: watch::Sender<bool>,
}

impl Scene {
    async fn with_hosts_that_went_off() -> Self {
        let (stop, stopped) = watch::channel(false);
        let listener = open(Vec::new()).await;
        let mut hosts = Vec::new();
        for _ in 0..DEAD {
            let peer = open(vec![way_to(&listener.locators().await[0], stopped.clone()).await]).await;
            let subscriber = peer.subscribe::<NodeState>(key("large"), Catch::Newest, 4).await.unwrap();
            hosts.push((peer, Some(subscriber)));
        }
        let alive = open(listener.locators().await).await;
        let large: Publisher<NodeState> = listener.publisher(&key("large")).await.unwrap();
        let small: Publisher<NodeState> = alive.publisher(&key("small")).await.unwrap();
        hosts.push((alive, None));
        let received = listener.subscribe::<NodeState>(key("small"), Catch::Newest, 64).await.unwrap();
        let began = Instant::now();
        while listener.peers().await <= DEAD {
            assert!(began.elapsed() < LIMIT, "{} hosts were met", listener.peers().await);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        tokio::time::sleep(Duration::from_secs(1)).await;

        stop.send(true).unwrap();
        // More than the buffers of a link take.
        for _ in 0..20 {
            large.put(state(1 << 20)).await.unwrap();
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        tokio::spawn(async move {
            loop {
                small.put(state(1)).await.unwrap();
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        });
        Self { listener, received, _hosts: hosts, _stop: stop }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_to_hosts_that_are_off_end_and_what_another_one_sends_arrives_after_it_too() {
    let scene = Scene::with_hosts_that_went_off().await;
    let began = Instant::now();
    while scene.listener.peers().await > 1 {
        assert!(began.elapsed() < LIMIT, "{} peers are left", scene.listener.peers().await);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    // More than can have waited.
    for _ in 0..70 {
        tokio::time::timeout(LIMIT, scene.received.recv()).await.unwrap();
    }
}

mod proof {
    use super::*;

    /// How long nothing arrives is a bound in seconds on a real clock. zenoh closes in the threads that receive, and each
    /// closing waited 10 s for what a dead host had not taken.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn hosts_that_are_off_do_not_stop_what_another_one_sends() {
        let scene = Scene::with_hosts_that_went_off().await;
        let (began, mut newest, mut longest, mut fewest) = (Instant::now(), Instant::now(), Duration::ZERO, usize::MAX);
        while began.elapsed() < Duration::from_secs(18) {
            let came = tokio::time::timeout(Duration::from_secs(1), scene.received.recv()).await;
            longest = longest.max(newest.elapsed());
            if came.is_ok() {
                newest = Instant::now();
            }
            fewest = fewest.min(scene.listener.peers().await);
        }
        assert_eq!(fewest, 1, "the links to hosts that are off have ended");
        assert!(longest < Duration::from_secs(3), "nothing was received for {longest:?}");
    }
}
