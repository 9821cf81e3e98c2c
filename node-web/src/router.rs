//! Which path is answered by which route.

use std::sync::Arc;

use axum::Router;
use axum::http::{StatusCode, Uri};
use axum::routing::get;

use crate::gate::{Gate, guard};
use crate::problem::Problem;
use crate::routes::{health, heartbeat, network, page, preview};
use crate::server::Server;
use crate::ws;

/// All routes, behind the check of access (`Gate`).
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
