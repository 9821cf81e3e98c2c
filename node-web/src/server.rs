//! The routes, and what they share.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::Bytes;
use axum::http::{StatusCode, Uri};
use axum::routing::get;
use bus::{Bus, MachineTime, Stop};
use contract::Address;
use local_http::Places;

use crate::gate::{Gate, guard};
use crate::host::Host;
use crate::network::Network;
use crate::preview::Previews;
use crate::problem::Problem;
use crate::routes::{health, heartbeat, network, page, preview};
use crate::ws;

/// What the routes share.
pub struct Server {
    /// Everything heard.
    pub network: Arc<Network>,
    /// Images.
    pub previews: Arc<Previews>,
    /// This machine.
    pub host: Arc<Host>,
    /// The bus, for its health.
    pub bus: Bus,
    /// Ends the sockets too.
    pub stop: Stop,
    /// Heartbeat documents that were made a moment ago.
    pub heartbeats: Mutex<BTreeMap<Option<Address>, (MachineTime, Bytes)>>,
    /// Sockets open now.
    pub sockets: Arc<Places>,
}

/// All routes, behind the gate.
pub fn router(server: Arc<Server>, gate: Gate) -> Router {
    Router::new()
        .route("/", get(page::index))
        .route("/t/{site}/{telescope}", get(page::index))
        .route("/assets/{name}", get(page::asset))
        .route("/favicon.ico", get(page::favicon))
        .route("/healthz", get(health::healthz))
        .route("/api/heartbeat", get(heartbeat::heartbeat))
        .route("/api/v1/network", get(network::network))
        .route("/api/v1/telescopes/{site}/{telescope}", get(network::telescope))
        .route("/api/v1/telescopes/{site}/{telescope}/image.jpg", get(preview::image))
        .route("/api/v1/ws", get(ws::open))
        .fallback(nothing_here)
        .method_not_allowed_fallback(read_only)
        .with_state(server)
        .layer(axum::middleware::from_fn_with_state(Arc::new(gate), guard))
}

async fn nothing_here(uri: Uri) -> Problem {
    Problem::not_found(format!("There is nothing at {}.", uri.path()))
}

async fn read_only() -> Problem {
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method", "Only GET is answered here", "This server only shows.")
}
