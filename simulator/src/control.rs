//! The simulator's own HTTP: its clock, the truth, the faults, and the log.
//!
//! | request | does |
//! |---|---|
//! | `GET /simulator/v1/clock` | sky time and speed; a clock that stands runs from now on |
//! | `GET /simulator/v1/world` | the truth about everything |
//! | `PUT /simulator/v1/world/site` `{"latitude_deg": 47, "longitude_deg": 8, "elevation_m": 500, "start": "2026-11-21T15:00:00Z", "best_focus": 12000, "filters": ["z'"], "coldest_c": -60, "scatter_arcsec": 1, "small_frames": true}` | begins anew as this site; the clock stands until it is asked for ([`crate::site`]) |
//! | `PUT /simulator/v1/world/rain` `{"on": true}` | rain with clouds and damp |
//! | `PUT /simulator/v1/world/weather` `{"WindSpeed": 22, "Humidity": null}` | orders values; null: as nature has it |
//! | `PUT /simulator/v1/world/safety` `{"unsafe": true}` | the safety monitor reports unsafe |
//! | `PUT /simulator/v1/world/shutter` `{"sticks_half_open": true}` | |
//! | `PUT /simulator/v1/world/dome` `{"turn_deg_per_s": 0}` | how fast it turns; 0: it hangs; null: as at the start |
//! | `PUT /simulator/v1/world/dome` `{"runs_on": true}` | its turns never end |
//! | `PUT /simulator/v1/world/dome` `{"shutter_needs_rest": true}` | it moves no shutter while it turns |
//! | `PUT /simulator/v1/world/park` `{"lies": true}` | `AtPark` is true whatever is the case |
//! | `PUT /simulator/v1/world/flip` `{"ignored": true}` | slews leave the tube on its side of the pier |
//! | `PUT /simulator/v1/world/mount` `{"dec_backlash_arcsec": 15}` | play of the declination gear; null: as at the start |
//! | `PUT /simulator/v1/world/mount` `{"dec_pulses_reverse_west": true}` | pulses north go south with the tube west of the pier |
//! | `PUT /simulator/v1/world/focuser` `{"backlash_steps": 80}` | play of the focuser's gear; null: as at the start |
//! | `PUT /simulator/v1/world/vendor` `{"status": "LIST", "clear": "CLEAR", "ready": "READY", "ready_after_s": 5, "errors": [{"entry": "mount\|4", "level": 4}]}` | the mount has a controller that latches errors ([`crate::Vendor`]); null: none |
//! | `PUT /simulator/v1/world/ups` `{"on_mains": false}` | |
//! | `PUT /simulator/v1/world/watchdog` `{"limit_s": 120}` | the dome's own watchdog; null: none |
//! | `PUT /simulator/v1/world/connection` `{"lose": "camera"}` | device is not connected any more |
//! | `GET`, `DELETE /simulator/v1/faults` | lists; clears these and all of the above |
//! | `PUT /simulator/v1/faults/{kind}` | (or `guidecamera`) a [`Fault`] such as `{"stale": true}`; `{}` heals |
//! | `GET /simulator/v1/log?since=17` | PUTs to devices with a number above 17, and request counts |

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::alpaca::text;
use crate::faults::Fault;
use crate::kind::Kind;
use crate::weather::Quantity;
use crate::world::World;

/// `GET /simulator/v1/clock`: a node sets its clock by this.
pub async fn clock(State(world): State<Arc<World>>) -> Json<Value> {
    world.run_clock();
    Json(json!({ "utc": world.now(), "speed": world.clock().speed(), "simulated": true }))
}

/// `GET /simulator/v1/world`.
pub async fn world(State(world): State<Arc<World>>) -> Json<Value> {
    Json(world.state())
}

/// `PUT /simulator/v1/world/{thing}`.
pub async fn change(State(world): State<Arc<World>>, Path(thing): Path<String>, body: axum::body::Bytes) -> Response {
    match serde_json::from_slice(&body).map_err(|error| error.to_string()).and_then(|v| execute(&world, &thing, &v)) {
        Ok(()) => Json(world.state()).into_response(),
        Err(message) => text(StatusCode::BAD_REQUEST, message),
    }
}

