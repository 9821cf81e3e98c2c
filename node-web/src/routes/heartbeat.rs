//! `GET /api/heartbeat`: the document that a site's monitoring scripts have always read.
//!
//! The keys are the same as before, with a few more. One difference is deliberate: when the observatory node is silent
//! the document reports that (`stale`, and `error_free: false`), instead of repeating its last good state for ever.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::{Extension, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bus::MachineTime;
use contract::observatory::{Alert, Posture, Priority};
use contract::{Address, Key, Kind, Reading};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use units::Utc;
use users::Principal;

use crate::freshness::Quality;
use crate::host::Usage;
use crate::json_body::AskedFor;
use crate::model::{Model, Telescope};
use crate::problem::Problem;
use crate::server::Server;
use crate::summary::{Mode, SafetyWord, StoppedTelescope, Summary};

/// One document serves all clients that ask within this time.
const VALID_FOR: Duration = Duration::from_millis(250);

/// Which telescope: its id, or `site/telescope` where two sites have the same id; all where absent.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct HeartbeatQuery {
    /// A telescope, as its id or as `site/telescope`; all where absent.
    telescope: Option<String>,
}

/// The document of one telescope, or of all.
pub async fn heartbeat(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(wanted): AskedFor<HeartbeatQuery>,
) -> Result<Response, Problem> {
    let may_see = |address: &Address| caller.right_at(address).is_some();
    let address = match &wanted.telescope {
        None => None,
        Some(name) => Some(find(&server.network.read(), name, may_see)?),
    };
    let now = server.network.clock().machine();
    let named = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
    let make = || {
        let (model, utc) = (server.network.read(), server.network.clock().utc());
        let data = document(&model, address.as_ref(), may_see, server.host.usage(), now, utc);
        Bytes::from(json!({ "status": "success", "message": "", "data": data }).to_string())
    };
    if caller.right_everywhere().is_none() {
        // Others may see more.
        return Ok((named, make()).into_response());
    }
    let mut cached = server.heartbeats.lock().unwrap_or_else(PoisonError::into_inner);
    let bytes = match cached.get(&address) {
        Some((made, bytes)) if now.since(*made) < VALID_FOR => bytes.clone(),
        _ => {
            let bytes = make();
            cached.insert(address.clone(), (now, bytes.clone()));
            bytes
        }
    };
    Ok((named, bytes).into_response())
}

fn find(model: &Model, name: &str, may_see: impl Fn(&Address) -> bool) -> Result<Address, Problem> {
    let is_named = |address: &Address| address.telescope.as_str() == name || address.to_string() == name;
    let is_wanted = |address: &&Address| is_named(address) && may_see(address);
    let mut found = model.telescopes.keys().filter(is_wanted);
    match (found.next(), found.next()) {
        (Some(address), None) => Ok(address.clone()),
        (None, _) => Err(Problem::not_found(format!("No telescope {name} publishes on the bus."))),
        (Some(_), Some(_)) => Err(Problem::not_found(format!("Several sites have a {name}: ask for site/{name}."))),
    }
}

/// The document of one telescope, or of all that may be seen.
pub fn document(
    model: &Model,
    wanted: Option<&Address>,
    may_see: impl Fn(&Address) -> bool,
    usage: Usage,
    now: MachineTime,
    utc: Utc,
) -> Value {
    let is_shared = |address: &Address| address.telescope.as_str() == Address::SHARED;
    let wanted: Vec<(&Address, &Telescope)> = match wanted {
        Some(address) => model.telescopes.get_key_value(address).into_iter().collect(),
        None => model.telescopes.iter().filter(|(address, _)| !is_shared(address) && may_see(address)).collect(),
    };
    let documents: Vec<(&Address, Map<String, Value>, Posture)> = wanted
        .into_iter()
        .map(|(address, telescope)| {
            let summary = Summary::of(model, address, telescope, now);
            (address, one(address, telescope, model, &summary, usage, utc), summary.face.posture)
        })
        .collect();
    match documents.as_slice() {
        [(_, document, _)] => Value::Object(document.clone()),
        several => Value::Object(all(several, usage, utc)),
    }
}

