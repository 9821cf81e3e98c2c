//! Orders at the addresses of Astra, which took no body: each is one of today's orders, with the same rights and the same record.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, Query, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse as _, Response};
use contract::CommandId;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};
use users::Principal;

use super::{CommandRequest, idempotency_key, location, order, unless_refused, wait};
use crate::authentication::Client;
use crate::command_store::Progress;
use crate::problem::Problem;
use crate::routes::legacy::{LegacyQuery, instead, the_telescope};
use crate::server::Server;

/// An order that was taken, as Astra answered; what becomes of it is at `/api/v1/commands/ID`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacyOrdered {
    status: &'static str,
    /// Always the text `null`.
    data: &'static str,
    message: String,
    command_id: CommandId,
    /// How far it is.
    state: Progress,
}

type TheServer = State<Arc<Server>>;
type Who = (Extension<Principal>, Extension<Client>);

/// `POST /api/close`.
pub async fn legacy_close(
    server: TheServer,
    who: Who,
    query: Query<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    give(server, who, query, headers, ("close", Map::new())).await
}

/// `POST /api/cool_camera/{device_name}`.
pub async fn legacy_cool(
    server: TheServer,
    who: Who,
    Path(camera): Path<String>,
    query: Query<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let parameters = Map::from_iter([("camera".to_owned(), json!(camera))]);
    give(server, who, query, headers, ("cool", parameters)).await
}

/// `POST /api/complete_headers`.
pub async fn legacy_headers(
    server: TheServer,
    who: Who,
    query: Query<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    give(server, who, query, headers, ("complete-headers", Map::new())).await
}

/// `POST /api/startschedule`.
pub async fn legacy_start(
    server: TheServer,
    who: Who,
    query: Query<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    give(server, who, query, headers, ("start", Map::new())).await
}

/// `POST /api/stopschedule`.
pub async fn legacy_stop(
    server: TheServer,
    who: Who,
    query: Query<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    give(server, who, query, headers, ("stop", Map::new())).await
}

async fn give(
    State(server): TheServer,
    (Extension(caller), Extension(client)): Who,
    Query(query): Query<LegacyQuery>,
    headers: HeaderMap,
    (command, parameters): (&str, Map<String, Value>),
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    // Scripts of Astra's users know no key: each of their requests is an order of its own, and to close twice does no harm.
    let key = match headers.contains_key("idempotency-key") {
        true => idempotency_key(&headers)?.to_owned(),
        false => format!("at {}", server.bus.clock().utc()),
    };
    let request = CommandRequest {
        command: command.to_owned(),
        parameters,
        reason: String::new(),
        operator: None,
        deadline_s: None,
    };
    let state = order(&server, &caller, &client, address.clone(), (&key, request), wait(&headers)).await?;
    let state = unless_refused(state)?;
    let location = [(header::LOCATION, location(&state))];
    let taken = state.detail.as_deref().unwrap_or("the observatory node took it");
    let against: String = state.against.iter().map(|why| format!("; but {why}")).collect();
    let message = format!("{command} at {address}: {taken}{against}");
    let ordered = LegacyOrdered { status: "success", data: "null", message, command_id: state.id, state: state.state };
    Ok(instead("commands", &address, (location, Json(ordered)).into_response()))
}
