//! The live socket: a program subscribes to topics and gets a snapshot of each, then what changes, and a beat every
//! second. docs/api.md describes it for programs.
//!
//! A slow program never makes the server wait or store for it: it gets less often what it can take (`subscription`), is
//! notified of what it missed of things that happened, and is let go when it takes nothing for 10 s or misses too much.

mod legacy;
mod message;
mod subscription;
mod tables;
mod topic;

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, State};
use axum::response::{IntoResponse, Response};
use contract::Address;
use local_http::{Peer, Room};
use serde_json::{Value, json};
use users::Principal;

use crate::authentication::{Authentication, Credential};
use crate::problem::{Code, Problem};
use crate::server::Server;
use message::{ClientMessage, Kind, Resume, ServerMessage};
use subscription::Subscription;
use topic::Topic;

pub use legacy::{open_log, open_tables};
pub use message::document;

/// How often it is looked for changes.
const TICK: Duration = Duration::from_millis(100);
const BEAT: Duration = Duration::from_secs(1);
/// Changes of a topic per second, and what a program may ask for.
const RATE_HZ: f64 = 5.0;
const RATES_HZ: std::ops::RangeInclusive<f64> = 0.1..=10.0;
/// Several topics of each of the 50 telescopes of a network.
const MOST_TOPICS: usize = 256;
/// The longest message of a program: so many topics, each with the number after which it goes on.
const MOST_BYTES: usize = 32 << 10;
const STALLED_AFTER: Duration = Duration::from_secs(10);
/// A program that missed things so often within a minute is let go.
const MOST_GAPS: usize = 3;
const MINUTE: Duration = Duration::from_secs(60);
/// Pages that may be open: those of one address cannot take all, and there is room left for operators on this host.
pub const ROOM: Room = Room { total: 200, per_address: 40, trusted: 40 };

/// Why the server closes a socket.
enum Leave {
    /// The program left, or nothing can be sent to it.
    Gone,
    /// Its user was logged out, removed or has expired.
    Unauthenticated,
    /// Its user has lost the right at its telescope.
    Forbidden,
    /// It takes too little.
    TooSlow,
}

/// The program that opens a socket.
type Visitor = (Extension<Peer>, Extension<Authentication>, Extension<Credential>);

/// What a socket speaks.
enum Speech {
    /// Topics, as docs/api.md describes them.
    Topics,
    /// What Astra's sockets sent of one telescope.
    Legacy(Address, legacy::Stream),
}

/// Opens the socket for a page of ours or a program; `authentication` has refused pages of other servers.
pub async fn open(State(server): State<Arc<Server>>, visitor: Visitor, upgrade: WebSocketUpgrade) -> Response {
    admit(server, visitor, upgrade, Speech::Topics)
}

/// Gives a socket one of the places, until it leaves or the node stops.
fn admit(server: Arc<Server>, visitor: Visitor, upgrade: WebSocketUpgrade, speech: Speech) -> Response {
    let (Extension(Peer(peer)), Extension(authentication), Extension(credential)) = visitor;
    let Some(place) = server.sockets.take(peer) else {
        let Room { total, per_address, .. } = ROOM;
        let detail = format!("{per_address} pages of one address may be open, and {total} of all.");
        return Problem::new(Code::Busy, "Too many pages", detail).into_response();
    };
    upgrade.max_message_size(MOST_BYTES).max_frame_size(MOST_BYTES).on_upgrade(move |mut socket| async move {
        let _watching = server.previews.watch();
        let caller = || authentication.principal(&credential).ok();
        let served = async {
            let leave = match speech {
                Speech::Topics => serve(&mut socket, &server, caller).await,
                Speech::Legacy(address, stream) => legacy::serve(&mut socket, &server, &address, stream, caller).await,
            };
            let (code, reason) = match leave {
                Leave::Gone => return,
                Leave::Forbidden => (4003, "the right at this telescope was taken away"),
                Leave::Unauthenticated => (4001, "log in again"),
                Leave::TooSlow => (4008, "too slow: subscribe to less, or ask for fewer changes with max_rate_hz"),
            };
            let close = Message::Close(Some(CloseFrame { code, reason: reason.into() }));
            let _ = tokio::time::timeout(BEAT, socket.send(close)).await;
        };
        server.stop.or(served).await;
        drop(place);
    })
}

