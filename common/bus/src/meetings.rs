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
use zenoh::sample::SampleKind;
use zenoh::session::ZenohId;

use crate::session;
use crate::sockets::{close_in_background, ends};

/// The pause before a peer that is gone is tried; each next one is twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(2);
/// The longest pause where nobody answers, which costs one connection.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// The longest one where somebody answers who is no node: another program, or a node that hangs.
const LONGEST_OF_OTHERS: Duration = Duration::from_secs(120);
/// A peer that is gone so long is forgotten; each start of a node is a new peer.
const FORGET: Duration = Duration::from_secs(3600);
/// So many peers are remembered.
const MOST: usize = 128;
/// So many are met at once; the others after them.
const MOST_AT_ONCE: usize = 8;
/// A host that is off answers nothing at all.
const PROBE: Duration = Duration::from_secs(1);
/// Two links, two messages and a dial take a fraction of it.
const MEETING: Duration = Duration::from_secs(3);
/// A session whose closing is given up keeps its threads and its links for good.
const CLOSING: Duration = Duration::from_secs(60);

/// Where this node has dialled which peer; pure.
#[derive(Debug)]
pub(crate) struct Dialled<P>(BTreeMap<P, Met>);

#[derive(Debug)]
struct Met {
    at: SocketAddr,
    /// Where it publishes its state as a node; before it does, it is none that must be met again.
    node: Option<String>,
    connected: MachineTime,
    tried: MachineTime,
    pause: Duration,
}

/// Who was at the address of a peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Found {
    /// The peer, or nobody.
    Same,
    /// Another node: the peer has ended.
    Another,
    /// Something that answers, and no node.
    NoNode,
}

impl<P> Default for Dialled<P> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<P: Ord + Copy> Dialled<P> {
    pub(crate) fn insert(&mut self, peer: P, at: SocketAddr, now: MachineTime) {
        let node = self.0.get(&peer).and_then(|known| known.node.clone());
        // An address is its last owner's.
        self.0.retain(|_, other| other.at != at);
        if self.0.len() >= MOST {
            let oldest = self.0.iter().min_by_key(|(_, peer)| peer.connected).map(|(peer, _)| *peer);
            oldest.and_then(|peer| self.0.remove(&peer));
        }
        self.0.insert(peer, Met { at, node, connected: now, tried: now, pause: FIRST_PAUSE });
    }

    /// The peer has published the state of the node with this key; one that did so before is an earlier start of it.
    pub(crate) fn is_node(&mut self, peer: P, key: &str) {
        self.0.retain(|other, met| *other == peer || met.node.as_deref() != Some(key));
        if let Some(met) = self.0.get_mut(&peer).filter(|met| met.node.is_none()) {
            met.node = Some(key.to_owned());
        }
    }

    pub(crate) fn found(&mut self, peer: &P, found: Found) {
        match found {
            Found::Same => {}
            Found::Another => drop(self.0.remove(peer)),
            Found::NoNode => {
                if let Some(met) = self.0.get_mut(peer) {
                    met.pause = (met.pause * 2).min(LONGEST_OF_OTHERS);
                }
            }
        }
    }

    /// Nodes that are to be tried now, and where.
    pub(crate) fn look(&mut self, connected: &[P], now: MachineTime) -> Vec<(P, SocketAddr)> {
        self.0.retain(|_, peer| now.since(peer.connected) < FORGET);
        let mut missed = Vec::new();
        for (id, peer) in &mut self.0 {
            if connected.contains(id) {
                (peer.connected, peer.tried, peer.pause) = (now, now, FIRST_PAUSE);
            } else if peer.node.is_some() && now.since(peer.tried) >= peer.pause && missed.len() < MOST_AT_ONCE {
                (peer.tried, peer.pause) = (now, (peer.pause * 2).min(LONGEST_PAUSE.max(peer.pause)));
                missed.push((*id, peer.at));
            }
        }
        missed
    }
}

