//! Ends links that zenoh takes for whole and are not, so that both sides begin anew; zenoh offers no way to end one
//! transport, so its sockets are shut down.
//!
//! Two peers that dial each other share one transport of two TCP links. When one of them is stopped or cut off long
//! enough, the other begins anew while the first still holds the old transport, takes the new link into it, and does
//! not declare again its publishers, subscribers and queryables. Neither side notices, for good, and samples come under
//! the keys that had their numbers before (eclipse-zenoh/zenoh#2806). So a transport that lost a link and gets another
//! one begins anew, and so does one over which nothing comes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use contract::{NodeTopic, Topic};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use zenoh::sample::SampleKind;
use zenoh::session::{Link, ZenohId};

use crate::meetings::{Dialled, Found, introduce};
use crate::sockets::{self, close_in_background, ends};
use crate::{Bus, BusError, MachineTime, machine};

/// A node publishes its state every 5 s; three are missed by then.
const SILENT: Duration = Duration::from_secs(17);
/// The second cut of one peer comes so much later at the earliest, each next one twice as late: its node may hang.
const FIRST_PAUSE: Duration = Duration::from_secs(30);
const LONGEST_PAUSE: Duration = Duration::from_secs(600);
/// A peer that is gone so long is forgotten; each start of a node is a new peer.
const FORGET: Duration = Duration::from_secs(3600);
const LOOK: Duration = Duration::from_secs(5);
/// What happens to links and has not been looked at yet; it is full only while this node hangs.
const WAITING: usize = 1024;

/// What zenoh reports of a peer.
enum Event {
    /// Of the node with this key.
    State(ZenohId, String),
    Added(Link),
    Removed(ZenohId),
    Closed(ZenohId),
}

impl Bus {
    /// Watches the links to all nodes and mends them, for ever.
    pub async fn keep_mending(&self) -> Result<(), BusError> {
        let session = &self.session;
        let (sender, mut receiver) = mpsc::channel(WAITING);
        let failed = |what, key: &str| {
            let key = key.to_owned();
            move |source| BusError::Declare { what, key, source }
        };
        let states = Topic::Node(NodeTopic::State).everywhere().to_string();
        let into = sender.clone();
        let subscriber = session.declare_subscriber(&states).callback(move |sample| {
            if let Some(source) = sample.source_info() {
                let _ = into.try_send(Event::State(source.source_id().zid(), sample.key_expr().to_string()));
            }
        });
        let _subscriber = subscriber.await.map_err(failed("a subscriber", &states))?;
        let info = session.info();
        let into = sender.clone();
        let transports = info.transport_events_listener().callback(move |event| {
            if event.kind() == SampleKind::Delete {
                let _ = into.try_send(Event::Closed(*event.transport().zid()));
            }
        });
        let _transports = transports.await.map_err(failed("a listener", "transports"))?;
        let links = info.link_events_listener().history(true).callback(move |event| {
            let link = event.link().clone();
            let _ = sender.try_send(match event.kind() {
                SampleKind::Put => Event::Added(link),
                SampleKind::Delete => Event::Removed(*link.zid()),
            });
        });
        let _links = links.await.map_err(failed("a listener", "links"))?;
        let (mut silence, mut lost) = (Silence::default(), LostLinks::default());
        let (mut dialled, mut meeting) = (Dialled::default(), JoinSet::<Vec<(ZenohId, Found)>>::new());
        let mut looks = tokio::time::interval(LOOK);
        loop {
            tokio::select! {
                Some(event) = receiver.recv() => match event {
                    Event::State(peer, key) => {
                        silence.observe(peer, machine::now());
                        dialled.is_node(peer, &key);
                    }
                    Event::Added(link) => {
                        if let Some((here, there)) = ends(&link)
                            && !self.is_own_port(here.port()).await
                        {
                            dialled.insert(*link.zid(), there, machine::now());
                        }
                        if lost.added(*link.zid()) {
                            self.begin_anew(*link.zid(), "a link of a node was lost, and another one came").await;
                        } else {
                            close_in_background(&link).await;
                        }
                    }
                    Event::Removed(peer) => lost.removed(peer),
                    Event::Closed(peer) => lost.closed(peer),
                },
                _ = looks.tick() => {
                    let connected: Vec<ZenohId> = session.info().links().await.map(|link| *link.zid()).collect();
                    for peer in silence.look(&connected, machine::now()) {
                        self.begin_anew(peer, "a node is connected and nothing of it arrives").await;
                    }
                    let own = self.locators().await.into_iter().find(|locator| locator.starts_with("tcp/"));
                    if let Some(own) = own.filter(|_| meeting.is_empty()) {
                        let missed = dialled.look(&connected, machine::now());
                        if !missed.is_empty() {
                            meeting.spawn(introduce(own, missed));
                        }
                    }
                }
                Some(done) = meeting.join_next() => {
                    for (peer, found) in done.unwrap_or_default() {
                        dialled.found(&peer, found);
                    }
                }
            }
        }
    }

