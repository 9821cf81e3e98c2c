//! The two sockets that pages and scripts of Astra's users open, `/ws` and `/ws/log`: of one telescope, each second the whole
//! state, or the lines of the log that are new.

use std::sync::Arc;

use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Extension, Query, State};
use axum::response::Response;
use contract::node::Level;
use contract::observatory::ScheduleState;
use contract::{Address, Key, Part};
use serde_json::{Value, json};
use tokio::time::MissedTickBehavior;
use users::Principal;

use super::{BEAT, Leave, Speech, Visitor, admit, send_text, tables};
use crate::network::{lines, logs};
use crate::problem::Problem;
use crate::routes::legacy::{LegacyLine, LegacyQuery, the_telescope};
use crate::server::Server;

/// The newest lines that a program gets at first.
const FIRST_LINES: usize = 100;

/// What is sent each second.
pub enum Stream {
    /// The whole state.
    Tables,
    /// What is new in the log.
    Log(LogPosition),
}

/// What a program has of the log, and of the schedule.
#[derive(Default)]
pub struct LogPosition {
    /// Number of the last line; absent before the first message.
    seen: Option<u64>,
    /// Version of the schedule, and when it was first seen, s.
    schedule: Option<(u64, f64)>,
}

type Upgrade = Result<WebSocketUpgrade, WebSocketUpgradeRejection>;

/// `/ws`.
pub async fn open_tables(
    server: State<Arc<Server>>,
    caller: Extension<Principal>,
    query: Query<LegacyQuery>,
    visitor: Visitor,
    upgrade: Upgrade,
) -> Result<Response, Problem> {
    open(server, caller, query, visitor, upgrade, Stream::Tables)
}

/// `/ws/log`.
pub async fn open_log(
    server: State<Arc<Server>>,
    caller: Extension<Principal>,
    query: Query<LegacyQuery>,
    visitor: Visitor,
    upgrade: Upgrade,
) -> Result<Response, Problem> {
    open(server, caller, query, visitor, upgrade, Stream::Log(LogPosition::default()))
}

fn open(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Query(query): Query<LegacyQuery>,
    visitor: Visitor,
    upgrade: Upgrade,
    stream: Stream,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let upgrade = upgrade.map_err(|rejection| {
        Problem::malformed(format!("This address is opened as a WebSocket: {}.", rejection.body_text()))
    })?;
    Ok(admit(server, visitor, upgrade, Speech::Legacy(address, stream)))
}

/// Sends each second until the program leaves, or its user may no longer see the telescope.
pub async fn serve(
    socket: &mut WebSocket,
    server: &Server,
    address: &Address,
    mut stream: Stream,
    caller: impl Fn() -> Option<Principal>,
) -> Leave {
    let mut tick = tokio::time::interval(BEAT);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = tick.tick() => {
                let Some(caller) = caller() else { return Leave::Unauthenticated };
                if caller.right_at(address).is_none() {
                    return Leave::Forbidden;
                }
                let document = stream.next(server, address, &caller);
                if let Err(leave) = send_text(socket, document.to_string()).await {
                    return leave;
                }
            }
            // Nothing is expected of the program; the library answers pings by itself.
            message = socket.recv() => if matches!(message, None | Some(Err(_) | Ok(Message::Close(_)))) {
                return Leave::Gone;
            },
        }
    }
}

impl Stream {
    fn next(&mut self, server: &Server, address: &Address, caller: &Principal) -> Value {
        let clock = server.network.clock();
        match self {
            Self::Tables => {
                let usage = server.host.usage();
                tables::document(&server.network.read(), address, usage, clock.machine(), clock.utc())
            }
            Self::Log(position) => position.next(server, address, caller),
        }
    }
}

impl LogPosition {
    /// Lines have numbers, so that none is missed or repeated where several have the same time.
    fn next(&mut self, server: &Server, address: &Address, caller: &Principal) -> Value {
        let model = server.network.read();
        let before = self.seen.replace(model.revision);
        let lines = lines(&model, caller, Some(address), Level::Info, before.unwrap_or(0));
        let first = if before.is_none() { lines.len().saturating_sub(FIRST_LINES) } else { 0 };
        let forgotten = logs(&model, caller, Some(address)).map(|(_, one)| one.diary.forgotten(Level::Info)).max();
        let gap = before.zip(forgotten).filter(|(before, forgotten)| before < forgotten);
        let gap = gap.map(|_| LegacyLine::of_a_gap(server.network.clock().utc(), address));
        let lines = lines.into_iter().skip(first).map(|(_, line)| LegacyLine::of(line));
        let log: Vec<LegacyLine> = gap.into_iter().chain(lines).collect();

        let key = Key::Observatory(address.clone(), Part::Schedule);
        let schedule = model.telescopes.get(address).and_then(|one| one.read::<ScheduleState>(&key));
        if let Some((entry, schedule)) = schedule
            && self.schedule.is_none_or(|(revision, _)| revision != schedule.revision)
        {
            self.schedule = Some((schedule.revision, entry.at_utc.seconds()));
        }
        json!({ "log": log, "schedule_mtime": self.schedule.map_or(0.0, |(_, since_s)| since_s) })
    }
}
