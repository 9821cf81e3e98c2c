//! Alpaca's management API: the name of this server, and the devices that it has.

use std::sync::Arc;

use axum::Json;
use axum::extract::{RawQuery, State};
use serde_json::{Value, json};

use crate::common;
use crate::kind::Kind;
use crate::request::Request;
use crate::world::World;

fn envelope(world: &World, query: Option<String>, value: Value) -> Json<Value> {
    let client = Request::new(false, "", &query.unwrap_or_default()).client_transaction();
    Json(json!({
        "Value": value,
        "ClientTransactionID": client,
        "ServerTransactionID": world.next_transaction(),
    }))
}

/// `GET /management/apiversions`.
pub async fn versions(State(world): State<Arc<World>>, RawQuery(query): RawQuery) -> Json<Value> {
    envelope(&world, query, json!([1]))
}

/// `GET /management/v1/description`.
pub async fn description(State(world): State<Arc<World>>, RawQuery(query): RawQuery) -> Json<Value> {
    let value = json!({
        "ServerName": world.name(),
        "Manufacturer": "Starmesh",
        "ManufacturerVersion": env!("CARGO_PKG_VERSION"),
        "Location": "simulated",
    });
    envelope(&world, query, value)
}

/// `GET /management/v1/configureddevices`.
pub async fn devices(State(world): State<Arc<World>>, RawQuery(query): RawQuery) -> Json<Value> {
    let device = |kind: Kind| {
        json!({
            "DeviceName": common::name(kind),
            "DeviceType": kind.ascom(),
            "DeviceNumber": kind.number(),
            // The id is the same for the same server name, as a unique id must not change between runs.
            "UniqueID": format!("{}-{}-{}", world.name().to_ascii_lowercase().replace(' ', "-"), kind.path(), kind.number()),
        })
    };
    let devices: Vec<Value> = world.kinds().iter().copied().map(device).collect();
    envelope(&world, query, json!(devices))
}
