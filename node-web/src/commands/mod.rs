//! Commands over HTTP: what a person orders becomes a resource that can be followed from its acceptance to its end.
//!
//! The web node decides nothing: the observatory node accepts or refuses, and this node checks the right of the caller
//! before it asks. A command's id follows from the caller, the telescope, the caller's own key and the body, so that a
//! repeat is the same order also after a restart of this node, and is done once.

mod legacy;
mod offered;

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use contract::order_form::{BadOrder, LONGEST_REASON, OrderForm};
use contract::{Address, CommandId, Order, Reason, Refusal};
use orders::{Follower, NotAccepted, NotClosed, NotDone, TakenBy};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use sha2::{Digest as _, Sha256};
use units::Utc;
use users::{Principal, Way};

use crate::authentication::Client;
use crate::command_store::{Command, CommandState, Progress, Stored};
use crate::json_body::{AskedFor, JsonBody};
use crate::problem::{Code, Problem};
use crate::routes::network::{NEVER_CACHED, known};
use crate::server::Server;

pub use self::legacy::{LegacyOrdered, legacy_close, legacy_cool, legacy_headers, legacy_start, legacy_stop};
pub use self::offered::{OrderOffered, catalog};

/// So long an order is given that nobody answers.
const WITHIN: Duration = Duration::from_secs(3);
/// An answer or its absence is known by then: the last question begins after a pause, and may wait for a state first.
const ANSWERED_WITHIN: Duration = Duration::from_secs(12);
/// The time for a telescope to be verified closed, where the caller names none, s.
const USUAL_DEADLINE_S: f64 = 300.0;
const LONGEST_DEADLINE_S: f64 = 3600.0;
const LONGEST_KEY: usize = 100;
/// The word of the order that a dome's device node carries out as a whole.
const CLOSE: &str = "close";
/// The longest body of a request: a schedule of the largest size, in JSON.
const LONGEST_BODY: usize = 2 << 20;
/// An answer is held back for so long at most.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// What is ordered.
#[derive(Debug, Clone, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandRequest {
    /// The order's word, such as `close`; the catalogue has all.
    pub command: String,
    /// Its parameters.
    #[serde(default)]
    pub parameters: Map<String, Value>,
    /// Why, for those who read the log; some orders need it.
    #[serde(default)]
    pub reason: String,
    /// The person who orders, where this server asks nobody to sign in.
    pub operator: Option<String>,
    /// An order that closes has failed when the telescope is not verified closed in so many seconds; 300 where absent.
    pub deadline_s: Option<f64>,
}

/// Which commands.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandsQuery {
    /// Of this telescope only, as `site/telescope`.
    telescope: Option<String>,
    /// At most so many; 100 where absent.
    limit: Option<u16>,
}

/// Gives an order.
pub async fn give(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Extension(client): Extension<Client>,
    Path((site, telescope)): Path<(String, String)>,
    headers: HeaderMap,
    JsonBody(request): JsonBody<CommandRequest, LONGEST_BODY>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    carry_out(&server, &caller, client, address, &headers, request).await
}

/// Was a command given with the key of this request before?
pub fn is_repeat(server: &Server, caller: &Principal, address: &Address, headers: &HeaderMap) -> Result<bool, Problem> {
    let key = idempotency_key(headers)?;
    Ok(server.commands.knows(&(caller.name.clone(), address.to_string(), key.to_owned())))
}

/// Gives the order of a request, or finds the command that it was before.
///
/// # Errors
/// What is wrong with it, and the refusal of the observatory node.
pub async fn carry_out(
    server: &Arc<Server>,
    caller: &Principal,
    client: Client,
    address: Address,
    headers: &HeaderMap,
    request: CommandRequest,
) -> Result<Response, Problem> {
    let key = idempotency_key(headers)?;
    answer(order(server, caller, &client, address, (key, request), wait(headers)).await?)
}

