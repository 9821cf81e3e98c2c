//! A telescope as two tables and its newest image: what Astra's socket sent each second.

use bus::MachineTime;
use contract::observatory::GuidingState;
use contract::{Address, Key, Kind, Part, Reading};
use serde::Deserialize as _;
use serde_json::{Map, Value, json};
use units::Utc;

use crate::freshness::Quality;
use crate::host::Usage;
use crate::model::{Entry, Model, Telescope};
use crate::routes::heartbeat;
use crate::summary::{ImageCaption, Summary};

/// The kinds that have rows, in their order.
const KINDS: [Kind; 7] = [
    Kind::Telescope,
    Kind::Dome,
    Kind::FilterWheel,
    Kind::Camera,
    Kind::Focuser,
    Kind::ObservingConditions,
    Kind::SafetyMonitor,
];
/// Times in these tables: whole seconds, without a zone.
const SECONDS: &str = "%Y-%m-%d %H:%M:%S";

/// The document of this moment.
pub fn document(model: &Model, address: &Address, usage: Usage, now: MachineTime, utc: Utc) -> Value {
    let heartbeat = heartbeat::document(model, Some(address), |_| true, usage, now, utc);
    let telescope = model.telescopes.get(address);
    let image = telescope.and_then(|telescope| Summary::of(model, address, telescope, now, utc).face.image);
    json!({
        "table0": devices(model, address, now),
        "table1": system(&heartbeat, utc),
        "last_image": image.map(|image| last_image(&image)),
    })
}

fn system(heartbeat: &Value, utc: Utc) -> Value {
    let word = |key: &str, yes, no, unknown| match heartbeat[key].as_bool() {
        Some(true) => yes,
        Some(false) => no,
        None => unknown,
    };
    let errors = &heartbeat["error_source"];
    let has_errors = errors.as_array().is_some_and(|errors| !errors.is_empty());
    let threads = &heartbeat["threads"];
    let to_safe = heartbeat["time_to_safe_s"].as_f64().map(|seconds| format!("{:.2} mins", seconds / 60.0));
    json!([
        { "item": "error free", "value": heartbeat["error_free"] },
        { "item": "utc time", "value": utc.strftime(SECONDS) },
        { "item": "watchdog", "value": word("watchdog_running", "running", "stopped", "stopped") },
        { "item": "schedule", "value": word("schedule_running", "running", "stopped", "stopped") },
        { "item": "robotic switch", "value": word("robotic_switch", "on", "off", "unknown") },
        // Not known to be safe is not safe.
        { "item": "weather safe", "value": word("weather_safe", "safe", "unsafe", "unsafe") },
        { "item": "error source", "value": if has_errors { "see error_source" } else { "none" }, "error_source": errors },
        { "item": "threads", "value": threads.as_array().map_or(0, Vec::len), "threads": threads },
        { "item": "time to safe", "value": to_safe.unwrap_or_else(|| "unknown".to_owned()) },
    ])
}

fn last_image(image: &ImageCaption) -> Value {
    let started = image.started_utc;
    let mut headers = json!({
        "EXPTIME": image.exposure_s,
        "DATE-OBS": started.fits(),
        "FILTER": image.filter,
        "IMAGETYP": image.image_type,
    });
    if let Some(object) = &image.object {
        headers["OBJECT"] = json!(object);
    }
    json!({ "available": true, "timestamp": started.plus_seconds(image.exposure_s).fits(), "headers": headers })
}

fn devices(model: &Model, address: &Address, now: MachineTime) -> Vec<Value> {
    let telescope = model.telescopes.get(address);
    let known: Vec<&Telescope> = [telescope, model.telescopes.get(&address.shared())].into_iter().flatten().collect();
    let mut rows = Vec::new();
    for kind in KINDS {
        for entry in known.iter().flat_map(|telescope| telescope.states.values()) {
            let Key::State(device) = &entry.key else { continue };
            if device.kind != kind {
                continue;
            }
            let mut row = device_row(kind, device.name.as_str(), entry, now);
            if kind == Kind::FilterWheel {
                let names =
                    known.iter().find_map(|telescope| telescope.read::<Value>(&Key::Capabilities(device.clone())));
                let names = names.and_then(|(_, capabilities)| capabilities["can"]["names"].as_array().cloned());
                row["filter_names"] = json!(names.unwrap_or_default());
            }
            rows.push(row);
            if kind == Kind::Telescope
                && let Some(telescope) = telescope
            {
                rows.push(guider(telescope, address, device.name.as_str(), now));
            }
        }
    }
    rows
}

