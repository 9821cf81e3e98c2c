//! Drafts: stored, compared with the schedule in force, and put in its place.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use contract::{Address, Name};
use schedule::difference::difference;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};
use users::Principal;

use super::active::{answer_text, wants_text};
use super::asked;
use super::body::ScheduleBody;
use super::difference::ScheduleDifference;
use super::forecast::sha256_in_force;
use crate::authentication::Client;
use crate::commands::{CommandRequest, carry_out, is_repeat};
use crate::drafts::etag::{Demand, is_known, quoted};
use crate::drafts::{DraftSummary, StoredDraft};
use crate::json_body::JsonBody;
use crate::problem::{Code, Problem};
use crate::routes::network::{NEVER_CACHED, known};
use crate::server::Server;

/// A draft with its text.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Draft {
    /// About it.
    #[serde(flatten)]
    pub about: DraftSummary,
    /// The whole text, comments included.
    pub text: String,
}

/// Why a draft is put in force.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActivateRequest {
    /// Why, for the list of revisions and the log.
    #[serde(default)]
    pub reason: String,
    /// The person who orders it, where this server asks nobody to sign in.
    pub operator: Option<String>,
    /// ETag of the draft that was looked at, as `diff` gives it: where somebody has changed it since, nothing is put in force.
    /// Whatever it is now counts where this is absent.
    pub draft_etag: Option<String>,
}

/// The telescope and the draft of a path.
fn place(server: &Server, (site, telescope, id): &(String, String, String)) -> Result<(Address, Name), Problem> {
    let address = known(&server.network, site, telescope)?;
    let id = id.parse().map_err(|error| Problem::not_found(format!("{id:?} is no name of a draft: {error}.")))?;
    Ok((address, id))
}

/// The drafts of a telescope.
pub async fn list(
    State(server): State<Arc<Server>>,
    Path((site, telescope)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    Ok((NEVER_CACHED, Json(server.drafts.list(&address).await?)).into_response())
}

/// One draft, with its text or as its text.
pub async fn read(
    State(server): State<Arc<Server>>,
    Path(path): Path<(String, String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (address, id) = place(&server, &path)?;
    let draft = server.drafts.read(&address, &id).await?;
    if wants_text(&headers) {
        let tag = draft.etag();
        return Ok(answer_text(draft.text, &tag, &headers));
    }
    let about = DraftSummary::of(id, &draft);
    let tagged = [(header::ETAG, quoted(&about.etag)), (header::VARY, "Accept".to_owned())];
    if is_known(&headers, &about.etag) {
        return Ok((StatusCode::NOT_MODIFIED, NEVER_CACHED, tagged).into_response());
    }
    Ok((NEVER_CACHED, tagged, Json(Draft { about, text: draft.text })).into_response())
}

/// Stores a draft.
pub async fn put(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path(path): Path<(String, String, String)>,
    headers: HeaderMap,
    ScheduleBody(text): ScheduleBody,
) -> Result<Response, Problem> {
    let (address, id) = place(&server, &path)?;
    let demand =
        Demand::of(&headers, "If-None-Match: * for a new draft, or If-Match with the ETag of the one that you read")?;
    let based_on = sha256_in_force(&server, &address);
    let draft = StoredDraft { text, author: caller.name.clone(), changed_utc: server.network.clock().utc(), based_on };
    let (stored, is_new) = server.drafts.put(&address, &id, demand, draft).await?;
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    let location = format!("/api/v1/telescopes/{address}/schedule/drafts/{id}");
    let about = DraftSummary::of(id, &stored);
    let headers = [(header::ETAG, quoted(&about.etag)), (header::LOCATION, location)];
    Ok((status, NEVER_CACHED, headers, Json(about)).into_response())
}

/// Removes a draft.
pub async fn remove(
    State(server): State<Arc<Server>>,
    Path(path): Path<(String, String, String)>,
    headers: HeaderMap,
) -> Result<StatusCode, Problem> {
    let (address, id) = place(&server, &path)?;
    let demand = Demand::of(&headers, "If-Match with the ETag of the draft that you read")?;
    server.drafts.remove(&address, &id, demand).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// What would change if a draft were put in force now.
pub async fn diff(
    State(server): State<Arc<Server>>,
    Path(path): Path<(String, String, String)>,
) -> Result<Response, Problem> {
    let (address, id) = place(&server, &path)?;
    let draft = server.drafts.read(&address, &id).await?;
    let (text, sha256, _) = asked::text(&server, &address, None).await?;
    let tag = draft.etag();
    let found = tokio::task::spawn_blocking(move || difference(&text, &draft.text)).await;
    let found = found.map_err(|lost| Problem::internal(&lost))?;
    Ok((NEVER_CACHED, Json(ScheduleDifference::of(found, sha256, tag))).into_response())
}

/// Puts a draft in force.
pub async fn activate(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Extension(client): Extension<Client>,
    Path(path): Path<(String, String, String)>,
    headers: HeaderMap,
    JsonBody(request): JsonBody<ActivateRequest>,
) -> Result<Response, Problem> {
    let (address, id) = place(&server, &path)?;
    let demand = Demand::of(&headers, "If-Match with the ETag of the schedule in force, or * to replace whichever is")?;
    let is_repeat = is_repeat(&server, &caller, &address, &headers)?;
    let draft = server.drafts.read(&address, &id).await?;
    let instead_of = match demand {
        Demand::Exists => None,
        Demand::Is(tags) if tags.len() == 1 => tags.into_iter().next(),
        Demand::Is(_) | Demand::IsNew => {
            return Err(Problem::malformed(
                "If-Match: expected one ETag in double quotes: that of the schedule in force.",
            ));
        }
    };
    let ActivateRequest { reason, operator, draft_etag } = request;
    let now = draft.etag();
    if let Some(looked_at) = draft_etag.filter(|tag| tag.trim_matches('"') != now) {
        let detail = format!("The draft {id} is {now} and not {looked_at} any more: look at it again.");
        return Err(Problem::new(Code::Precondition, "Somebody changed the draft", detail));
    }
    if !is_repeat {
        let found = asked::findings(&server, &address, &draft.text).await?;
        if !found.valid {
            return Err(asked::refused(&found.findings, found.errors as usize));
        }
    }
    let mut parameters = Map::from_iter([("text".to_owned(), json!(draft.text))]);
    parameters.extend(instead_of.map(|sha256| ("instead_of".to_owned(), json!(sha256))));
    let request = CommandRequest { command: "put-schedule".to_owned(), parameters, reason, operator, deadline_s: None };
    carry_out(&server, &caller, client, address, &headers, request).await
}