/// Gives an order under its key, and looks how far it is: when it is answered, or after the time that the caller wants to
/// wait.
async fn order(
    server: &Arc<Server>,
    caller: &Principal,
    client: &Client,
    address: Address,
    (key, request): (&str, CommandRequest),
    wait: Option<Duration>,
) -> Result<CommandState, Problem> {
    let form = OrderForm::of(&request.command).map_err(|error| invalid(&error))?;
    if caller.right_at(&address) < Some(form.right) {
        let detail = format!("{caller} may not order {}: it needs the right {} at {address}.", form.word, form.right);
        return Err(Problem::forbidden(detail).with("required_right", json!(form.right)));
    }
    let kind = form.fill(&request.parameters, &request.reason).map_err(|error| invalid(&error))?;
    let deadline_s = request.deadline_s.unwrap_or(USUAL_DEADLINE_S);
    if !(1.0..=LONGEST_DEADLINE_S).contains(&deadline_s) {
        let detail = format!("deadline_s: expected a number of seconds from 1 to {LONGEST_DEADLINE_S}.");
        return Err(Problem::invalid(detail));
    }
    let person = person(caller, request.operator.as_deref())?;
    let body = json!([request.command, request.parameters, request.reason, request.operator, deadline_s]).to_string();
    let id = id(&[&caller.name, &address.to_string(), key, &body]);
    let order = Order {
        id: id.clone(),
        from: format!("web/{person}@{}", client.address),
        reason: request.reason.clone(),
        kind,
        seen: None,
    };
    let parameters = brief(request.parameters);
    let against = match form.closes {
        true => Vec::new(),
        false => offered::against_now(server, form, &address),
    };
    let utc = server.network.clock().utc();
    let state = CommandState::sent(&order, &address, form.word, parameters, &person, against, utc);
    let command = match server.commands.begin((caller.name.clone(), address.to_string(), key.to_owned()), state) {
        Stored::New(command) => {
            match server.seconds.check(&order, server.bus.boot_id(), server.bus.clock().machine()) {
                Err(why) => command.refuse(Reason::NotNow, why, server.network.clock().utc()),
                Ok(()) => {
                    let deadline = Duration::from_secs_f64(deadline_s);
                    tokio::spawn(follow(server.clone(), command.clone(), address, order, form, deadline));
                }
            }
            command
        }
        Stored::Again(command) if command.now().id == id => command,
        Stored::Again(_) => {
            let detail = "This Idempotency-Key was used for another command; choose a new one for each.";
            return Err(Problem::invalid(detail).with("errors", json!([{"pointer": "/", "message": detail}])));
        }
    };
    Ok(match wait {
        Some(time) => command.until(time, CommandState::has_ended).await,
        None => command.until(ANSWERED_WITHIN, CommandState::is_answered).await,
    })
}

/// The parameters as they are remembered: a schedule by its length.
fn brief(mut parameters: Map<String, Value>) -> Map<String, Value> {
    for value in parameters.values_mut() {
        if let Some(length) = value.as_str().map(|text| text.chars().count()).filter(|length| *length > LONGEST_REASON)
        {
            *value = json!(format!("{length} characters"));
        }
    }
    parameters
}

/// Gives the order and follows it to its end; goes on when the caller has left.
async fn follow(
    server: Arc<Server>,
    command: Arc<Command>,
    address: Address,
    order: Order,
    form: &'static OrderForm,
    deadline: Duration,
) {
    let utc = || server.network.clock().utc();
    if form.closes {
        return close(&server, &command, &address, &order, form, deadline).await;
    }
    match orders::give_until_answered(&server.bus, &address, &order, WITHIN, orders::ask_again).await {
        Ok(_) => command.note(Progress::Done, None, utc()),
        Err(error) => not_accepted(&command, error, utc()),
    }
}

fn not_accepted(command: &Command, error: NotAccepted, at_utc: Utc) {
    match error {
        NotAccepted::Refused(Refusal { reason, detail, .. }) => command.refuse(reason, detail, at_utc),
        error @ NotAccepted::NotWritten { .. } => command.note(Progress::Failed, Some(error.to_string()), at_utc),
        error => command.note(Progress::Unknown, Some(error.to_string()), at_utc),
    }
}

