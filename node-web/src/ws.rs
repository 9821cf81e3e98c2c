//! The live socket: a snapshot, then the changes, four times a second at most, and a beat every second.
//!
//! No client has a queue. It remembers the revision it has seen, so that a slow client gets each key's newest value
//! once, when it is ready for it; the server closes the socket of a client that takes nothing for 10 s.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use contract::Address;
use local_http::{Peer, Room};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::gate::Gate;
use crate::network::Network;
use crate::problem::Problem;
use crate::routes::network::states;
use crate::server::Server;
use crate::summary::Face;

const TICK: Duration = Duration::from_millis(250);
const TICKS_PER_BEAT: u32 = 4;
const STALLED_AFTER: Duration = Duration::from_secs(10);
/// Pages that may be open: those of one address cannot take all, and there is room left for operators on this host.
pub const ROOM: Room = Room { total: 200, per_address: 40, trusted: 40 };

/// Which telescope the page shows; `site/telescope`, or none for the overview.
#[derive(Debug, Default, Deserialize)]
pub struct Wanted {
    telescope: Option<String>,
}

/// A message of a page.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case")]
enum Said {
    Watch { telescope: Option<String> },
}

/// Opens the socket for a page of ours.
pub async fn open(
    State(server): State<Arc<Server>>,
    Extension(Peer(peer)): Extension<Peer>,
    Query(wanted): Query<Wanted>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !Gate::same_origin(&headers) {
        let detail = "A page from elsewhere may not read this telescope network.";
        return Problem::new(StatusCode::FORBIDDEN, "forbidden", "Foreign page", detail).into_response();
    }
    let Some(place) = server.sockets.take(peer) else {
        let Room { total, per_address, .. } = ROOM;
        let detail = format!("{per_address} pages of one address may be open, and {total} of all.");
        return Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", "Too many pages", detail).into_response();
    };
    upgrade.max_message_size(4096).on_upgrade(move |socket| async move {
        let _watching = server.previews.watch();
        let view = View::of(wanted.telescope.as_deref());
        server.stop.or(serve(socket, &server, view)).await;
        drop(place);
    })
}

async fn serve(mut socket: WebSocket, server: &Server, mut view: View) {
    let mut tick = tokio::time::interval(TICK);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut ticks = 0u32;
    loop {
        tokio::select! {
            _ = tick.tick() => {
                let due = ticks.is_multiple_of(TICKS_PER_BEAT);
                ticks = ticks.wrapping_add(1);
                if let Some(text) = view.next(&server.network, due) {
                    let sent = socket.send(Message::Text(Utf8Bytes::from(text)));
                    match tokio::time::timeout(STALLED_AFTER, sent).await {
                        Ok(Ok(())) => {}
                        Ok(Err(_)) => return,
                        Err(_) => {
                            tracing::debug!("a page took nothing for 10 s and was let go");
                            return;
                        }
                    }
                }
            }
            said = socket.recv() => match said {
                None | Some(Err(_)) | Some(Ok(Message::Close(_))) => return,
                Some(Ok(Message::Text(text))) => {
                    if let Ok(Said::Watch { telescope }) = serde_json::from_str(&text) {
                        view = View::of(telescope.as_deref());
                        tick.reset_immediately();
                    }
                }
                // The library answers pings by itself.
                Some(Ok(Message::Binary(_) | Message::Ping(_) | Message::Pong(_))) => {}
            },
        }
    }
}

/// The state that one page shows, and how much of it the page has.
struct View {
    telescope: Option<Address>,
    /// Revision that the page has; absent before the snapshot.
    seen: Option<u64>,
    faces: BTreeMap<String, Face>,
}

impl View {
    fn of(telescope: Option<&str>) -> Self {
        let address = telescope.and_then(|text| text.split_once('/')).and_then(|(s, t)| Address::new(s, t).ok());
        Self { telescope: address, seen: None, faces: BTreeMap::new() }
    }

    /// The message that the page lacks: a snapshot at first, then changes; with `beat` also when nothing changed.
    fn next(&mut self, network: &Network, beat: bool) -> Option<String> {
        let mut message = Map::new();
        let op = match (self.seen, beat) {
            (None, _) => "snap",
            (Some(_), true) => "beat",
            (Some(_), false) => "delta",
        };
        message.insert("op".into(), json!(op));
        message.insert("server_time_utc".into(), json!(network.clock().utc()));
        message.insert("speed".into(), json!(network.clock().speed()));
        if self.seen.is_none() {
            message.insert("version".into(), json!(env!("CARGO_PKG_VERSION")));
            message.insert("watch".into(), json!(self.telescope.as_ref().map(ToString::to_string)));
        }
        let quiet = message.len();
        self.add_states(network, &mut message);
        self.add_faces(network, beat, &mut message);
        (op != "delta" || message.len() > quiet).then(|| Value::Object(message).to_string())
    }

