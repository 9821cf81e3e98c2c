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
use crate::safety::SafetyWord;
use crate::server::Server;
use crate::summary::{Face, Mode, Summary};

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
    let found: Vec<(&Address, &Telescope)> = match wanted {
        Some(address) => model.telescopes.get_key_value(address).into_iter().collect(),
        None => model.telescopes.iter().filter(|(address, _)| may_see(address)).collect(),
    };
    let summed: Vec<(&Address, &Telescope, Summary)> = found
        .into_iter()
        .map(|(address, telescope)| (address, telescope, Summary::of(model, address, telescope, now, utc)))
        .collect();
    // What a site shares has a document of its own only where it is asked for.
    let (shared, telescopes): (Vec<_>, Vec<_>) =
        summed.iter().partition(|(.., summary)| wanted.is_none() && summary.face.shared);
    let documents: Vec<(&Address, Map<String, Value>, Posture)> = telescopes
        .into_iter()
        .map(|(address, telescope, summary)| {
            (*address, one(address, telescope, model, summary, usage, utc), summary.face.posture)
        })
        .collect();
    let mut document = match documents.as_slice() {
        [(_, document, _)] => document.clone(),
        several => all(several, usage, utc),
    };
    for (address, telescope, summary) in shared {
        let alerts = summary.face.alerts_beside(summed.iter().map(|(.., other)| &other.face));
        for (key, mut errors) in ["error_source", "returned"].into_iter().zip(told(&alerts, &[*telescope])) {
            errors.iter_mut().for_each(|error| error["telescope_id"] = json!(address.telescope.as_str()));
            if let Some(list) = document.get_mut(key).and_then(Value::as_array_mut) {
                list.append(&mut errors);
            }
        }
    }
    let is_error_free = document["error_source"] == json!([]);
    document.insert("error_free".to_owned(), json!(is_error_free));
    Value::Object(document)
}

/// Errors of now, and alerts that have cleared and are not acknowledged: these are no error of now, but a script that asks
/// every few minutes must not miss them.
fn told(alerts: &[Alert], telescopes: &[&Telescope]) -> [Vec<Value>; 2] {
    let describe = |alert: &Alert| {
        let (kind, name) = source(&alert.id, telescopes);
        json!({ "device_type": kind, "device_name": name, "error": format!("{}: {}", alert.id, alert.cause) })
    };
    let (returned, active): (Vec<&Alert>, Vec<&Alert>) = alerts
        .iter()
        .filter(|alert| alert.priority != Priority::Advisory)
        .partition(|alert| alert.returned_utc.is_some());
    [active.into_iter().map(describe).collect(), returned.into_iter().map(describe).collect()]
}