    /// Does this node listen on that port? A link from there was dialled by the peer.
    async fn is_own_port(&self, port: u16) -> bool {
        let end = format!(":{port}");
        self.locators().await.iter().any(|locator| locator.ends_with(&end))
    }

    /// Cuts all links to a peer.
    async fn begin_anew(&self, peer: ZenohId, why: &str) {
        let links = self.session.info().links().await;
        match sockets::shut_down(links.filter(|link| *link.zid() == peer).filter_map(|link| ends(&link)).collect())
            .await
        {
            Ok(links) => tracing::warn!(%peer, links, "{why}; its links begin anew"),
            Err(error) => tracing::error!(%peer, %error, "{why}; its links cannot be cut, start this node anew"),
        }
    }
}

/// Peers whose transport has lost a link and lives on; pure.
#[derive(Debug)]
struct LostLinks<P>(BTreeSet<P>);

impl<P> Default for LostLinks<P> {
    fn default() -> Self {
        Self(BTreeSet::new())
    }
}

impl<P: Ord> LostLinks<P> {
    /// Must the transport begin anew that has got this link?
    fn added(&mut self, peer: P) -> bool {
        self.0.remove(&peer)
    }

    fn removed(&mut self, peer: P) {
        self.0.insert(peer);
    }

    /// The whole transport has ended: the next one is new to both sides.
    fn closed(&mut self, peer: P) {
        self.0.remove(&peer);
    }
}

/// Since when which peer is silent; pure.
#[derive(Debug)]
struct Silence<P> {
    peers: BTreeMap<P, Peer>,
}

#[derive(Debug)]
struct Peer {
    received: MachineTime,
    connected: MachineTime,
    cut: Option<(MachineTime, Duration)>,
}

impl<P> Default for Silence<P> {
    fn default() -> Self {
        Self { peers: BTreeMap::new() }
    }
}

impl<P: Ord + Copy> Silence<P> {
    fn observe(&mut self, peer: P, now: MachineTime) {
        self.peers.insert(peer, Peer { received: now, connected: now, cut: None });
    }

    /// Peers whose links must be cut; only those from which something was received before.
    fn look(&mut self, connected: &[P], now: MachineTime) -> Vec<P> {
        self.peers.retain(|_, peer| now.since(peer.connected) < FORGET);
        let mut silent = Vec::new();
        for (id, peer) in &mut self.peers {
            if !connected.contains(id) {
                // Silence counts from the next connection on.
                peer.received = now;
                continue;
            }
            peer.connected = now;
            let is_due = peer.cut.is_none_or(|(at, pause)| now.since(at) > pause);
            if is_due && now.since(peer.received) > SILENT {
                let pause = peer.cut.map_or(FIRST_PAUSE, |(_, pause)| (pause * 2).min(LONGEST_PAUSE));
                peer.cut = Some((now, pause));
                silent.push(*id);
            }
        }
        silent
    }
}

#[cfg(test)]
mod tests {
    use contract::node::NodeState;
    use contract::{Address, Key, Role};
    use zenoh::sample::SampleKind;

    use super::*;
    use crate::Clock;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    /// Seconds at which peer 1 is cut when something of it is received, and it is connected, at these.
    fn cuts(seconds: u64, received: impl Fn(u64) -> bool, connected: impl Fn(u64) -> bool) -> Vec<u64> {
        let mut silence = Silence::default();
        let mut cuts = Vec::new();
        for second in 0..seconds {
            if received(second) {
                silence.observe(1, at(second));
            }
            let peers: &[i32] = if connected(second) { &[1, 2] } else { &[2] };
            if silence.look(peers, at(second)).contains(&1) {
                cuts.push(second);
            }
        }
        cuts
    }

    #[test]
    fn a_peer_that_sends_or_is_gone_is_left_alone() {
        assert_eq!(cuts(300, |s| s % 5 == 0, |_| true), [0; 0]);
        assert_eq!(cuts(300, |s| s == 0, |s| s == 0), [0; 0]);
        assert_eq!(cuts(300, |_| false, |_| true), [0; 0], "a stranger that never says how it is");
    }

    #[test]
    fn a_connected_peer_that_falls_silent_is_cut_and_then_more_and_more_rarely() {
        assert_eq!(cuts(300, |s| s <= 100 && s % 5 == 0, |_| true), [118, 149, 210]);
    }

    #[test]
    fn silence_counts_from_the_new_connection() {
        assert_eq!(cuts(90, |s| s == 0, |s| !(5..60).contains(&s)), [77]);
    }

    #[test]
    fn a_transport_that_lost_a_link_and_gets_another_one_begins_anew() {
        let mut lost = LostLinks::default();
        assert!(!lost.added(1) && !lost.added(1), "the first links of a peer");
        lost.removed(1);
        lost.removed(1);
        lost.closed(1);
        assert!(!lost.added(1), "all links were lost, and so the transport is a new one");
        lost.removed(1);
        assert!(!lost.added(2), "of another peer");
        assert!(lost.added(1));
        assert!(!lost.added(1), "once");
    }