/// The document of one telescope.
fn one(
    address: &Address,
    telescope: &Telescope,
    model: &Model,
    summary: &Summary,
    usage: Usage,
    utc: Utc,
) -> Map<String, Value> {
    let face = &summary.face;
    let stale = face.quality != Quality::Fresh;
    let describe = |alert: &Alert| {
        let (kind, name) = source(&alert.id, telescope);
        json!({ "device_type": kind, "device_name": name, "error": format!("{}: {}", alert.id, alert.cause) })
    };
    // An alert that has cleared and is not acknowledged is no error of now, but a script that asks every few minutes
    // must not miss it.
    let (returned, active): (Vec<&Alert>, Vec<&Alert>) = face
        .alerts
        .iter()
        .filter(|alert| alert.priority != Priority::Advisory)
        .partition(|alert| alert.returned_utc.is_some());
    let mut errors: Vec<Value> = active.into_iter().map(describe).collect();
    let returned: Vec<Value> = returned.into_iter().map(describe).collect();
    if stale && !face.stopped.as_ref().is_some_and(StoppedTelescope::is_closed) {
        let error = match &face.stopped {
            Some(stopped) => format!("stale: {}", stopped.text),
            None => {
                let silent = overview::silent(face.observatory_silent_since_utc);
                let posture = format!("posture {}", face.posture.word());
                let words: Vec<&str> = [silent.as_str(), posture.as_str()]
                    .into_iter()
                    .chain(face.domes.iter().map(String::as_str))
                    .collect();
                format!("stale: {}", words.join("; "))
            }
        };
        errors.push(json!({
            "device_type": "Observatory", "device_name": address.telescope.as_str(), "error": error,
        }));
    }
    let actions = face
        .activity
        .iter()
        .map(|action| json!({ "type": action.action, "device_name": action.camera, "id": action.row }));
    let watchdog = json!({ "type": "watchdog", "device_name": "watchdog", "id": "watchdog" });
    let threads: Vec<Value> = (!stale).then_some(watchdog).into_iter().chain(actions).collect();
    let mut polling = Map::new();
    if let Some(shared) = model.telescopes.get(&address.shared()) {
        poll(&mut polling, shared);
    }
    poll(&mut polling, telescope);
    let robotic = match face.mode {
        Mode::Robotic => Some(true),
        Mode::Manual => Some(false),
        Mode::Unknown => None,
    };
    object(json!({
        "datetime": legacy_time(summary.ages.reported_utc.unwrap_or(utc)),
        "error_free": errors.is_empty(),
        "error_source": errors,
        "returned": returned,
        "weather_safe": match face.safety.state {
            SafetyWord::Safe => Some(true),
            SafetyWord::Unsafe => Some(false),
            SafetyWord::Unknown => None,
        },
        "schedule_running": robotic == Some(true) && !face.ended,
        "cpu_percent": usage.cpu_percent,
        "memory_percent": usage.memory_percent,
        "disk_percent": usage.disk_percent,
        "threads": threads,
        "polling": polling,
        "monitor-action-queue": {},
        "age_s": summary.ages.age_s,
        "stale": stale,
        "posture": face.posture.word(),
        "observatory_silent_since_utc": face.observatory_silent_since_utc,
        "robotic_switch": robotic,
        "watchdog_running": !stale,
        "time_to_safe_s": match face.safety.state {
            SafetyWord::Safe => Some(0.0),
            SafetyWord::Unsafe | SafetyWord::Unknown => face.safety.time_to_safe_s,
        },
        "telescope_id": address.telescope.as_str(),
    }))
}