/// Gives an order that closes: to the observatory node, or where that is silent to the device nodes of the domes.
async fn close(
    server: &Server,
    command: &Command,
    address: &Address,
    order: &Order,
    form: &OrderForm,
    deadline: Duration,
) {
    let utc = || server.network.clock().utc();
    // The subscriptions begin before the order is given, so that no effect is missed.
    let follower = match Follower::open(&server.bus, address).await {
        Ok(follower) => follower,
        Err(error) => return command.note(Progress::Unknown, Some(error.to_string()), utc()),
    };
    let given_utc = utc();
    let taken = |taken: &TakenBy| {
        // One that was late has failed until it is closed after all.
        if !command.now().has_ended() {
            command.note(Progress::Accepted, taken.warning().map(str::to_owned), utc());
        }
    };
    let late = |late: &NotClosed| command.note(Progress::Failed, Some(late.to_string()), utc());
    let times = (deadline, orders::GIVEN_ON);
    let mut taken = match orders::close_and_go_on(&server.bus, &follower, order, times, taken, late).await {
        Ok(taken) => taken,
        Err(NotDone::NotAccepted(error)) => {
            let is_silence = error.is_silence();
            not_accepted(command, error, utc());
            if !is_silence {
                return;
            }
            // An observatory node that hangs may carry it out later.
            let Ok(taken) = follower.until_closed(order, given_utc, deadline).await else { return };
            taken
        }
        Err(error) => return command.note(Progress::Failed, Some(error.to_string()), utc()),
    };
    loop {
        let closed = taken.closed_words();
        let Some(warning) = taken.warning() else { return command.note(Progress::Done, Some(closed), utc()) };
        // The domes close, and do nothing else that was ordered.
        let progress = if form.word == CLOSE { Progress::Done } else { Progress::Failed };
        command.note(progress, Some(format!("{closed}, but {warning}")), utc());
        let taken_now = |_: &TakenBy| {
            let detail = format!("{closed}; the observatory node answers now, and has taken the order");
            command.note(progress, Some(detail), utc());
        };
        let times = (orders::GIVEN_ON, deadline);
        taken = match orders::give_on(&server.bus, &follower, order, times, taken_now).await {
            Ok(taken) => taken,
            Err(error @ (NotDone::NotClosed(_) | NotDone::NotWritten { .. })) => {
                return command.note(Progress::Failed, Some(error.to_string()), utc());
            }
            Err(error @ NotDone::Replaced(_)) => {
                return command.note(progress, Some(format!("{closed}; {error}")), utc());
            }
            // It adds nothing to what was noted.
            Err(NotDone::NotAccepted(_)) => return,
        };
    }
}

/// Commands that this node took.
pub async fn list(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<CommandsQuery>,
) -> Result<Response, Problem> {
    let commands = server.commands.newest(query.limit.unwrap_or(100).into(), |command| {
        caller.right_at(&command.telescope).is_some()
            && query.telescope.as_ref().is_none_or(|wanted| *wanted == command.telescope.to_string())
    });
    Ok((NEVER_CACHED, Json(commands)).into_response())
}

/// One command.
pub async fn one(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    // A caller without a right at its telescope does not learn that it is there.
    let is_it = |command: &CommandState| command.id.0 == id && caller.right_at(&command.telescope).is_some();
    let command = server.commands.newest(1, is_it).pop();
    let detail = "This web node remembers no such command: it remembers its own, for 24 hours and until its restart. The same request \
                  with the same Idempotency-Key finds out what became of it; the telescope's audit has all.";
    let command = command.ok_or_else(|| Problem::not_found(detail))?;
    Ok((NEVER_CACHED, Json(command)).into_response())
}

