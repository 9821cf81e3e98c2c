//! Is this node alive?

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde_json::{Value, json};

use crate::server::Server;

/// 200 while the bus session is up; the count of telescopes is for people.
pub async fn healthz(State(server): State<Arc<Server>>) -> Json<Value> {
    let telescopes = server.network.summaries().iter().filter(|summary| !summary.face.shared).count();
    Json(json!({
        "ok": true,
        "version": env!("CARGO_PKG_VERSION"),
        "peers": server.bus.peers().await,
        "telescopes": telescopes,
        "pages": server.previews.watchers(),
    }))
}
