//! The native JSON: the network in short, one telescope in full.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use contract::Address;
use serde_json::{Map, Value, json};

use crate::model::Entry;
use crate::network::Network;
use crate::problem::Problem;
use crate::server::Server;
use crate::summary::{Summary, nodes};

const NEVER_KEPT: [(header::HeaderName, &str); 1] = [(header::CACHE_CONTROL, "no-store")];

/// All telescopes with their nodes; the devices that a site shares are under `shared`.
pub async fn network(State(server): State<Arc<Server>>) -> Response {
    let network = &server.network;
    let now = network.clock().machine();
    let of = |shared: bool| -> Vec<Value> {
        let model = network.read();
        let wanted =
            model.telescopes.iter().filter(|(address, _)| (address.telescope.as_str() == Address::SHARED) == shared);
        let said = wanted.map(|(address, telescope)| {
            let mut said = json!(Summary::of(address, telescope, now));
            said["nodes"] = json!(nodes(telescope, now));
            said
        });
        said.collect()
    };
    let body = json!({
        "server_time_utc": network.clock().utc(),
        "speed": network.clock().speed(),
        "telescopes": of(false),
        "shared": of(true),
    });
    (NEVER_KEPT, Json(body)).into_response()
}

/// Everything known of one telescope.
pub async fn telescope(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let unknown = || Problem::not_found(format!("No telescope {site}/{telescope} was heard on the bus."));
    let address = Address::new(&site, &telescope).map_err(|_| unknown())?;
    let network = &server.network;
    let now = network.clock().machine();
    let model = network.read();
    let known = model.telescopes.get(&address).ok_or_else(unknown)?;
    let body = json!({
        "server_time_utc": network.clock().utc(),
        "speed": network.clock().speed(),
        "summary": Summary::of(&address, known, now),
        "states": states(known.states.iter(), network),
        "log": known.diary.after(0).collect::<Vec<_>>(),
    });
    Ok((NEVER_KEPT, Json(body)).into_response())
}

/// Entries as the socket and the API show them.
pub fn states<'a>(entries: impl Iterator<Item = (&'a String, &'a Entry)>, network: &Network) -> Map<String, Value> {
    let now = network.clock().machine();
    let shown = entries.map(|(name, entry)| {
        let shown = json!({
            "at_utc": entry.at_utc,
            "age_s": entry.age(now).as_secs_f64(),
            "period_s": entry.period().map(|period| period.as_secs_f64()),
            "body": *entry.body,
        });
        (name.clone(), shown)
    });
    shown.collect()
}