fn device_row(kind: Kind, name: &str, entry: &Entry, now: MachineTime) -> Value {
    let (polled, complete) = polled(&entry.body["readings"]);
    let answers = entry.quality(now) == Quality::Fresh && entry.body["link"]["is"] == "connected";
    let fields = &entry.body["fields"];
    let status = match kind {
        // What the sensors say is judged by the observatory node: here it is whether they say something.
        Kind::ObservingConditions => Some(json!(if complete { "valid" } else { "invalid" })),
        _ => status(kind, fields),
    };
    let status = status.filter(|_| answers);
    let valid = match kind {
        Kind::SafetyMonitor => fields["is_safe"] == true,
        _ => complete,
    };
    json!({
        "item": kind.ascom(),
        "name": name,
        "valid": valid && status.is_some(),
        "status": status.unwrap_or_else(|| json!("error")),
        "last_update": ago(entry, now),
        "polled": polled,
    })
}

/// The word for what a device does; absent where that is not known.
fn status(kind: Kind, fields: &Value) -> Option<Value> {
    let flag = |name: &str| fields[name].as_bool();
    match kind {
        Kind::Telescope => {
            let (slewing, tracking) = (flag("slewing")?, flag("tracking")?);
            Some(json!(if slewing {
                "slewing"
            } else if tracking {
                "tracking"
            } else {
                "stopped"
            }))
        }
        Kind::Dome => Some(json!(fields["shutter"].as_str().unwrap_or("unknown"))),
        Kind::FilterWheel => Some(json!(fields["filter"].as_str().unwrap_or("moving"))),
        Kind::Camera => {
            let activity = fields["activity"].as_str().unwrap_or("unknown");
            let temperature = fields["ccd_c"].as_f64().map(|ccd_c| format!(" ({ccd_c} C)"));
            Some(json!(format!("{activity}{}", temperature.unwrap_or_default())))
        }
        Kind::Focuser => fields["position"].as_i64().map(|position| json!(position)),
        Kind::SafetyMonitor => flag("is_safe").map(|safe| json!(if safe { "safe" } else { "unsafe" })),
        Kind::ObservingConditions | Kind::Rotator | Kind::CoverCalibrator | Kind::Switch => None,
    }
}

/// The values by their ASCOM names, right ascension in degrees; and whether the device gave everything that it has.
fn polled(readings: &Value) -> (Map<String, Value>, bool) {
    let mut complete = true;
    let mut polled = Map::new();
    for (property, reading) in readings.as_object().into_iter().flatten() {
        let Ok(reading) = Reading::deserialize(reading) else { continue };
        let mut value = reading.value().map(|value| json!(value)).unwrap_or_default();
        let lacks = matches!(&reading.outcome, contract::datum::ReadingOutcome::Missing { no_data } if *no_data != contract::NoData::not_implemented());
        complete &= !lacks;
        if let Some(hours) = value.as_f64().filter(|_| property == "RightAscension") {
            value = json!(hours * 15.0);
        }
        polled.insert(property.clone(), json!({ "value": value, "datetime": reading.at_utc.strftime(SECONDS) }));
    }
    (polled, complete)
}

fn guider(telescope: &Telescope, address: &Address, mount: &str, now: MachineTime) -> Value {
    let state = telescope.read::<GuidingState>(&Key::Observatory(address.clone(), Part::Guiding));
    let fresh = state.as_ref().is_some_and(|(entry, _)| entry.quality(now) == Quality::Fresh);
    json!({
        "item": "guider",
        "name": format!("{mount}'s guider"),
        "status": fresh && state.as_ref().is_some_and(|(_, state)| state.active),
        "valid": state.is_some().then_some(fresh),
        "last_update": state.map_or_else(|| "never".to_owned(), |(entry, _)| ago(entry, now)),
    })
}

fn ago(entry: &Entry, now: MachineTime) -> String {
    format!("{:.0} s ago", entry.age(now).as_secs_f64())
}
