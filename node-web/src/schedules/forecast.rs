//! The forecast of the schedule in force, made once for all who look at it.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use contract::observatory::{SchedulePlan, SchedulePlanQuestion, ScheduleState};
use contract::{Address, Key, Part};
use schemars::JsonSchema;
use serde::Serialize;
use sha2::{Digest as _, Sha256};
use units::Utc;

use super::asked;
use crate::drafts::etag;
use crate::forecast_store::MadeForecast;
use crate::problem::Problem;
use crate::routes::login::internal;
use crate::routes::network::known;
use crate::server::Server;

/// The reader asks each time whether it has changed; nothing in between stores it for others.
const REVALIDATED: (header::HeaderName, &str) = (header::CACHE_CONTROL, "private, no-cache");

/// What the schedule in force will do.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Forecast {
    /// Sky time at which it was made; it is made again when another schedule is in force, and after three minutes.
    pub made_utc: Utc,
    /// SHA-256 of the schedule's text.
    pub sha256: String,
    /// Each row of the schedule, from its begin on, under a good sky.
    #[serde(flatten)]
    pub plan: SchedulePlan,
}

/// The forecast of the schedule in force.
pub async fn forecast(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let slot = server.plans.slot(&address);
    let mut made = slot.lock().await;
    let in_force = sha256_in_force(&server, &address);
    let clock = server.network.clock();
    let made = match &mut *made {
        Some(made) if made.is_good(clock.machine(), in_force.as_deref()) => made,
        stale => {
            let outcome = make(&server, &address).await;
            // From the end of the work on, which may take longer than the pause after a failure.
            stale.insert(MadeForecast { at: clock.machine(), of: in_force, outcome })
        }
    };
    let (tag, body) = made.outcome.clone()?;
    let tagged = [(header::ETAG, etag::quoted(&tag)), (REVALIDATED.0, REVALIDATED.1.to_owned())];
    if etag::is_known(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, tagged).into_response());
    }
    Ok((tagged, [(header::CONTENT_TYPE, "application/json")], body).into_response())
}

async fn make(server: &Server, address: &Address) -> Result<(String, Bytes), Problem> {
    let made_utc = server.network.clock().utc();
    let (text, sha256, _) = asked::text(server, address, None).await?;
    let question = SchedulePlanQuestion { text, unsafe_utc: Vec::new() };
    let plan = asked::plan(server, address, &question).await?;
    let forecast = Forecast { made_utc, sha256, plan };
    let body = Bytes::from(serde_json::to_vec(&forecast).map_err(|error| internal(&error))?);
    let tag = Sha256::digest(&body).iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    Ok((tag, body))
}

/// The hash of the schedule in force, as it was published last.
pub(super) fn sha256_in_force(server: &Server, address: &Address) -> Option<String> {
    let key = Key::Observatory(address.clone(), Part::Schedule);
    let model = server.network.read();
    model.telescopes.get(address)?.read::<ScheduleState>(&key)?.1.sha256
}