/// A program at its socket.
struct Subscriber<'a> {
    server: &'a Server,
    /// Sees what its rights let it see.
    caller: Principal,
    subscriptions: Vec<Subscription>,
    /// Time between two changes of a topic.
    pause: Duration,
    gaps: VecDeque<Instant>,
}

/// Sends until the program leaves, or until its user is logged out, removed or expired.
async fn serve(socket: &mut WebSocket, server: &Server, caller: impl Fn() -> Option<Principal>) -> Leave {
    let Some(known) = caller() else { return Leave::Unauthenticated };
    let mut subscriber = Subscriber {
        server,
        caller: known,
        subscriptions: Vec::new(),
        pause: Duration::from_secs_f64(1.0 / RATE_HZ),
        gaps: VecDeque::new(),
    };
    if let Err(leave) = send(socket, &[subscriber.welcome()]).await {
        return leave;
    }
    let mut tick = tokio::time::interval(TICK);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let (mut beat, mut last_sent) = (Instant::now(), None::<Instant>);
    loop {
        let messages = tokio::select! {
            _ = tick.tick() => {
                let is_beat = beat.elapsed() >= BEAT;
                if is_beat {
                    let Some(known) = caller() else { return Leave::Unauthenticated };
                    beat = Instant::now();
                    let ended = subscriber.has_rights_of(known);
                    if let Err(leave) = send(socket, &ended).await {
                        return leave;
                    }
                }
                let is_due = last_sent.is_none_or(|last_sent| last_sent.elapsed() + TICK / 4 >= subscriber.pause);
                let mut messages = if is_due || is_beat { subscriber.changes(is_beat) } else { Vec::new() };
                if !messages.is_empty() {
                    last_sent = Some(Instant::now());
                }
                if subscriber.misses_too_much(&messages) {
                    let _ = send(socket, &messages).await;
                    return Leave::TooSlow;
                }
                if is_beat {
                    messages.push(subscriber.message(Kind::Beat, json!({ "speed": server.network.clock().speed() })));
                }
                messages
            }
            message = socket.recv() => match message {
                None | Some(Err(_)) | Some(Ok(Message::Close(_))) => return Leave::Gone,
                Some(Ok(Message::Text(text))) => subscriber.take(&text),
                // The library answers pings by itself.
                Some(Ok(Message::Binary(_) | Message::Ping(_) | Message::Pong(_))) => Vec::new(),
            },
        };
        if let Err(leave) = send(socket, &messages).await {
            return leave;
        }
    }
}

async fn send(socket: &mut WebSocket, messages: &[ServerMessage]) -> Result<(), Leave> {
    for message in messages {
        send_text(socket, serde_json::to_string(message).unwrap_or_default()).await?;
    }
    Ok(())
}

async fn send_text(socket: &mut WebSocket, text: String) -> Result<(), Leave> {
    match tokio::time::timeout(STALLED_AFTER, socket.send(Message::Text(Utf8Bytes::from(text)))).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(Leave::Gone),
        Err(_) => {
            tracing::debug!("a program took nothing for 10 s and was let go");
            Err(Leave::TooSlow)
        }
    }
}

