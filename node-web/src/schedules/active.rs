//! The schedule in force and those before it, and what any other would find and do.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use contract::observatory::{
    ActionAnswer, ActionQuestion, SchedulePlanQuestion, ScheduleState, ScheduleTextQuestion, ScheduleVersion,
};
use contract::{Key, Part};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::body::ScheduleBody;
use super::{JSONL, asked};
use crate::drafts::etag;
use crate::json_body::AskedFor;
use crate::problem::Problem;
use crate::routes::network::{NEVER_CACHED, known};
use crate::routes::parts;
use crate::server::Server;

const USUAL_REVISIONS: u32 = 50;
const MOST_REVISIONS: u32 = 1000;
const ACTIONS_WITHIN: Duration = Duration::from_secs(5);

/// Which revisions.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RevisionsQuery {
    /// Only those before this one: to go back, ask again with the smallest number of the answer.
    before: Option<u64>,
    /// At most so many, the newest; 50 where absent.
    #[schemars(range(min = 1, max = 1000))]
    limit: Option<u32>,
}

/// A schedule that was in force.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Revision {
    /// By whom, when and why.
    #[serde(flatten)]
    pub version: ScheduleVersion,
    /// The whole text, comments included.
    pub text: String,
}

/// When the weather is assumed to be bad.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulateQuery {
    /// The weather is not safe then, as `FROM..TO`, several with a comma between them:
    /// 2026-11-21T03:00:00Z..2026-11-21T04:00:00Z.
    r#unsafe: Option<String>,
}

/// Which actions.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionsQuery {
    /// Only this `action_type`.
    action: Option<String>,
}

/// The rows in force with their progress, or the text.
pub async fn in_force(
    State(server): State<Arc<Server>>,
    Path(telescope): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if !wants_text(&headers) {
        return parts::part::<ScheduleState>(&server, &telescope, Part::Schedule);
    }
    let address = known(&server.network, &telescope.0, &telescope.1)?;
    let (text, sha256, _) = asked::text(&server, &address, None).await?;
    Ok(answer_text(text, &sha256, &headers))
}

/// The schedules that were in force.
pub async fn revisions(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    AskedFor(query): AskedFor<RevisionsQuery>,
) -> Result<Response, Problem> {
    let limit = query.limit.unwrap_or(USUAL_REVISIONS);
    if !(1..=MOST_REVISIONS).contains(&limit) {
        return Err(Problem::malformed(format!("limit: expected 1 to {MOST_REVISIONS}.")));
    }
    let address = known(&server.network, &site, &telescope)?;
    let question = ScheduleTextQuestion { version: None, list: Some(limit), before: query.before };
    let found = asked::texts(&server, &address, &question).await?;
    match found.problem {
        Some(why) => Err(Problem::not_found(format!("The schedules of {address} cannot be listed: {why}."))),
        None => Ok((NEVER_CACHED, Json(found.versions)).into_response()),
    }
}

/// One of them.
pub async fn revision(
    State(server): State<Arc<Server>>,
    Path((site, telescope, version)): Path<(String, String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let no_number = |_| Problem::not_found(format!("{version:?} is no number of a version: expected 1 or more."));
    let number: u64 = version.parse().map_err(no_number)?;
    let (text, sha256, mut found) = asked::text(&server, &address, Some(number)).await?;
    if wants_text(&headers) {
        return Ok(answer_text(text, &sha256, &headers));
    }
    let version = found.versions.pop().ok_or_else(|| Problem::not_found("It has just been forgotten."))?;
    Ok((NEVER_CACHED, Json(Revision { version, text })).into_response())
}

/// What is wrong with a schedule.
pub async fn validate(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    ScheduleBody(text): ScheduleBody,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let found = asked::findings(&server, &address, &text).await?;
    Ok((NEVER_CACHED, Json(found)).into_response())
}

/// What a schedule will do.
pub async fn simulate(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    AskedFor(query): AskedFor<SimulateQuery>,
    ScheduleBody(text): ScheduleBody,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let spans = query
        .r#unsafe
        .as_deref()
        .map(|spans| spans.split(',').map(span).collect())
        .unwrap_or_else(|| Ok(Vec::new()))?;
    let plan = asked::plan(&server, &address, &SchedulePlanQuestion { text, unsafe_utc: spans, begun: None }).await?;
    Ok((NEVER_CACHED, Json(plan)).into_response())
}

/// The actions that the telescope knows.
pub async fn action_schemas(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
    AskedFor(query): AskedFor<ActionsQuery>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let question = ActionQuestion { action: query.action };
    let key = Key::Actions(address.clone());
    let answer: ActionAnswer = asked::ask(&server, &address, &key, &question, ACTIONS_WITHIN).await?;
    match question.action {
        Some(action) if answer.actions.is_empty() => {
            Err(Problem::not_found(format!("{address} knows no action {action:?}; leave `action` out for all.")))
        }
        _ => Ok((NEVER_CACHED, Json(answer.actions)).into_response()),
    }
}

/// `FROM..TO`.
fn span(text: &str) -> Result<[Utc; 2], Problem> {
    let ends = text.split_once("..").and_then(|(from, to)| Some([from.trim().parse().ok()?, to.trim().parse().ok()?]));
    ends.filter(|[from, to]: &[Utc; 2]| from < to).ok_or_else(|| {
        let expected = "2026-11-21T03:00:00Z..2026-11-21T04:00:00Z";
        Problem::malformed(format!(
            "unsafe: expected FROM..TO such as {expected}, several with a comma between them, found {text:?}."
        ))
    })
}

/// Does the reader ask for the text?
pub(super) fn wants_text(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT).iter().filter_map(|accept| accept.to_str().ok());
    accepted.flat_map(|accept| accept.split(',')).any(|kind| kind.split(';').next().unwrap_or_default().trim() == JSONL)
}

/// A text under its tag, unless the reader has it.
pub(super) fn answer_text(text: String, tag: &str, headers: &HeaderMap) -> Response {
    let about = [(header::ETAG, etag::quoted(tag)), (header::VARY, "Accept".to_owned())];
    if etag::is_known(headers, tag) {
        return (StatusCode::NOT_MODIFIED, NEVER_CACHED, about).into_response();
    }
    (NEVER_CACHED, about, [(header::CONTENT_TYPE, JSONL)], text).into_response()
}