fn answer(state: CommandState) -> Result<Response, Problem> {
    let state = unless_refused(state)?;
    let headers = [(header::LOCATION, location(&state))];
    Ok((StatusCode::ACCEPTED, NEVER_CACHED, headers, Json(state)).into_response())
}

fn location(state: &CommandState) -> String {
    format!("/api/v1/commands/{}", state.id)
}

/// The state of a command that was taken.
fn unless_refused(state: CommandState) -> Result<CommandState, Problem> {
    let telescope = state.telescope.to_string();
    let detail = state.detail.clone().unwrap_or_default();
    let problem = match (state.state, state.refused_because) {
        (Progress::Refused, Some(Reason::WrongState)) if state.parameters.contains_key("instead_of") => {
            Problem::new(Code::Precondition, "Another schedule is in force", detail)
        }
        (Progress::Refused, Some(Reason::Malformed)) => Problem::invalid(detail),
        (Progress::Refused, _) => Problem::new(Code::Refused, "The telescope refuses the command", detail),
        (Progress::Unknown, _) => {
            let detail = format!("{detail}. Look at the telescope's state before you order again.");
            let title = "Nobody answered for the telescope";
            Problem::new(Code::CommandUnacknowledged, title, detail)
        }
        (Progress::Sent | Progress::Accepted | Progress::Done | Progress::Failed, _) => return Ok(state),
    };
    let problem = match state.refused_because {
        Some(reason) => problem.with("reason", json!(reason)),
        None => problem,
    };
    Err(problem.with("telescope", json!(telescope)).with("instance", json!(location(&state))))
}

/// What `Prefer: wait=N` asks for.
fn wait(headers: &HeaderMap) -> Option<Duration> {
    let prefer = headers.get("prefer")?.to_str().ok()?;
    let seconds = prefer.split([',', ';']).find_map(|word| word.trim().strip_prefix("wait="))?;
    Some(Duration::from_secs(seconds.parse().ok()?).min(LONGEST_WAIT))
}

fn idempotency_key(headers: &HeaderMap) -> Result<&str, Problem> {
    let key = headers.get("idempotency-key").and_then(|key| key.to_str().ok()).map(str::trim).unwrap_or_default();
    if key.is_empty() || key.len() > LONGEST_KEY {
        let detail = format!(
            "Idempotency-Key: expected a header with a text that is new for each command, 1 to {LONGEST_KEY} characters, so that a \
             repeat of the request does not act twice."
        );
        return Err(Problem::malformed(detail));
    }
    Ok(key)
}

/// The person who orders: whoever signed in, or where nobody does, whom the request names.
fn person(caller: &Principal, operator: Option<&str>) -> Result<String, Problem> {
    let name = match operator.map(str::trim).filter(|name| !name.is_empty()) {
        None => caller.name.clone(),
        Some(name) if caller.way == Way::Open => name.to_owned(),
        Some(name) if name == caller.name => name.to_owned(),
        Some(_) => {
            return Err(Problem::invalid(format!("operator: you are signed in as {caller}; leave it out.")));
        }
    };
    if name.contains(['/', '@']) || name.chars().any(char::is_control) || name.len() > 63 {
        return Err(Problem::invalid(
            "operator: expected a name without '/' and '@', at most 63 characters, such as ana.",
        ));
    }
    Ok(name)
}

fn id(parts: &[&str]) -> CommandId {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_be_bytes());
        hash.update(part);
    }
    let hash = hash.finalize();
    CommandId(format!("web-{}", hash[..16].iter().map(|byte| format!("{byte:02x}")).collect::<String>()))
}

fn invalid(error: &BadOrder) -> Problem {
    let pointer = match error {
        BadOrder::Unknown { .. } => "/command".to_owned(),
        BadOrder::Parameter { parameter, .. } => format!("/parameters/{parameter}"),
        BadOrder::Reason { .. } | BadOrder::LongReason { .. } => "/reason".to_owned(),
    };
    let message = error.to_string();
    Problem::invalid(message.clone()).with("errors", json!([{ "pointer": pointer, "message": message }]))
}
