//! Is this node alive?

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use contract::{Key, Role};
use schemars::JsonSchema;
use serde::Serialize;

use crate::model::Entry;
use crate::problem::{Code, Problem};
use crate::server::Server;

/// How this node is.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Health {
    /// It is.
    pub ok: bool,
    /// Version of the software.
    pub version: &'static str,
    /// Processes that this node is joined with on the bus.
    pub peers: usize,
    /// Telescopes that it knows.
    pub telescopes: usize,
    /// Pages that are open.
    pub pages: usize,
}

/// The version of the software.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Version {
    /// Such as 0.1.0.
    pub version: &'static str,
    /// The newest version of the API that is answered.
    pub api: &'static str,
}

/// 200 once anything was received from a telescope: a balancer or a script sends people here then.
pub async fn readyz(state: State<Arc<Server>>) -> Result<Json<Health>, Problem> {
    // This server publishes about itself, too.
    let is_of_others = |entry: &Entry| !matches!(entry.key, Key::Node(_, Role::Web, ..));
    let is_ready = {
        let model = state.network.read();
        model.telescopes.values().flat_map(|telescope| telescope.states.values()).any(is_of_others)
    };
    if !is_ready {
        let detail =
            "No node has published anything yet: look whether they run, and whether this server meets them on the bus.";
        return Err(Problem::new(Code::NotReady, "Not ready", detail));
    }
    Ok(healthz(state).await)
}

/// The version of the software.
pub async fn version() -> Json<Version> {
    Json(Version { version: env!("CARGO_PKG_VERSION"), api: "v1" })
}

/// 200 while the bus session is up; the count of telescopes is for people.
pub async fn healthz(State(server): State<Arc<Server>>) -> Json<Health> {
    Json(Health {
        ok: true,
        version: env!("CARGO_PKG_VERSION"),
        peers: server.bus.peers().await,
        telescopes: server.network.summaries().iter().filter(|summary| !summary.face.shared).count(),
        pages: server.previews.watchers(),
    })
}
