//! The forecast of the schedule in force, made once for all who look at it.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use contract::observatory::{
    NightState, PlanBegun, Posture, RowBegun, RowStatus, SchedulePlan, SchedulePlanQuestion, ScheduleState,
};
use contract::{Address, Key, Part};
use schemars::JsonSchema;
use serde::Serialize;
use sha2::{Digest as _, Sha256};
use units::Utc;

use super::asked;
use crate::drafts::etag;
use crate::forecast_store::MadeForecast;
use crate::problem::Problem;
use crate::routes::network::known;
use crate::server::Server;

/// The reader asks each time whether it has changed; nothing in between stores it for others.
const REVALIDATED: (header::HeaderName, &str) = (header::CACHE_CONTROL, "private, no-cache");

/// What is left of the schedule in force, and will be done.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Forecast {
    /// Sky time at which it was made; it is made again when another schedule is in force, and after three
    /// minutes, under a simulated sky after a quarter of a minute at the soonest.
    pub made_utc: Utc,
    /// SHA-256 of the schedule's text.
    pub sha256: String,
    /// Each row of the schedule under a good sky, from `made_utc` on: what has run before is in no `runs_utc`, and counts in
    /// `status` and `frames`.
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
        Some(made) if made.is_good(clock.machine(), clock.speed(), in_force.as_deref()) => made,
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
    let begun = begun(server, address, &sha256, made_utc);
    let question = SchedulePlanQuestion { text, unsafe_utc: Vec::new(), begun };
    let plan = asked::plan(server, address, &question).await?;
    let forecast = Forecast { made_utc, sha256, plan };
    let body = Bytes::from(serde_json::to_vec(&forecast).map_err(|error| Problem::internal(&error))?);
    let tag = Sha256::digest(&body).iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    Ok((tag, body))
}

/// How far the schedule is, by the states that were received last; absent where they are of another one.
fn begun(server: &Server, address: &Address, sha256: &str, at_utc: Utc) -> Option<PlanBegun> {
    let model = server.network.read();
    let telescope = model.telescopes.get(address)?;
    let (_, schedule) = telescope.read::<ScheduleState>(&Key::Observatory(address.clone(), Part::Schedule))?;
    let night = telescope.read::<NightState>(&Key::Observatory(address.clone(), Part::Night));
    let rows = schedule.rows.iter().filter(|row| row.status != RowStatus::Pending);
    let rows = rows.map(|row| RowBegun { row: row.row, status: row.status, frames: row.frames }).collect();
    let open = night.is_some_and(|(_, night)| night.posture == Posture::Open);
    (schedule.sha256.as_deref() == Some(sha256)).then_some(PlanBegun { at_utc, open, rows })
}

/// The hash of the schedule in force, as it was published last.
pub(super) fn sha256_in_force(server: &Server, address: &Address) -> Option<String> {
    let key = Key::Observatory(address.clone(), Part::Schedule);
    let model = server.network.read();
    model.telescopes.get(address)?.read::<ScheduleState>(&key)?.1.sha256
}
