//! Records in the audit of what was changed about users over the page and the API, and of what was refused.

use std::sync::Arc;

use audit::Entry;
use axum::extract::{Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;
use contract::audit::AuditOutcome;
use contract::{CommandId, Name, Reason};
use serde_json::Value;
use users::Principal;

use crate::authentication::{Authentication, Client};
use crate::problem::ProblemDocument;
use crate::server::Server;

const OWN_PASSWORD: &str = "/api/v1/me/password";
const TOKENS: &str = "/api/v1/tokens";
const ONE_TOKEN: &str = "/api/v1/tokens/";
const ONE_USER: &str = "/api/v1/users/";

impl Server {
    /// Records what `by` has done about a user; `what` has never a password or a token.
    pub fn note_user(&self, by: &Principal, client: &Client, verb: &str, user: &Name, what: &Value) {
        self.note_outcome(by, client, (verb, user.as_str()), what.to_string(), AuditOutcome::Done);
    }

    fn note_outcome(
        &self,
        by: &Principal,
        client: &Client,
        (verb, user): (&str, &str),
        parameters: String,
        outcome: AuditOutcome,
    ) {
        self.audit.note(Entry {
            from: format!("web/{by}@{}", client.address),
            id: CommandId::default(),
            device: format!("user/{user}"),
            verb: verb.to_owned(),
            parameters,
            token: None,
            reason: String::new(),
            outcome,
        });
    }
}

/// Records each change of users that is refused, or fails; what is done is recorded where it is done.
pub async fn note_refused_changes(State(server): State<Arc<Server>>, request: Request, next: Next) -> Response {
    let asked = asked(&request);
    let response = next.run(request).await;
    if let Some((by, client, verb, user)) = asked
        && let Some(outcome) = not_done(&response)
    {
        let user = user.as_ref().map_or("?", Name::as_str);
        server.note_outcome(&by, &client, (verb, user), "{}".to_owned(), outcome);
    }
    response
}

/// Who asks for which change of which user. A user is named only where it is the name of one: others may be of any length.
fn asked(request: &Request) -> Option<(Principal, Client, &'static str, Option<Name>)> {
    let (extensions, path) = (request.extensions(), request.uri().path());
    let (by, client) = (extensions.get::<Principal>()?, extensions.get::<Client>()?);
    let own = || by.name.parse::<Name>().ok();
    let (verb, user) = match *request.method() {
        Method::PUT if path == OWN_PASSWORD => ("change_own_password", own()),
        Method::PUT => {
            let user = path.strip_prefix(ONE_USER)?.parse::<Name>().ok();
            let users = extensions.get::<Authentication>().and_then(Authentication::users);
            let is_known = user.as_ref().is_some_and(|user| users.is_some_and(|users| users.users.contains_key(user)));
            (if is_known { "change_user" } else { "make_user" }, user)
        }
        Method::DELETE if path.starts_with(ONE_TOKEN) => ("remove_token", own()),
        Method::DELETE => ("remove_user", path.strip_prefix(ONE_USER)?.parse::<Name>().ok()),
        Method::POST if path == TOKENS => ("make_token", own()),
        _ => return None,
    };
    Some((by.clone(), *client, verb, user))
}

/// Why a request was not carried out; nothing where it was.
fn not_done(response: &Response) -> Option<AuditOutcome> {
    let status = response.status();
    let told = response.extensions().get::<ProblemDocument>().map(ProblemDocument::for_record);
    let detail = told.unwrap_or_else(|| status.to_string());
    match status.as_u16() {
        400 | 413 | 415 | 422 => Some(AuditOutcome::Refused { reason: Reason::Malformed, detail }),
        401..=499 => Some(AuditOutcome::Refused { reason: Reason::NotNow, detail }),
        500..=599 => Some(AuditOutcome::Failed { detail }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;
    use axum::response::IntoResponse as _;
    use serde_json::json;

    use super::*;
    use crate::problem::{Code, Problem};

    #[test]
    fn a_record_says_why_and_never_what_stands_in_a_request() {
        let detail = |problem: Problem| match not_done(&problem.into_response()) {
            Some(AuditOutcome::Refused { reason, detail }) => (reason, detail),
            other => panic!("{other:?}"),
        };
        let last = Problem::new(Code::Conflict, "The last engineer", "make another engineer first.");
        assert_eq!(detail(last), (Reason::NotNow, "make another engineer first.".to_owned()));
        let secret = "invalid type: string \"hunter2\"";
        let wrong = Problem::invalid(secret).with("errors", json!([{ "pointer": "/password", "message": secret }]));
        let title = "Something in the request is wrong";
        assert_eq!(detail(wrong), (Reason::Malformed, format!("{title}: /password")));
        assert_eq!(detail(Problem::invalid(secret)), (Reason::Malformed, title.to_owned()));
        assert_eq!(not_done(&StatusCode::NO_CONTENT.into_response()), None);
    }
}
