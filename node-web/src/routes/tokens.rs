//! Tokens for programs: one's own, and for an engineer all.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use contract::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use units::Utc;
use users::{Grant, Principal, Right, Token, Users, Way};

use crate::authentication::{Authentication, Client, Refusal};
use crate::json_body::JsonBody;
use crate::problem::{Code, Problem};
use crate::server::Server;

const LONGEST_DAYS: u32 = 3650;
/// One user needs a few; the file is read by people.
const MOST_OF_USER: usize = 50;

/// `GET /api/v1/tokens`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TokenList {
    /// By name.
    items: Vec<TokenItem>,
}

/// A token, without its secret.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TokenItem {
    /// What it is for.
    name: Name,
    /// For whom it acts.
    user: Name,
    /// What it may do; all that its user may where absent.
    rights: Option<Vec<Grant>>,
    /// When it was made.
    made_utc: Utc,
    /// From when on it is refused.
    expires_utc: Utc,
}

/// `POST /api/v1/tokens`.
#[derive(Debug, JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// What it is for, such as `cron`.
    name: Name,
    /// For whom it acts; an engineer may name another user.
    user: Option<Name>,
    /// It is refused after so many days.
    days: u32,
    /// What it may do, such as `viewer`; all that its user may where absent.
    rights: Option<Vec<Grant>>,
}

/// The answer to `POST /api/v1/tokens`.
#[derive(JsonSchema, Serialize)]
pub struct MadeToken {
    /// For the header `Authorization: Bearer ...`; it is shown this once.
    token: String,
    /// What is stored of it.
    #[serde(flatten)]
    item: TokenItem,
}

/// Lists tokens.
pub async fn list(
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
) -> Json<TokenList> {
    let users = authentication.users().unwrap_or_default();
    let seen = users.tokens.iter().filter(|(_, token)| is_for(&principal, token));
    Json(TokenList { items: seen.map(|(name, token)| item(name, token)).collect() })
}

/// Makes a token. A token makes none: one that leaked could otherwise outlive its end.
pub async fn add(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(client): Extension<Client>,
    JsonBody(asked): JsonBody<NewToken>,
) -> Result<Response, Problem> {
    if principal.way == Way::Token {
        return Err(forbidden("A token makes no tokens: log in with a password."));
    }
    if !(1..=LONGEST_DAYS).contains(&asked.days) {
        return Err(invalid(format!("days = {}: expected 1 to {LONGEST_DAYS}", asked.days)));
    }
    let now = authentication.now().1;
    let by = principal.clone();
    let made = edit(&authentication, move |users| make(users, &by, asked, now)).await?;
    let TokenItem { name, user, rights, expires_utc, .. } = &made.item;
    let what = json!({ "name": name, "rights": rights, "expires_utc": expires_utc });
    server.note_user(&principal, &client, "make_token", user, &what);
    tracing::info!(by = %principal, %name, %user, "a token was made");
    Ok((StatusCode::CREATED, Json(made)).into_response())
}

fn make(users: &mut Users, by: &Principal, asked: NewToken, now: Utc) -> Result<MadeToken, Refusal> {
    let own: Name = by
        .name
        .parse()
        .map_err(|_| forbidden("This server has no users, so that there is nobody for whom a token acts."))?;
    let user = asked.user.unwrap_or_else(|| own.clone());
    if user != own && !is_engineer(by) {
        return Err(forbidden("Only an engineer of all telescopes makes tokens for others.").into());
    }
    let grants = match users.users.get(&user) {
        Some(found) => found.grants.clone(),
        None => return Err(invalid(format!("user = \"{user}\": there is no such user")).into()),
    };
    let wanted = asked.rights.as_ref().unwrap_or(&grants);
    if let Some(more) = wanted.iter().find(|grant| !grant.is_within(&grants) || !grant.is_within(&by.grants)) {
        return Err(forbidden(&format!("{more} is more than the rights of {user} and of {by} have in common.")).into());
    }
    if wanted.is_empty() {
        return Err(invalid("rights: expected one or more, such as \"viewer\"".to_owned()).into());
    }
    if users.tokens.contains_key(&asked.name) {
        let detail = format!("There is a token {} already: choose another name, or remove it first.", asked.name);
        return Err(Problem::new(Code::Conflict, "Name taken", detail).into());
    }
    if users.tokens.values().filter(|token| token.user == user).count() >= MOST_OF_USER {
        let detail = format!("{user} has {MOST_OF_USER} tokens: remove some first.");
        return Err(Problem::new(Code::Conflict, "Too many tokens", detail).into());
    }
    let expires = now.plus(Duration::from_secs(u64::from(asked.days) * 86_400));
    let secret = users.add_token(asked.name.clone(), user, asked.rights, now, expires)?;
    let token = users.tokens.get(&asked.name).ok_or_else(|| Problem::not_found("The token is gone."))?;
    Ok(MadeToken { token: secret.reveal().to_owned(), item: item(&asked.name, token) })
}

/// Takes a token away; it is refused from now on.
pub async fn remove(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<StatusCode, Problem> {
    let by = principal.clone();
    let (name, user) = edit(&authentication, move |users| {
        let found = users.tokens.iter().find(|(known, token)| known.as_str() == name && is_for(&by, token));
        let found = found.map(|(name, token)| (name.clone(), token.user.clone()));
        let (name, user) = found.ok_or_else(|| Problem::not_found("There is no such token of yours."))?;
        users.tokens.remove(&name);
        Ok((name, user))
    })
    .await?;
    server.note_user(&principal, &client, "remove_token", &user, &json!({ "name": name }));
    tracing::info!(by = %principal, %name, "a token was removed");
    Ok(StatusCode::NO_CONTENT)
}

/// Changes the tokens of users that there are.
async fn edit<T: Send + 'static>(
    authentication: &Authentication,
    change: impl FnOnce(&mut Users) -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Problem> {
    if authentication.users().is_none() {
        return Err(Problem::not_found(
            "This server has no users, and so no tokens; `starmesh user add` makes a user.",
        ));
    }
    authentication.edit(change).await
}

fn item(name: &Name, token: &Token) -> TokenItem {
    let Token { user, grants, made_utc, expires_utc, .. } = token;
    let (made_utc, expires_utc) = (*made_utc, *expires_utc);
    TokenItem { name: name.clone(), user: user.clone(), rights: grants.clone(), made_utc, expires_utc }
}

fn is_for(principal: &Principal, token: &Token) -> bool {
    is_engineer(principal) || token.user.as_str() == principal.name
}

fn is_engineer(principal: &Principal) -> bool {
    principal.right_everywhere() == Some(Right::Engineer)
}

fn forbidden(detail: &str) -> Problem {
    Problem::new(Code::Forbidden, "Not allowed", detail)
}

fn invalid(detail: String) -> Problem {
    Problem::new(Code::Validation, "Not as expected", detail)
}
