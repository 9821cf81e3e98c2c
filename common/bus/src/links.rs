//! Mends links over which nothing comes, while zenoh reports that the peer is connected.
//!
//! Two peers that dial each other share one transport of two TCP links. When one of them is stopped or cut off long
//! enough, the other begins anew while the first still holds the old transport, takes the new link into it, and does
//! not declare again its publishers, subscribers and queryables. Neither side notices, for good (eclipse-zenoh/zenoh#2806).
//! zenoh offers no way to end one transport, so its sockets are shut down; both sides then begin anew.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::sync::mpsc;
use zenoh::session::ZenohId;

use crate::{Bus, MachineTime, machine};

/// A node publishes its state every 5 s; three are missed by then.
const SILENT: Duration = Duration::from_secs(17);
/// The second cut of one peer comes so much later at the earliest, each next one twice as late: its node may hang.
const FIRST_PAUSE: Duration = Duration::from_secs(30);
const LONGEST_PAUSE: Duration = Duration::from_secs(600);
/// A peer that is gone so long is forgotten; each start of a node is a new peer.
const FORGET: Duration = Duration::from_secs(3600);
const LOOK: Duration = Duration::from_secs(5);

/// Watches and mends for ever.
pub async fn keep_mending(bus: &Bus) -> anyhow::Result<()> {
    let (tell, mut told) = mpsc::channel(64);
    let session = &bus.session;
    let states = "starmesh/v1/*/*/node/*/*/state";
    let subscriber = session.declare_subscriber(states).callback(move |sample| {
        if let Some(source) = sample.source_info() {
            // It is full only while this task hangs; the next state is 5 s away.
            let _ = tell.try_send(source.source_id().zid());
        }
    });
    let _subscriber = subscriber.await.map_err(|error| anyhow::anyhow!("cannot hear {states}: {error}"))?;
    let mut silence = Silence::default();
    let mut looks = tokio::time::interval(LOOK);
    loop {
        tokio::select! {
            Some(peer) = told.recv() => silence.hear(peer, machine::now()),
            _ = looks.tick() => {
                let links: Vec<_> = session.info().links().await.collect();
                let connected: Vec<ZenohId> = links.iter().map(|link| *link.zid()).collect();
                for peer in silence.look(&connected, machine::now()) {
                    let of_peer = links.iter().filter(|link| *link.zid() == peer);
                    let ends = of_peer.filter_map(|link| Some((address(link.src())?, address(link.dst())?))).collect();
                    mend(peer, ends).await;
                }
            }
        }
    }
}

async fn mend(peer: ZenohId, ends: Vec<(SocketAddr, SocketAddr)>) {
    let cut = tokio::task::spawn_blocking(move || cut(&ends)).await.map_err(std::io::Error::other).flatten();
    match cut {
        Ok(count) => {
            tracing::warn!(%peer, links = count, "a node is connected and nothing of it arrives; its links begin anew")
        }
        Err(error) => {
            tracing::error!(%peer, %error, "a node is connected and nothing of it arrives; its links cannot be cut")
        }
    }
}

/// The address of a TCP locator such as `tcp/127.0.0.1:7447`.
fn address(locator: &zenoh::config::Locator) -> Option<SocketAddr> {
    locator.to_string().strip_prefix("tcp/")?.parse().ok()
}

/// Shuts down this process's sockets between these ends; returns how many there were.
#[cfg(target_os = "linux")]
fn cut(ends: &[(SocketAddr, SocketAddr)]) -> std::io::Result<usize> {
    use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
    let own = pidfd_open(getpid(), PidfdFlags::empty())?;
    let same = |a: SocketAddr, b: SocketAddr| a.ip().to_canonical() == b.ip().to_canonical() && a.port() == b.port();
    let mut count = 0;
    for entry in std::fs::read_dir("/proc/self/fd")? {
        let Some(number) = entry?.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        // Links that have been closed since, and descriptors that are no sockets, are not meant.
        let Ok(descriptor) = pidfd_getfd(&own, number, PidfdGetfdFlags::empty()) else { continue };
        let socket = std::net::TcpStream::from(descriptor);
        let (Ok(here), Ok(there)) = (socket.local_addr(), socket.peer_addr()) else { continue };
        if ends.iter().any(|(src, dst)| same(here, *src) && same(there, *dst)) {
            socket.shutdown(std::net::Shutdown::Both)?;
            count += 1;
        }
    }
    Ok(count)
}