/// Introduces the node that listens at `own` to those of the peers that answer at their addresses; returns who was found
/// there.
pub(crate) async fn introduce(own: String, missed: Vec<(ZenohId, SocketAddr)>) -> Vec<(ZenohId, Found)> {
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
    tracing::debug!(peers = live.len(), "nodes answer that were met before and are not connected; they are met again");
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
    let met = meet(&session).await;
    if let Err(error) = session.close().timeout(CLOSING).await {
        tracing::warn!(%error, "a session that introduces did not close");
    }
    let who = |at: &SocketAddr| met.iter().find(|(_, there)| there == at).map(|(who, _)| *who);
    let found = |peer: &ZenohId, at: &SocketAddr| match who(at) {
        Some(who) if who == *peer => Found::Same,
        Some(_) => Found::Another,
        None => Found::NoNode,
    };
    live.into_iter().map(|(peer, at)| (peer, found(&peer, &at))).collect()
}

/// Leaves a session its time to link to everybody; returns whom it met where.
async fn meet(session: &zenoh::Session) -> Vec<(ZenohId, SocketAddr)> {
    let mut met = Vec::new();
    let looking = async {
        let events = session.info().link_events_listener().history(true).await?;
        while let Ok(event) = events.recv_async().await {
            if event.kind() == SampleKind::Put {
                met.extend(ends(event.link()).map(|ends| (*event.link().zid(), ends.1)));
                close_in_background(event.link()).await;
            }
        }
        Ok::<(), zenoh::Error>(())
    };
    if let Ok(Err(error)) = tokio::time::timeout(MEETING, looking).await {
        tracing::warn!(%error, "the links of a session that introduces cannot be followed");
    }
    met
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
        dialled.is_node(1, "node");
        let is_tried = |second: &u64| {
            let peers: &[i32] = if connected(*second) { &[1, 2] } else { &[2] };
            dialled.look(peers, at(*second)) == [(1, address(1))]
        };
        (0..seconds).filter(is_tried).collect()
    }

    #[test]
    fn a_node_that_is_gone_is_tried_for_an_hour_and_more_and_more_rarely() {
        assert_eq!(tries(300, |_| true), [0; 0]);
        assert_eq!(tries(140, |s| s <= 10), [12, 16, 24, 40, 70, 100, 130]);
        assert_eq!(tries(80, |s| s <= 10 || (30..=60).contains(&s)), [12, 16, 24, 62, 66, 74], "it was back");
        assert!(tries(3 * 3600, |_| false).iter().all(|second| *second < 3600), "an hour");
    }

    /// Nodes 1 to `last`, each dialled at its own port.
    fn nodes(last: u16) -> Dialled<u16> {
        let mut dialled = Dialled::default();
        for peer in 1..=last {
            dialled.insert(peer, address(peer), at(u64::from(peer)));
            dialled.is_node(peer, &peer.to_string());
        }
        dialled
    }

    #[test]
    fn an_address_is_its_last_owners_and_a_node_that_started_anew_is_one() {
        let mut dialled = nodes(2);
        dialled.insert(3, address(1), at(0));
        dialled.is_node(3, "1");
        assert_eq!(dialled.look(&[], at(10)), [(2, address(2)), (3, address(1))]);
        dialled.found(&2, Found::Another);
        dialled.insert(4, address(4), at(10));
        dialled.is_node(4, "1");
        assert_eq!(dialled.look(&[], at(100)), [(4, address(4))]);
    }

    #[test]
    fn only_nodes_are_tried_few_at_once_and_the_newest_are_remembered() {
        let mut dialled = nodes(200);
        dialled.insert(0, address(999), at(200));
        let mut tried = Vec::new();
        loop {
            let missed = dialled.look(&[], at(210));
            assert!(missed.len() <= MOST_AT_ONCE);
            if missed.is_empty() {
                break;
            }
            tried.extend(missed.iter().map(|(peer, _)| *peer));
        }
        assert_eq!(tried, (74..=200).collect::<Vec<u16>>(), "and not the one that published no state");
    }

    #[test]
    fn another_program_in_the_place_of_a_node_is_tried_every_two_minutes() {
        let mut dialled = nodes(1);
        let mut tries = Vec::new();
        for second in 1..600 {
            for (peer, _) in dialled.look(&[], at(second)) {
                tries.push(second);
                dialled.found(&peer, Found::NoNode);
            }
        }
        assert_eq!(tries, [3, 11, 43, 107, 227, 347, 467, 587]);
    }
}