/// What is wrong with a telescope besides its alerts: its observatory node is silent or publishes no verdict, or safety and
/// posture together are urgent. One that was stopped and closed is no error.
fn fault(face: &Face) -> Option<String> {
    let stale = face.quality != Quality::Fresh;
    match &face.stopped {
        Some(stopped) if stopped.is_closed() => return None,
        Some(stopped) if stale => return Some(format!("stale: {}", stopped.text)),
        Some(_) | None => {}
    }
    let is_urgent = face.safety_concern.is_some_and(|concern| concern <= Priority::High);
    let head = if stale {
        format!("stale: {}", overview::silent(face.observatory_silent_since_utc))
    } else if is_urgent || face.safety.state == SafetyWord::Unknown {
        format!("safety {}", face.safety.state.word())
    } else {
        return None;
    };
    let reasons =
        face.safety.reasons.iter().filter(|_| !stale).map(|reason| format!("{} {}", reason.input, reason.why));
    let words = [head, format!("posture {}", face.posture.word())].into_iter().chain(reasons);
    Some(words.chain(face.domes.iter().cloned()).collect::<Vec<_>>().join("; "))
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
    let shared = model.telescopes.get(&address.shared());
    let both: Vec<&Telescope> = std::iter::once(telescope).chain(shared).collect();
    let [mut errors, returned] = told(&face.alerts, &both);
    if let Some(error) = fault(face) {
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
    if let Some(shared) = shared {
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
fn source(alert_id: &str, telescopes: &[&Telescope]) -> (&'static str, String) {
    let named = alert_id.split('/').skip(1).find_map(|part| {
        telescopes.iter().flat_map(|telescope| telescope.states.values()).find_map(|entry| match &entry.key {
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

#[cfg(test)]
mod tests {
    use bus::Clock;

    use super::*;
    use crate::model::tests::received;
    use crate::network::Network;

    /// The document of these payloads, each with its path and when it came, s; 1 s after 110 s.
    fn heartbeat(payloads: &[(&str, u64, &Value)], wanted: Option<&str>) -> Value {
        let network = Network::new(Clock::machine_clock(), Address::new("paranal", "callisto").unwrap());
        for (path, at_s, body) in payloads {
            assert!(network.accept(received(&format!("paranal/{path}"), "b", 0, *at_s, Value::clone(body))), "{path}");
        }
        let wanted = wanted.map(|telescope| Address::new("paranal", telescope).unwrap());
        let now = MachineTime::from_boot(Duration::from_secs(111));
        document(&network.read(), wanted.as_ref(), |_| true, Usage::default(), now, Utc::EPOCH)
    }

    fn night(posture: &str) -> Value {
        let mut night: Value =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/observatory.night.json")).unwrap();
        night["posture"] = json!(posture);
        night
    }

    fn safety(verdict: &str) -> Value {
        let mut safety: Value =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/observatory.safety.json")).unwrap();
        safety["verdict"] = json!(verdict);
        safety
    }

    const NIGHT: &str = "callisto/observatory/night/state";
    const SAFETY: &str = "callisto/observatory/safety/state";

    fn errors(document: &Value) -> Vec<&str> {
        let errors = document["error_source"].as_array().unwrap();
        assert_eq!(document["error_free"], errors.is_empty(), "{document}");
        errors.iter().map(|error| error["error"].as_str().unwrap()).collect()
    }

    #[test]
    fn a_shared_dome_that_does_not_close_is_an_error_of_its_telescope_and_what_else_a_site_shares_one_of_the_network() {
        let alert = |id: &str| json!({ "id": id, "priority": "critical", "raised_utc": "2026-11-21T03:00:00Z", "cause": "c", "consequence": "", "action": "" });
        let mut station = alert("device-lost/station");
        station["cause"] = json!("it is silent");
        let alerts = json!({ "alerts": [alert("dome-not-closed/roof"), station] });
        let guard: Value =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/dome.guard.json")).unwrap();
        let dome: Value =
            serde_json::from_str(include_str!("../../../common/contract/golden/v1/dome.state.json")).unwrap();
        let (night, safety) = (night("closed"), safety("safe"));
        let payloads = [
            (NIGHT, 110, &night),
            (SAFETY, 110, &safety),
            ("shared/node/device/enclosure/alerts", 110, &alerts),
            ("shared/device/dome/roof/guard", 110, &guard),
            ("shared/device/dome/roof/state", 110, &dome[0]),
        ];
        let own = heartbeat(&payloads, Some("callisto"));
        assert_eq!(errors(&own), ["dome-not-closed/roof: c"]);
        assert_eq!((&own["error_source"][0]["device_type"], &own["stale"]), (&json!("Dome"), &json!(false)));
        let network = heartbeat(&payloads, None);
        assert_eq!(errors(&network), ["dome-not-closed/roof: c", "device-lost/station: it is silent"]);
        assert_eq!(network["error_source"][1]["telescope_id"], "shared");
        let several = heartbeat(&[&payloads[..], &[("io/observatory/night/state", 110, &night)]].concat(), None);
        let of_shared = |error: &&Value| error["telescope_id"] == "shared";
        assert_eq!(several["error_source"].as_array().unwrap().iter().filter(of_shared).count(), 1, "{several}");
        assert!(several["telescopes"]["callisto"].is_object() && several["telescopes"]["shared"].is_null());
    }

    #[test]
    fn open_while_it_is_unsafe_is_an_error_and_closed_is_none() {
        let told = |posture, verdict| {
            let (night, safety) = (night(posture), safety(verdict));
            let document = heartbeat(&[(NIGHT, 110, &night), (SAFETY, 110, &safety)], None);
            errors(&document).iter().map(|error| (*error).to_owned()).collect::<Vec<_>>()
        };
        assert!(told("closed", "unsafe").is_empty() && told("open", "safe").is_empty());
        let [open] = &told("open", "unsafe")[..] else { panic!("one error") };
        assert!(open.starts_with("safety unsafe; posture open; wx/Humidity 71.2 %"), "{open}");
    }

    #[test]
    fn a_verdict_that_is_no_longer_published_is_an_error_while_the_night_still_is() {
        let (night, safety) = (night("closed"), safety("safe"));
        let document = heartbeat(&[(NIGHT, 110, &night), (SAFETY, 100, &safety)], None);
        assert_eq!((&document["stale"], &document["weather_safe"]), (&json!(false), &Value::Null));
        let found = errors(&document);
        let [error] = found[..] else { panic!("one error: {found:?}") };
        let words = ["safety unknown; posture closed; ", "publishes no verdict any more", "its last verdict was safe"];
        assert!(words.iter().all(|words| error.contains(words)), "{error}");
        let document = heartbeat(&[(NIGHT, 110, &night)], None);
        assert_eq!(errors(&document), ["safety unknown; posture closed"], "none ever came");
    }
}