#[cfg(not(target_os = "linux"))]
fn cut(_: &[(SocketAddr, SocketAddr)]) -> std::io::Result<usize> {
    Err(std::io::Error::other("this is known only for Linux; start this node anew"))
}

/// Since when which peer is silent; pure.
#[derive(Debug)]
struct Silence<P> {
    peers: BTreeMap<P, Peer>,
}

#[derive(Debug)]
struct Peer {
    heard: MachineTime,
    connected: MachineTime,
    cut: Option<(MachineTime, Duration)>,
}

impl<P> Default for Silence<P> {
    fn default() -> Self {
        Self { peers: BTreeMap::new() }
    }
}

impl<P: Ord + Copy> Silence<P> {
    fn hear(&mut self, peer: P, now: MachineTime) {
        self.peers.insert(peer, Peer { heard: now, connected: now, cut: None });
    }

    /// Peers whose links must be cut; only those from which something was received before.
    fn look(&mut self, connected: &[P], now: MachineTime) -> Vec<P> {
        self.peers.retain(|_, peer| now.since(peer.connected) < FORGET);
        let mut silent = Vec::new();
        for (id, peer) in &mut self.peers {
            if !connected.contains(id) {
                // Silence counts from the next connection on.
                peer.heard = now;
                continue;
            }
            peer.connected = now;
            let is_due = peer.cut.is_none_or(|(at, pause)| now.since(at) > pause);
            if is_due && now.since(peer.heard) > SILENT {
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
    use contract::{Address, Key, NodeTopic, Role};
    use zenoh::sample::SampleKind;

    use super::*;
    use crate::{Clock, Node, Quality};

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    /// Seconds at which peer 1 is cut when it is received from and connected at these.
    fn cuts(seconds: u64, heard: impl Fn(u64) -> bool, connected: impl Fn(u64) -> bool) -> Vec<u64> {
        let mut silence = Silence::default();
        let mut cuts = Vec::new();
        for second in 0..seconds {
            if heard(second) {
                silence.hear(1, at(second));
            }
            let peers: &[i32] = if connected(second) { &[1, 2] } else { &[2] };
            if silence.look(peers, at(second)).contains(&1) {
                cuts.push(second);
            }
        }
        cuts
    }

    #[test]
    fn a_peer_that_is_heard_or_gone_is_left_alone() {
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

    async fn open(connect: Vec<String>) -> Bus {
        let config = config::Bus { listen: Vec::new(), connect, multicast: false };
        Bus::open(&config, Clock::machine_clock()).await.unwrap()
    }

    /// A peer that published its state once and then hangs, or whose samples are lost in a transport that zenoh takes
    /// for whole.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn links_over_which_nothing_comes_begin_anew() {
        let own = open(Vec::new()).await;
        let silent = open(own.locators().await).await;
        let node_key =
            |role, topic| Key::Node(Address::new("test", "alpha").unwrap(), role, "main".parse().unwrap(), topic);
        let text = "[observatory]\nsite = \"test\"\ntelescope = \"alpha\"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n\
                    elevation_m = 2500\n";
        let config = config::parse(text, std::path::Path::new(".")).unwrap();
        let node = Node::new(Role::Web, "main".parse().unwrap(), config, Default::default(), own.clone());
        let state = node.state();
        let (tell, mut told) = mpsc::unbounded_channel();
        let alive = node_key(Role::Archive, NodeTopic::Alive);
        let tokens = own.session.liveliness().declare_subscriber(alive.to_string()).history(true);
        let _ear = tokens.callback(move |token| tell.send(token.kind()).unwrap_or_default()).await.unwrap();
        let _alive = silent.show_alive(&alive).await.unwrap();
        let mended = own.clone();
        let mending = tokio::spawn(async move { keep_mending(&mended).await });
        let mut next = async || tokio::time::timeout(Duration::from_secs(60), told.recv()).await.unwrap().unwrap();
        assert_eq!(next().await, SampleKind::Put);

        let publisher = silent.publisher(&node_key(Role::Archive, NodeTopic::State), Quality::State { cache: 1 }).await;
        // The subscriber of the mending task must be declared by then.
        tokio::time::sleep(Duration::from_secs(1)).await;
        publisher.unwrap().put(state).await.unwrap();
        let began = std::time::Instant::now();
        assert_eq!(next().await, SampleKind::Delete, "the links are cut");
        assert!(began.elapsed() > Duration::from_secs(15), "too soon");
        assert_eq!(next().await, SampleKind::Put, "and the peers have met again");
        mending.abort();
    }
}