/// The document of all telescopes together; each one's document is inside.
fn all(several: &[(&Address, Map<String, Value>, Posture)], usage: Usage, utc: Utc) -> Map<String, Value> {
    let is = |document: &Map<String, Value>, key: &str| document[key] == true;
    let of_all = |key: &str| {
        let mut all = Vec::new();
        for (address, document, _) in several {
            for error in document[key].as_array().into_iter().flatten() {
                let mut error = error.clone();
                error["telescope_id"] = json!(address.telescope.as_str());
                all.push(error);
            }
        }
        all
    };
    let mut errors = of_all("error_source");
    if several.is_empty() {
        errors
            .push(json!({ "device_type": "Network", "device_name": "", "error": "no telescope publishes on the bus" }));
    }
    // A closed telescope may have any weather.
    let open = several.iter().filter(|(_, _, posture)| *posture != Posture::Closed);
    let open: Vec<&Map<String, Value>> = open.map(|(_, document, _)| document).collect();
    let counted: Vec<&Map<String, Value>> =
        if open.is_empty() { several.iter().map(|(_, document, _)| document).collect() } else { open };
    let ages = several.iter().map(|(_, document, _)| document["age_s"].as_f64());
    let oldest = ages.collect::<Option<Vec<f64>>>().and_then(|ages| ages.into_iter().reduce(f64::max));
    let clash = |id: &str| several.iter().filter(|(address, ..)| address.telescope.as_str() == id).count() > 1;
    let telescopes: Map<String, Value> = several
        .iter()
        .map(|(address, document, _)| {
            let id = address.telescope.as_str();
            (if clash(id) { address.to_string() } else { id.to_owned() }, Value::Object(document.clone()))
        })
        .collect();
    object(json!({
        "datetime": legacy_time(utc),
        "error_free": errors.is_empty(),
        "error_source": errors,
        "returned": of_all("returned"),
        "weather_safe": !counted.is_empty() && counted.iter().all(|document| is(document, "weather_safe")),
        "schedule_running": several.iter().any(|(_, document, _)| is(document, "schedule_running")),
        "cpu_percent": usage.cpu_percent,
        "memory_percent": usage.memory_percent,
        "disk_percent": usage.disk_percent,
        "threads": several.iter().flat_map(|(_, d, _)| d["threads"].as_array().into_iter().flatten()).collect::<Vec<_>>(),
        "polling": {},
        "monitor-action-queue": {},
        "age_s": oldest,
        "stale": several.is_empty() || several.iter().any(|(_, document, _)| is(document, "stale")),
        "watchdog_running": !several.is_empty() && several.iter().all(|(_, d, _)| is(d, "watchdog_running")),
        "telescopes": telescopes,
    }))
}

/// Every polled property under its ASCOM names; `null` where the device reported none.
fn poll(polling: &mut Map<String, Value>, telescope: &Telescope) {
    for entry in telescope.states.values() {
        let Key::State(device) = &entry.key else { continue };
        let Some(readings) = entry.body["readings"].as_object() else { continue };
        let properties: Map<String, Value> = readings
            .iter()
            .filter_map(|(property, reading)| {
                let reading = Reading::deserialize(reading).ok()?;
                let value = reading.value().map(|value| json!(value)).unwrap_or_default();
                let datetime = reading.at_utc.strftime("%Y-%m-%dT%H:%M:%S.%3f+00:00");
                Some((property.clone(), json!({ "value": value, "datetime": datetime })))
            })
            .collect();
        let kind = polling.entry(device.kind.ascom()).or_insert_with(|| json!({}));
        kind[device.name.as_str()] = Value::Object(properties);
    }
}

/// The device that an alert's id names behind its cause, else the observatory itself.
fn source(alert_id: &str, telescope: &Telescope) -> (&'static str, String) {
    let named = alert_id.split('/').skip(1).find_map(|part| {
        telescope.states.values().find_map(|entry| match &entry.key {
            Key::State(device) if device.name.as_str() == part => Some((device.kind, part)),
            _ => None,
        })
    });
    match named {
        Some((kind, name)) => (Kind::ascom(kind), name.to_owned()),
        None => ("Observatory", alert_id.split('/').next_back().unwrap_or_default().to_owned()),
    }
}

/// A time as Astra wrote it.
pub fn legacy_time(utc: Utc) -> String {
    utc.strftime("%Y-%m-%d %H:%M:%S.%3f")
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) | Value::Array(_) => Map::new(),
    }
}
