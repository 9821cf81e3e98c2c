//! The sessions that are open: one's own, and for an engineer all.

use axum::extract::Path;
use axum::http::StatusCode;
use axum::{Extension, Json};
use schemars::JsonSchema;
use serde::Serialize;
use units::Utc;
use users::{Principal, Right};

use crate::authentication::{Authentication, Credential, Session};
use crate::problem::Problem;

/// `GET /api/v1/sessions`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SessionList {
    /// The newest first.
    items: Vec<SessionItem>,
}

/// A browser in which somebody has logged in.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SessionItem {
    /// For `DELETE /api/v1/sessions/{id}`; it proves nothing.
    id: String,
    /// Its user.
    user: String,
    /// From which address the user logged in.
    address: String,
    /// When.
    began_utc: Utc,
    /// Since its last request.
    idle_s: u64,
    /// Until its end, unless it is used.
    ends_in_s: u64,
    /// Is it the one of this request?
    current: bool,
}

/// Lists sessions.
pub async fn list(
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(credential): Extension<Credential>,
) -> Json<SessionList> {
    let now = authentication.now().0;
    let sessions = authentication.sessions();
    let seen = sessions.list(now).filter(|(_, session)| is_for(&principal, session));
    let mut items: Vec<SessionItem> = seen
        .map(|(hash, session)| {
            let (idle, left) = session.ages(now);
            SessionItem {
                id: session.id.clone(),
                user: session.user.to_string(),
                address: session.address.to_string(),
                began_utc: session.began_utc,
                idle_s: idle.as_secs(),
                ends_in_s: left.as_secs(),
                current: credential == Credential::Session(*hash),
            }
        })
        .collect();
    items.sort_by(|a, b| b.began_utc.cmp(&a.began_utc).then_with(|| a.id.cmp(&b.id)));
    Json(SessionList { items })
}

/// Ends a session, by which its browser is logged out.
pub async fn end(
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let ended = authentication.sessions().end_all(|_, session| session.id == id && is_for(&principal, session));
    if ended == 0 {
        return Err(Problem::not_found("There is no such session of yours."));
    }
    tracing::info!(by = %principal, id, "a session was ended");
    Ok(StatusCode::NO_CONTENT)
}

fn is_for(principal: &Principal, session: &Session) -> bool {
    principal.right_everywhere() == Some(Right::Engineer) || session.user.as_str() == principal.name
}
