//! One part of a telescope's state, with its age: the verdict, the night, the schedule, guiding, focus, its devices.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::response::{IntoResponse as _, Response};
use contract::observatory::{Alert, Priority};
use contract::{Address, Device, Key, Kind, Name, Part, Payload};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use units::Utc;
use users::Principal;

use crate::alerts::active;
use crate::freshness::Quality;
use crate::json_body::AskedFor;
use crate::model::{Entry, Telescope};
use crate::problem::Problem;
use crate::routes::network::{NEVER_CACHED, body_for, known};
use crate::server::Server;

/// A payload with its age.
#[derive(Debug, JsonSchema, Serialize)]
#[schemars(rename = "{T}Now")]
pub struct PartNow<T> {
    /// Sky time of its sender.
    pub at_utc: Utc,
    /// How old it is by the clock of this server, s.
    pub age_s: f64,
    /// It is published again within so many seconds; absent for what is not repeated.
    pub period_s: Option<f64>,
    /// What it is worth by its age.
    pub quality: Quality,
    /// The payload.
    pub body: T,
}

/// A device of a telescope.
#[derive(Debug, JsonSchema, Serialize)]
pub struct DeviceNow {
    /// Its kind, as ASCOM calls it.
    pub kind: Kind,
    /// Its configured name.
    pub name: String,
    /// Its state, as the AsyncAPI document of the bus describes it; absent before it was received.
    pub state: Option<PartNow<Value>>,
    /// What it can do; absent before it was received.
    pub capabilities: Option<PartNow<Value>>,
}

/// Which alerts.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlertsQuery {
    /// Of this telescope only, as `site/telescope`.
    telescope: Option<String>,
    /// At least so urgent.
    priority: Option<Priority>,
}

/// An alert and whose it is.
#[derive(Debug, PartialEq, JsonSchema, Serialize)]
pub struct AlertOfTelescope {
    /// The telescope, as `site/telescope`.
    pub telescope: String,
    /// The alert.
    #[serde(flatten)]
    pub alert: Alert,
}

/// Reads one part that the observatory node publishes.
///
/// # Errors
/// Where the telescope or the part was never received.
pub fn part<T: Payload>(
    server: &Server,
    (site, telescope): &(String, String),
    part: Part,
) -> Result<Response, Problem> {
    let address = known(&server.network, site, telescope)?;
    let key = Key::Observatory(address, part);
    let model = server.network.read();
    let found = model.telescopes.get(key.address()).and_then(|telescope| telescope.read::<T>(&key));
    let detail = || {
        format!("The observatory node of {} has published nothing of this since this server started.", key.address())
    };
    let (entry, body) = found.ok_or_else(|| Problem::not_found(detail()))?;
    Ok((NEVER_CACHED, Json(now(entry, body, server))).into_response())
}

fn now<T>(entry: &Entry, body: T, server: &Server) -> PartNow<T> {
    let now = server.network.clock().machine();
    PartNow {
        at_utc: entry.at_utc,
        age_s: entry.age(now).as_secs_f64(),
        period_s: entry.period().map(|period| period.as_secs_f64()),
        quality: entry.quality(now),
        body,
    }
}

/// All devices of a telescope.
pub async fn devices(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path((site, telescope)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let model = server.network.read();
    let telescope = model.telescopes.get(&address).ok_or_else(|| Problem::not_found("It has just been forgotten."))?;
    let device = |entry: &Entry| match &entry.key {
        Key::State(device) | Key::Capabilities(device) => Some(device.clone()),
        _ => None,
    };
    let mut names: Vec<Device> = telescope.states.values().filter_map(device).collect();
    names.sort();
    names.dedup();
    let devices: Vec<DeviceNow> =
        names.into_iter().map(|device| device_now(device, telescope, &server, &caller)).collect();
    Ok((NEVER_CACHED, Json(devices)).into_response())
}

/// One device.
pub async fn device(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path((site, telescope, kind, name)): Path<(String, String, String, String)>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let unknown = || Problem::not_found(format!("{address} has no {kind} {name} on the bus."));
    let kind: Kind = kind.parse().map_err(|_| unknown())?;
    let name: Name = name.parse().map_err(|_| unknown())?;
    let model = server.network.read();
    let telescope = model.telescopes.get(&address).ok_or_else(unknown)?;
    let device = device_now(address.device(kind, &name), telescope, &server, &caller);
    if device.state.is_none() && device.capabilities.is_none() {
        return Err(unknown());
    }
    Ok((NEVER_CACHED, Json(device)).into_response())
}

fn device_now(device: Device, telescope: &Telescope, server: &Server, caller: &Principal) -> DeviceNow {
    let of = |key: Key| telescope.read::<Value>(&key).map(|(entry, _)| now(entry, body_for(entry, caller), server));
    DeviceNow {
        kind: device.kind,
        name: device.name.to_string(),
        state: of(Key::State(device.clone())),
        capabilities: of(Key::Capabilities(device)),
    }
}

/// Alerts of all telescopes: those that need somebody first, and those whose cause is gone last.
pub async fn alerts(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<AlertsQuery>,
) -> Result<Response, Problem> {
    let now = server.network.clock().machine();
    let model = server.network.read();
    let is_wanted = |address: &Address| {
        caller.right_at(address).is_some()
            && query.telescope.as_ref().is_none_or(|wanted| *wanted == address.to_string())
    };
    let mut alerts: Vec<AlertOfTelescope> = model
        .telescopes
        .iter()
        .filter(|(address, _)| is_wanted(address))
        .flat_map(|(address, telescope)| {
            active(telescope, Vec::new(), now)
                .into_iter()
                .map(|alert| AlertOfTelescope { telescope: address.to_string(), alert })
        })
        .filter(|of| query.priority.is_none_or(|least| of.alert.priority <= least))
        .collect();
    alerts.sort_by_key(|of| (of.alert.standing(), of.alert.priority));
    Ok((NEVER_CACHED, Json(alerts)).into_response())
}