    /// Summaries that differ from those the page has; the ages of all on a beat.
    fn add_faces(&mut self, network: &Network, beat: bool, message: &mut Map<String, Value>) {
        let summaries = network.summaries();
        let first = self.faces.is_empty();
        let differ = summaries.iter().filter(|summary| self.faces.get(&summary.face.id) != Some(&summary.face));
        let changed: Vec<Value> = differ.map(|summary| json!(summary)).collect();
        if !changed.is_empty() {
            message.insert("net".into(), json!(changed));
        }
        if beat && !first {
            let ages = summaries.iter().map(|summary| (summary.face.id.clone(), json!(summary.ages)));
            message.insert("ages".into(), Value::Object(ages.collect()));
        }
        self.faces = summaries.iter().map(|summary| (summary.face.id.clone(), summary.face.clone())).collect();
    }

    /// Payloads of the shown telescope (and of what its site shares) after the revision that the page has.
    fn add_states(&mut self, network: &Network, message: &mut Map<String, Value>) {
        let seen = self.seen.unwrap_or(0);
        let model = network.read();
        let first = self.seen.replace(model.revision).is_none();
        let Some(address) = &self.telescope else { return };
        let shared = address.shared();
        let shown = [address, &shared].into_iter().filter_map(|address| model.telescopes.get(address));
        let (mut whole, mut again, mut log) = (Map::new(), Map::new(), Vec::new());
        for telescope in shown {
            whole.extend(states(telescope.states.iter().filter(|(_, entry)| first || entry.changed > seen), network));
            let now = network.clock().machine();
            let repeated = telescope.states.iter().filter(|(_, e)| !first && e.changed <= seen && e.revision > seen);
            again.extend(
                repeated.map(|(name, entry)| (name.clone(), json!([entry.age(now).as_secs_f64(), entry.at_utc]))),
            );
            log.extend(telescope.diary.after(if first { 0 } else { seen }).map(|line| json!(line)));
        }
        if first || !whole.is_empty() {
            message.insert("states".into(), Value::Object(whole));
        }
        if !again.is_empty() {
            message.insert("again".into(), Value::Object(again));
        }
        if first || !log.is_empty() {
            message.insert("log".into(), Value::Array(log));
        }
    }
}

#[cfg(test)]
mod tests {
    use bus::Clock;

    use super::*;
    use crate::model::tests::heard;

    fn network() -> Network {
        Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap())
    }

    fn next(view: &mut View, network: &Network, beat: bool) -> Option<Value> {
        view.next(network, beat).map(|text| serde_json::from_str(&text).unwrap())
    }

    const DOME: &str = "paranal/callisto/device/dome/d/state";

    #[test]
    fn a_slow_page_gets_the_newest_value_of_each_key_once() {
        let network = network();
        let mut view = View::of(Some("paranal/callisto"));
        network.accept(heard(DOME, "b", 0, 1, json!({"n": 0})));
        let snap = next(&mut view, &network, true).unwrap();
        assert_eq!((&snap["op"], &snap["states"][DOME]["body"]["n"]), (&json!("snap"), &json!(0)));
        for n in 1..=1000 {
            network.accept(heard(DOME, "b", n, 1 + n, json!({ "n": n })));
        }
        let delta = next(&mut view, &network, false).unwrap();
        assert_eq!(delta["states"].as_object().unwrap().len(), 1);
        assert_eq!(delta["states"][DOME]["body"]["n"], 1000);
        assert_eq!(next(&mut view, &network, false), None, "nothing new, nothing sent");
    }

    #[test]
    fn a_repeat_sends_only_its_age() {
        let network = network();
        let mut view = View::of(Some("paranal/callisto"));
        network.accept(heard(DOME, "b", 0, 1, json!({"n": 0})));
        next(&mut view, &network, true);
        network.accept(heard(DOME, "b", 1, 2, json!({"n": 0})));
        let delta = next(&mut view, &network, false).unwrap();
        assert!(delta.get("states").is_none() && delta["again"][DOME][0].is_number(), "{delta}");
    }

    #[test]
    fn a_page_sees_its_telescope_and_what_the_site_shares_but_no_neighbour() {
        let network = network();
        for telescope in ["callisto", "shared", "io"] {
            network.accept(heard(&format!("paranal/{telescope}/device/dome/d/state"), "b", 0, 1, json!({})));
        }
        let snap = next(&mut View::of(Some("paranal/callisto")), &network, true).unwrap();
        let keys: Vec<&String> = snap["states"].as_object().unwrap().keys().collect();
        assert_eq!(keys, [DOME, "paranal/shared/device/dome/d/state"]);
        assert_eq!(snap["net"].as_array().unwrap().len(), 3, "tiles of all");
        let overview = next(&mut View::of(None), &network, true).unwrap();
        assert!(overview.get("states").is_none());
    }

    #[test]
    fn a_beat_comes_though_nothing_changed_and_log_lines_come_once() {
        let network = network();
        let mut view = View::of(Some("paranal/callisto"));
        next(&mut view, &network, true);
        assert_eq!(next(&mut view, &network, true).unwrap()["op"], "beat");
        let line = json!({"level": "info", "target": "t", "message": "<script>"});
        network.accept(heard("paranal/callisto/node/device/main/diary", "b", 0, 1, line));
        let delta = next(&mut view, &network, false).unwrap();
        assert_eq!(delta["log"][0]["message"], "<script>");
        assert_eq!(delta["log"][0]["node"], "device/main");
        assert_eq!(next(&mut view, &network, false), None);
    }
}