impl Subscriber<'_> {
    fn message(&self, op: Kind, data: Value) -> ServerMessage {
        ServerMessage { op, topic: None, seq: None, at_utc: self.server.network.clock().utc(), data }
    }

    fn error(&self, topic: Option<&str>, problem: Problem) -> ServerMessage {
        ServerMessage { topic: topic.map(str::to_owned), ..self.message(Kind::Err, json!(problem.document())) }
    }

    fn welcome(&self) -> ServerMessage {
        self.message(
            Kind::Welcome,
            json!({
                "session": self.server.bus.boot_id(),
                "version": env!("CARGO_PKG_VERSION"),
                "speed": self.server.network.clock().speed(),
                "heartbeat_s": BEAT.as_secs_f64(),
                "most_topics": MOST_TOPICS,
            }),
        )
    }

    /// What each subscription lacks.
    fn changes(&mut self, is_beat: bool) -> Vec<ServerMessage> {
        let Server { network, commands, .. } = self.server;
        let caller = &self.caller;
        self.subscriptions.iter_mut().flat_map(|one| one.next(network, commands, caller, is_beat)).collect()
    }

    /// Takes a message of the program; returns what is answered at once.
    fn take(&mut self, text: &str) -> Vec<ServerMessage> {
        match serde_json::from_str(text) {
            Ok(ClientMessage::Sub { topics, resume, max_rate_hz }) => {
                if let Some(rate) = max_rate_hz {
                    let rate = if rate.is_finite() { rate.clamp(*RATES_HZ.start(), *RATES_HZ.end()) } else { RATE_HZ };
                    self.pause = Duration::from_secs_f64(1.0 / rate);
                }
                let topics: BTreeSet<String> = topics.into_iter().collect();
                topics.iter().flat_map(|topic| self.subscribe(topic, resume.as_ref())).collect()
            }
            Ok(ClientMessage::Unsub { topics }) => {
                self.subscriptions.retain(|one| !topics.iter().any(|topic| topic == one.name()));
                Vec::new()
            }
            Ok(ClientMessage::Ping { t }) => vec![self.message(Kind::Pong, json!({ "t": t }))],
            Err(error) => {
                let expected = "expected {\"op\": \"sub\" or \"unsub\", \"topics\": [...]} or {\"op\": \"ping\"}";
                vec![self.error(None, Problem::malformed(format!("{error}; {expected}")))]
            }
        }
    }

    /// Begins a subscription, or begins it anew; the first messages are returned, so that the program need not wait.
    fn subscribe(&mut self, name: &str, resume: Option<&Resume>) -> Vec<ServerMessage> {
        let topic = match Topic::read(name) {
            Ok(topic) => topic,
            Err(why) => return vec![self.error(Some(name), Problem::invalid(why))],
        };
        if let Some(address) = topic.telescope().filter(|address| self.caller.right_at(address).is_none()) {
            let detail = format!("{} has no right at {address}.", self.caller.name);
            return vec![self.error(Some(name), Problem::forbidden(detail))];
        }
        self.subscriptions.retain(|one| one.name() != name);
        if let Some(same) = self.subscriptions.iter().find(|one| one.is_of(&topic)) {
            let detail = format!("This socket has the topic already, as {:?}.", same.name());
            return vec![self.error(Some(name), Problem::invalid(detail))];
        }
        if self.subscriptions.len() >= MOST_TOPICS {
            let detail =
                format!("One socket may have {MOST_TOPICS} topics; end some with unsub, or open another socket.");
            return vec![self.error(Some(name), Problem::invalid(detail))];
        }
        let Server { network, commands, bus, .. } = self.server;
        let is_same = |resume: &&Resume| resume.session == bus.boot_id().to_string();
        let seen = resume.filter(is_same).and_then(|resume| resume.seq.get(name).copied());
        // A number that was never given would hide what comes until it is reached.
        let seen = seen.filter(|seen| *seen <= network.read().revision);
        let mut subscription = Subscription::new(topic, name.to_owned(), seen);
        let first = subscription.next(network, commands, &self.caller, false);
        self.subscriptions.push(subscription);
        first
    }

    /// Rights may have been given or taken: what is no longer visible ends, and all else begins anew, since lines may have
    /// passed that the program was not to see.
    fn has_rights_of(&mut self, caller: Principal) -> Vec<ServerMessage> {
        if self.caller.grants == caller.grants {
            return Vec::new();
        }
        self.caller = caller;
        let may_see = |address: &Address| self.caller.right_at(address).is_some();
        let (mut visible, ended): (Vec<_>, Vec<_>) =
            self.subscriptions.drain(..).partition(|one| one.telescope().is_none_or(may_see));
        visible.iter_mut().for_each(Subscription::begin_anew);
        self.subscriptions = visible;
        let why =
            || Problem::forbidden("The right at the telescope of this topic was taken away; the topic has ended.");
        ended.iter().map(|one| self.error(Some(one.name()), why())).collect()
    }

    /// What a program missed while it was away does not count: it cannot take that faster.
    fn misses_too_much(&mut self, messages: &[ServerMessage]) -> bool {
        if messages.iter().any(|message| message.op == Kind::Gap) {
            self.gaps.push_back(Instant::now());
        }
        self.gaps.retain(|at| at.elapsed() < MINUTE);
        self.gaps.len() > MOST_GAPS
    }
}