fn execute(world: &World, thing: &str, order: &Value) -> Result<(), String> {
    let truth = |name: &str| order[name].as_bool().ok_or(format!("expected {{\"{name}\": true or false}}"));
    match thing {
        "site" => crate::site::begin(world, order)?,
        "rain" => world.rain(truth("on")?),
        "safety" => world.set_unsafe(truth("unsafe")?),
        "shutter" => world.stick_shutter_half_open(truth("sticks_half_open")?),
        "park" => world.lie_about_park(truth("lies")?),
        "flip" => world.ignore_flips(truth("ignored")?),
        "ups" => world.set_on_mains(truth("on_mains")?),
        "dome" if order.get("runs_on").is_some() => world.let_dome_run_on(truth("runs_on")?),
        "dome" if order.get("shutter_needs_rest").is_some() => {
            world.let_shutter_need_rest(truth("shutter_needs_rest")?);
        }
        "dome" => match order.get("turn_deg_per_s") {
            Some(Value::Null) => world.set_turn_speed(None),
            Some(speed) if speed.as_f64().is_some_and(|speed| (0.0..=360.0).contains(&speed)) => {
                world.set_turn_speed(speed.as_f64());
            }
            _ => return Err("expected {\"turn_deg_per_s\": 0 to 360, or null}".to_owned()),
        },
        "mount" if order.get("dec_pulses_reverse_west").is_some() => {
            world.reverse_dec_pulses_west(match &order["dec_pulses_reverse_west"] {
                Value::Null => None,
                _ => Some(truth("dec_pulses_reverse_west")?),
            });
        }
        "mount" => world.set_dec_backlash(play(order, "dec_backlash_arcsec")?),
        "focuser" => world.set_focus_backlash(play(order, "backlash_steps")?),
        "vendor" => world.set_vendor(serde_json::from_value(order.clone()).map_err(|error| error.to_string())?),
        "watchdog" => world.set_watchdog(order["limit_s"].as_f64()),
        "connection" => {
            let kind = order["lose"].as_str().and_then(Kind::from_name).ok_or("expected {\"lose\": \"camera\"}")?;
            world.lose_connection(kind);
        }
        "weather" => {
            for (name, value) in order.as_object().ok_or("expected {\"WindSpeed\": 22}")? {
                let quantity = Quantity::named(name).ok_or(format!("there is no weather quantity {name}"))?;
                if !(value.is_number() || value.is_null()) {
                    return Err(format!("{name} must be a number or null"));
                }
                world.set_weather(quantity, value.as_f64());
            }
        }
        _ => return Err(format!("there is nothing called {thing} to change")),
    }
    Ok(())
}

/// The play of a gear that an order gives; None for null.
fn play(order: &Value, name: &str) -> Result<Option<f64>, String> {
    match order.get(name) {
        Some(Value::Null) => Ok(None),
        Some(play) if play.as_f64().is_some_and(|play| (0.0..=3600.0).contains(&play)) => Ok(play.as_f64()),
        _ => Err(format!("expected {{\"{name}\": 0 to 3600, or null}}")),
    }
}

/// `GET /simulator/v1/faults`.
pub async fn faults(State(world): State<Arc<World>>) -> Json<Value> {
    Json(json!(world.faults()))
}

/// `PUT /simulator/v1/faults/{kind}`.
pub async fn set_fault(State(world): State<Arc<World>>, Path(kind): Path<String>, body: axum::body::Bytes) -> Response {
    let Some(kind) = Kind::from_name(&kind) else {
        return text(StatusCode::BAD_REQUEST, format!("there is no device {kind}"));
    };
    match serde_json::from_slice::<Fault>(&body) {
        Ok(fault) => {
            world.fault(kind, fault);
            Json(json!(world.faults())).into_response()
        }
        Err(error) => text(StatusCode::BAD_REQUEST, error.to_string()),
    }
}

/// `DELETE /simulator/v1/faults`.
pub async fn clear(State(world): State<Arc<World>>) -> Json<Value> {
    world.clear_faults();
    Json(json!({}))
}

/// The part of the log that is wanted.
#[derive(Debug, Deserialize)]
pub struct Since {
    #[serde(default)]
    since: u64,
}

/// `GET /simulator/v1/log`.
pub async fn log(State(world): State<Arc<World>>, Query(Since { since }): Query<Since>) -> Json<Value> {
    Json(json!({ "requests": world.request_counts(), "puts": world.puts_since(since) }))
}
