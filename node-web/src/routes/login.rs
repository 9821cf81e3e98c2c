//! Logging in and out, and asking who one is.

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;
use users::{Grant, Principal, SecretHash, Way};

use crate::authentication::{
    Authentication, Client, Credential, LONGEST, TICKET_VALID, presented_session, session_cookie,
};
use crate::json_body::JsonBody;
use crate::problem::{Code, Problem};

/// Longer passwords are refused before they cost anything; none is made that long.
const LONGEST_PASSWORD: usize = 1024;

/// `POST /api/v1/login`: what proves a person. It has no `Debug`, so that no log shows a password.
#[derive(JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoginRequest {
    /// The user's name.
    name: String,
    /// The user's password.
    password: String,
}

/// `GET /api/v1/me`, and the answer to a login: who asks, and what they may do.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Me {
    /// The user's name; `local` for a program of this host where there are no users.
    name: String,
    /// How it was proven: `session`, `token`, `proxy`, or `open` where nothing is asked.
    way: Way,
    /// What the user may do, such as `operator:paranal/*`.
    rights: Vec<Grant>,
    /// When the session ends at the latest; earlier if nothing is asked for two hours.
    #[serde(skip_serializing_if = "Option::is_none")]
    session_ends_utc: Option<Utc>,
    /// True while everybody who reaches this server may do everything; pages show a banner then.
    insecure_open: bool,
}

/// `POST /api/v1/ws-ticket`: what opens one socket, as `/api/v1/ws?ticket=...`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SocketTicket {
    /// Works once.
    ticket: String,
    /// For so long.
    valid_s: u64,
}

/// Begins a session: the answer sets its cookie.
pub async fn log_in(
    Extension(authentication): Extension<Authentication>,
    Extension(client): Extension<Client>,
    headers: HeaderMap,
    JsonBody(asked): JsonBody<LoginRequest>,
) -> Result<Response, Problem> {
    let Some(users) = authentication.users() else {
        let detail = "This server has no users and asks nobody; `starmesh user add` makes one.";
        return Err(Problem::new(Code::Conflict, "Nothing to log in to", detail));
    };
    if asked.password.len() > LONGEST_PASSWORD {
        return Err(wrong(&asked.name, false, client));
    }
    let before = users.user(&asked.name).map(|(_, user)| user.password.clone());
    let found = authentication.verify(users.clone(), &asked.name, asked.password, client.address).await?;
    let name = found.ok_or_else(|| wrong(&asked.name, before.is_some(), client))?;
    // The user may have been removed, or got another password, while this one was verified.
    let users = authentication.users().unwrap_or_default();
    let user = users.user(name.as_str()).filter(|(_, user)| before.as_ref() == Some(&user.password));
    let user = user.ok_or_else(|| wrong(&asked.name, true, client))?;
    let (machine, utc) = authentication.now();
    let secret = {
        let mut sessions = authentication.sessions();
        // Whatever session the browser had before, somebody else may know it.
        if let Some(old) = presented_session(&headers, client.encrypted) {
            sessions.end(&SecretHash::of(old));
        }
        sessions.begin(user, client.address, machine, utc).map_err(|why| Problem::internal(&why))?
    };
    tracing::info!(user = %name, address = %client.address, "a user has logged in");
    let principal = Principal { name: name.to_string(), way: Way::Session, grants: user.1.grants.clone() };
    let me = describe(&authentication, &principal, &Credential::Session(secret.hash()));
    let cookie = session_cookie(Some(secret.reveal()), client.encrypted);
    Ok(([(header::SET_COOKIE, cookie)], Json(me)).into_response())
}

/// The same answer whether there is such a user or not. A name that nobody has may be a password in the wrong field.
fn wrong(name: &str, is_user: bool, client: Client) -> Problem {
    let (user, address) = (if is_user { name } else { "(not a user)" }, client.address);
    tracing::warn!(user, %address, "a login failed: wrong name or password");
    Problem::unauthenticated("The name or the password is wrong.")
}

/// Ends the session of this request.
pub async fn log_out(
    Extension(authentication): Extension<Authentication>,
    Extension(client): Extension<Client>,
    Extension(principal): Extension<Principal>,
    Extension(credential): Extension<Credential>,
) -> Response {
    if let Credential::Session(hash) = credential {
        authentication.sessions().end(&hash);
        tracing::info!(user = %principal, address = %client.address, "a user has logged out");
    }
    let gone = session_cookie(None, client.encrypted);
    (StatusCode::NO_CONTENT, [(header::SET_COOKIE, gone)]).into_response()
}

/// Answers who asks.
pub async fn me(
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(credential): Extension<Credential>,
) -> Json<Me> {
    Json(describe(&authentication, &principal, &credential))
}

fn describe(authentication: &Authentication, principal: &Principal, credential: &Credential) -> Me {
    let session_ends_utc = match credential {
        Credential::Session(hash) => {
            let sessions = authentication.sessions();
            sessions.get(hash, authentication.now().0).map(|session| session.began_utc.plus(LONGEST))
        }
        _ => None,
    };
    Me {
        name: principal.name.clone(),
        way: principal.way,
        rights: principal.grants.clone(),
        session_ends_utc,
        insecure_open: authentication.is_insecurely_open(),
    }
}

/// Makes a ticket for a socket.
pub async fn ws_ticket(
    Extension(authentication): Extension<Authentication>,
    Extension(credential): Extension<Credential>,
) -> Result<Json<SocketTicket>, Problem> {
    let made =
        authentication.tickets().make(credential, authentication.now().0).map_err(|why| Problem::internal(&why))?;
    let ticket = made.ok_or_else(|| Problem::too_many("Too many tickets are waiting to be used.", TICKET_VALID))?;
    Ok(Json(SocketTicket { ticket: ticket.reveal().to_owned(), valid_s: TICKET_VALID.as_secs() }))
}
