//! A message to everybody who gets alerts, that only tests whether it arrives.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, State};
use contract::Right;
use schemars::JsonSchema;
use serde::Serialize;
use users::Principal;

use crate::problem::Problem;
use crate::server::Server;

/// Test messages come at most as often as this.
const PAUSE: Duration = Duration::from_secs(10);

/// `POST /api/v1/alerts/test`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TestMessages {
    /// The telescope whose receivers this node has in its file.
    telescope: String,
    /// What came of each; empty where `[alerts]` names nobody and no browser has subscribed.
    receivers: Vec<TestMessage>,
}

/// What came of the message to one receiver.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TestMessage {
    /// Its name in the configuration; of a browser `push/USER/ID`.
    name: String,
    /// `webhook`, `ntfy`, `e-mail` or `push`.
    way: &'static str,
    /// Why it was not sent; its server has taken it where this is absent.
    error: Option<String>,
}

/// Sends it.
pub async fn send(
    State(server): State<Arc<Server>>,
    Extension(principal): Extension<Principal>,
) -> Result<Json<TestMessages>, Problem> {
    let address = server.config.address();
    if principal.right_at(&address).is_none_or(|right| right < Right::Operator) {
        let detail =
            format!("This server sends to the receivers of {address}, and {} is no operator there.", principal.name);
        return Err(Problem::forbidden(detail));
    }
    let now = server.bus.clock().machine();
    {
        let mut tested = server.tested.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(wait) = tested.and_then(|at| PAUSE.checked_sub(now.since(at))) {
            return Err(Problem::too_many("A test message was sent a moment ago.", wait));
        }
        *tested = Some(now);
    }
    let (by, now) = (principal.name.as_str(), server.bus.clock().utc());
    let sent = notify::send_test(&server.config, Some(&server.push), by, now).await;
    tracing::info!(by = %principal.name, receivers = sent.len(), "a test message was sent to those who get alerts");
    let message = |one: notify::TestSent| TestMessage { name: one.receiver, way: one.way, error: one.error };
    Ok(Json(TestMessages { telescope: address.to_string(), receivers: sent.into_iter().map(message).collect() }))
}