    async fn open(connect: Vec<String>) -> Bus {
        let config = config::Bus { listen: Vec::new(), connect, multicast: false };
        Bus::open(&config, Clock::machine_clock()).await.unwrap()
    }

    fn state_key(id: &str) -> Key {
        Key::Node(Address::new("test", "alpha").unwrap(), Role::Archive, id.parse().unwrap(), NodeTopic::State)
    }

    fn state() -> NodeState {
        NodeState {
            role: Role::Archive,
            version: String::new(),
            host: String::new(),
            pid: 1,
            uptime_s: 1.0,
            speed: 1.0,
            figures: BTreeMap::new(),
            stopped: None,
        }
    }

    /// Starts the mending of a bus. When this returns, it has declared what it listens to, and misses no link.
    async fn keep_mending(tasks: &mut JoinSet<Result<(), BusError>>, bus: &Bus) {
        let bus = bus.clone();
        let mut mending = Box::pin(async move { bus.keep_mending().await });
        // It declares in the first look at it.
        tokio::select! {
            biased;
            ended = &mut mending => panic!("{ended:?}"),
            () = std::future::ready(()) => {}
        }
        tasks.spawn(mending);
    }

    /// Each publishes its state as a node until the other one has received it.
    async fn publish_until_received(one: &Bus, other: &Bus) {
        let states = Topic::Node(NodeTopic::State).everywhere().to_string();
        for (from, to, id) in [(one, other, "one"), (other, one, "other")] {
            let (sender, mut receiver) = mpsc::unbounded_channel();
            let who = from.session.zid();
            let of_it = move |sample: zenoh::sample::Sample| {
                if sample.source_info().is_some_and(|info| info.source_id().zid() == who) {
                    sender.send(()).unwrap_or_default();
                }
            };
            let _subscriber = to.session.declare_subscriber(&states).callback(of_it).await.unwrap();
            let publisher = from.publisher(&state_key(id)).await.unwrap();
            let publishing = async {
                loop {
                    publisher.put(state()).await.unwrap();
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            };
            let received = tokio::time::timeout(Duration::from_secs(60), receiver.recv());
            tokio::select! {
                received = received => assert!(received.is_ok_and(|received| received.is_some())),
                () = publishing => {}
            }
        }
    }

    /// Gossip named each to the other once; after a short loss of the network they did not meet, for good.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn peers_that_met_through_a_third_one_and_lost_each_other_meet_again() {
        let third = open(Vec::new()).await;
        let (one, other) = (open(third.locators().await).await, open(third.locators().await).await);
        let mut tasks = JoinSet::new();
        keep_mending(&mut tasks, &one).await;
        keep_mending(&mut tasks, &other).await;
        let (sender, mut receiver) = mpsc::unbounded_channel();
        let who = other.session.zid();
        let info = one.session.info();
        let events = info.transport_events_listener().history(true).callback(move |event| {
            if *event.transport().zid() == who {
                sender.send(event.kind()).unwrap_or_default();
            }
        });
        let _events = events.await.unwrap();
        let mut next = async || tokio::time::timeout(Duration::from_secs(60), receiver.recv()).await.unwrap().unwrap();
        assert_eq!(next().await, SampleKind::Put, "they meet through the third one");
        publish_until_received(&one, &other).await;
        one.begin_anew(who, "a test cuts it").await;
        while next().await != SampleKind::Delete {}
        assert_eq!(next().await, SampleKind::Put, "and meet again");
    }

    /// A peer that published its state and then hangs, or whose samples are lost in a transport that zenoh takes for
    /// whole. After how long it is cut is judged above, where time is a value.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn links_over_which_nothing_comes_begin_anew() {
        let own = open(Vec::new()).await;
        let silent = open(own.locators().await).await;
        let (sender, mut receiver) = mpsc::unbounded_channel();
        let alive =
            Key::Node(Address::new("test", "alpha").unwrap(), Role::Archive, "main".parse().unwrap(), NodeTopic::Alive);
        let tokens = own.session.liveliness().declare_subscriber(alive.to_string()).history(true);
        let _subscriber = tokens.callback(move |token| sender.send(token.kind()).unwrap_or_default()).await.unwrap();
        let _alive = silent.show_alive(&alive).await.unwrap();
        let mut tasks = JoinSet::new();
        keep_mending(&mut tasks, &own).await;
        let mut next = async || tokio::time::timeout(Duration::from_secs(240), receiver.recv()).await.unwrap().unwrap();
        assert_eq!(next().await, SampleKind::Put);
        publish_until_received(&own, &silent).await;
        assert_eq!(next().await, SampleKind::Delete, "the links are cut");
        assert_eq!(next().await, SampleKind::Put, "and the peers have met again");
    }
}
