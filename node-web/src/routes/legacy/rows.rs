//! The rows of the schedule, the lines of the log and the newest image, as Astra answered them.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse as _, Response};
use contract::node::Level;
use contract::observatory::{RowState, RowStatus, ScheduleState};
use contract::{Address, Key, Part};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;
use users::Principal;

use super::{LegacyQuery, instead, the_telescope};
use crate::diary::Line;
use crate::json_body::AskedFor;
use crate::network::lines;
use crate::problem::Problem;
use crate::routes::heartbeat::legacy_time;
use crate::routes::preview;
use crate::server::Server;

/// A row of the schedule as Astra wrote it.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacyRow {
    device_name: String,
    action_type: String,
    action_value: LegacyValue,
    start_time: String,
    end_time: String,
    completed: bool,
    status: &'static str,
    #[serde(rename = "start_HHMMSS")]
    start_clock: String,
    #[serde(rename = "end_HHMMSS")]
    end_clock: String,
}

/// What is known of the parameters of a row.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacyValue {
    #[serde(skip_serializing_if = "Option::is_none")]
    object: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    n: Option<u32>,
}

/// A line of the log as Astra wrote it.
#[derive(Debug, JsonSchema, Serialize)]
pub struct LegacyLine {
    datetime: String,
    level: &'static str,
    message: String,
}

/// Which lines.
#[derive(Debug, JsonSchema, Deserialize)]
pub struct LegacyLogQuery {
    /// As its id or as `site/telescope`; needed where there are several.
    telescope: Option<String>,
    /// Before this time, UTC; now where absent.
    datetime: Option<Utc>,
    /// At most so many, the newest; 100 where absent.
    limit: Option<u16>,
}

/// The rows of the schedule.
pub async fn schedule(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyQuery>,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let key = Key::Observatory(address.clone(), Part::Schedule);
    let model = server.network.read();
    let schedule = model.telescopes.get(&address).and_then(|telescope| telescope.read::<ScheduleState>(&key));
    let rows: Vec<LegacyRow> = schedule.into_iter().flat_map(|(_, schedule)| schedule.rows).map(row).collect();
    Ok(instead("schedule", &address, Json(rows).into_response()))
}

fn row(row: RowState) -> LegacyRow {
    LegacyRow {
        device_name: row.camera,
        action_type: row.action,
        action_value: LegacyValue { object: row.object, n: row.frames_wanted },
        start_time: row.start_utc.strftime("%Y-%m-%dT%H:%M:%S.%3f"),
        end_time: row.end_utc.strftime("%Y-%m-%dT%H:%M:%S.%3f"),
        completed: row.status == RowStatus::Finished,
        status: match row.status {
            RowStatus::Pending | RowStatus::Interrupted => "pending",
            RowStatus::Running => "running",
            RowStatus::Finished => "finished",
            RowStatus::Failed | RowStatus::Skipped => "failed",
        },
        start_clock: row.start_utc.strftime("%H:%M:%S"),
        end_clock: row.end_utc.strftime("%H:%M:%S"),
    }
}

impl LegacyLine {
    /// A line as Astra wrote it.
    pub fn of(line: &Line) -> Self {
        Self {
            datetime: legacy_time(line.at_utc),
            level: match line.line.level {
                Level::Error => "error",
                Level::Warn => "warning",
                Level::Info => "info",
            },
            message: line.line.text(),
        }
    }

    /// Says that lines are missing here.
    pub fn of_a_gap(at_utc: Utc, address: &Address) -> Self {
        let message = format!("Lines are missing here: /api/v1/telescopes/{address}/log has them.");
        Self { datetime: legacy_time(at_utc), level: "warning", message }
    }
}

/// The last lines of the log, of the telescope and of what its site shares.
pub async fn log(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyLogQuery>,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let model = server.network.read();
    let lines = lines(&model, &caller, Some(&address), Level::Info, 0).into_iter();
    let is_wanted = |line: &Line| query.datetime.is_none_or(|before| line.at_utc < before);
    let lines = lines.filter(|(_, line)| is_wanted(line)).map(|(_, line)| LegacyLine::of(line));
    let mut lines: Vec<LegacyLine> = lines.collect();
    lines.drain(..lines.len().saturating_sub(query.limit.unwrap_or(100).into()));
    Ok(instead("log", &address, Json(lines).into_response()))
}

/// The newest image.
pub async fn latest_image(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    AskedFor(query): AskedFor<LegacyQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let address = the_telescope(&server, &caller, query.telescope.as_deref())?;
    let image = preview::answer(&server, &address, None, &headers);
    Ok(instead("image.jpg", &address, image))
}
