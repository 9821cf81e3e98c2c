//! Meets peers again that this node has lost and that live.
//!
//! zenoh dials an address of its configuration for ever, and one that it has from gossip once, when it is named. After 2 s
//! without a network the old links expire after both have been named again: such a pair never met, while others saw both.
//! zenoh has no function to dial, so a session of a few seconds links to both, and gossip names each to the other.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::task::JoinSet;
use units::MachineTime;
use zenoh::session::ZenohId;

use crate::session;
use crate::sockets::ends;

/// The pause before a peer that is gone is tried; each next one is twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(2);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// A peer that is gone so long is forgotten; each start of a node is a new peer.
const FORGET: Duration = Duration::from_secs(24 * 3600);
/// A host that is off answers nothing at all.
const PROBE: Duration = Duration::from_secs(1);
/// Two links, two messages and a dial take a fraction of it.
const MEETING: Duration = Duration::from_secs(3);
const CLOSING: Duration = Duration::from_secs(2);

/// Where this node has dialled which peer; pure.
#[derive(Debug)]
pub(crate) struct Dialled<P>(BTreeMap<P, Peer>);

#[derive(Debug)]
struct Peer {
    at: SocketAddr,
    connected: MachineTime,
    tried: MachineTime,
    pause: Duration,
}

impl<P> Default for Dialled<P> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<P: Ord + Copy> Dialled<P> {
    pub(crate) fn insert(&mut self, peer: P, at: SocketAddr, now: MachineTime) {
        // An address is its last owner's.
        self.0.retain(|_, other| other.at != at);
        self.0.insert(peer, Peer { at, connected: now, tried: now, pause: FIRST_PAUSE });
    }

    pub(crate) fn forget(&mut self, peer: &P) {
        self.0.remove(peer);
    }

    /// Peers that are to be tried now, and where.
    pub(crate) fn look(&mut self, connected: &[P], now: MachineTime) -> Vec<(P, SocketAddr)> {
        self.0.retain(|_, peer| now.since(peer.connected) < FORGET);
        let mut missed = Vec::new();
        for (id, peer) in &mut self.0 {
            if connected.contains(id) {
                (peer.connected, peer.tried, peer.pause) = (now, now, FIRST_PAUSE);
            } else if now.since(peer.tried) >= peer.pause {
                (peer.tried, peer.pause) = (now, (peer.pause * 2).min(LONGEST_PAUSE));
                missed.push((*id, peer.at));
            }
        }
        missed
    }
}

/// Introduces the node that listens at `own` to those of the peers that answer at their addresses; returns those at whose
/// addresses others are.
pub(crate) async fn introduce(own: String, missed: Vec<(ZenohId, SocketAddr)>) -> Vec<ZenohId> {
    let mut probes = JoinSet::new();
    for (peer, at) in missed {
        probes.spawn(async move {
            let answer = tokio::time::timeout(PROBE, TcpStream::connect(at)).await;
            matches!(answer, Ok(Ok(_))).then_some((peer, at))
        });
    }
    // Who answers nothing costs no session.
    let live: Vec<(ZenohId, SocketAddr)> = probes.join_all().await.into_iter().flatten().collect();
    if live.is_empty() {
        return Vec::new();
    }
    tracing::info!(peers = live.len(), "nodes answer that were met before and are not connected; they are met again");
    let mut connect = vec![own];
    connect.extend(live.iter().map(|(_, at)| format!("tcp/{at}")));
    let opened = match zenoh::Config::from_json5(&session::introducing(connect).to_string()) {
        Ok(settings) => zenoh::open(settings).await,
        Err(error) => Err(error),
    };
    let session = match opened {
        Ok(session) => session,
        Err(error) => {
            tracing::warn!(%error, "nodes that are not connected cannot be met now; it is tried again");
            return Vec::new();
        }
    };
    tokio::time::sleep(MEETING).await;
    let links = session.info().links().await.filter_map(|link| Some((*link.zid(), ends(&link)?.1)));
    let met: Vec<(ZenohId, SocketAddr)> = links.collect();
    if tokio::time::timeout(CLOSING, session.close()).await.is_err() {
        tracing::debug!("the session that introduces took long to close");
    }
    let is_of_others = |peer: &ZenohId, at: &SocketAddr| met.iter().any(|(who, there)| there == at && who != peer);
    live.into_iter().filter(|(peer, at)| is_of_others(peer, at)).map(|(peer, _)| peer).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(seconds))
    }

    fn address(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    /// Seconds at which peer 1, dialled at the start, is tried.
    fn tries(seconds: u64, connected: impl Fn(u64) -> bool) -> Vec<u64> {
        let mut dialled = Dialled::default();
        dialled.insert(1, address(1), at(0));
        let is_tried = |second: &u64| {
            let peers: &[i32] = if connected(*second) { &[1, 2] } else { &[2] };
            dialled.look(peers, at(*second)) == [(1, address(1))]
        };
        (0..seconds).filter(is_tried).collect()
    }

    #[test]
    fn a_peer_that_is_gone_is_tried_for_ever_and_more_and_more_rarely() {
        assert_eq!(tries(300, |_| true), [0; 0]);
        assert_eq!(tries(140, |s| s <= 10), [12, 16, 24, 40, 70, 100, 130]);
        assert_eq!(tries(80, |s| s <= 10 || (30..=60).contains(&s)), [12, 16, 24, 62, 66, 74], "it was back");
        assert!(tries(2 * 24 * 3600, |_| false).iter().all(|second| *second < 24 * 3600), "a day");
    }

    #[test]
    fn an_address_is_its_last_owners() {
        let mut dialled = Dialled::default();
        dialled.insert(1, address(1), at(0));
        dialled.insert(2, address(2), at(0));
        dialled.insert(3, address(1), at(0));
        assert_eq!(dialled.look(&[], at(10)), [(2, address(2)), (3, address(1))]);
        dialled.forget(&2);
        assert_eq!(dialled.look(&[], at(100)), [(3, address(1))]);
    }
}
