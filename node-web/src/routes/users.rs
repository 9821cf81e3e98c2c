//! The users: for an engineer of all telescopes all of them, and for everybody their own password.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use axum::{Extension, Json};
use contract::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use users::{Grant, NameFault, PasswordFault, PasswordHash, Principal, Secret, User, Users, Way};

use crate::authentication::{Authentication, Client, Refusal};
use crate::json_body::JsonBody;
use crate::problem::{Code, Problem};
use crate::server::Server;

/// `GET /api/v1/users`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct UserList {
    /// By name.
    items: Vec<UserItem>,
    /// True while there is no users file: programs of the server's host are asked nothing, and the first user that is made has to be an
    /// engineer of all telescopes.
    open: bool,
}

/// A user, without what proves one.
#[derive(Debug, JsonSchema, Serialize)]
pub struct UserItem {
    /// The name to log in with.
    name: Name,
    /// What the user may do, and where, such as `operator:paranal/*`.
    rights: Vec<Grant>,
    /// Browsers in which the user is logged in at this server now.
    sessions: usize,
    /// Since the last request of these, at most two hours; absent where there are none.
    idle_s: Option<u64>,
    /// Tokens that act for the user, expired ones too.
    tokens: usize,
}

/// `PUT /api/v1/users/{name}`. It has no `Debug`, so that no log shows a password.
#[derive(JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserChange {
    /// All rights from now on, such as `viewer` and `operator:paranal/*`; where absent, those before. A new user needs one or more.
    rights: Option<Vec<Grant>>,
    /// The password from now on, 12 characters or more; where absent, the one before. A new user needs one, unless a proxy signs people in
    /// (`web.trust_proxy`).
    password: Option<String>,
}

/// `PUT /api/v1/me/password`. It has no `Debug`, so that no log shows a password.
#[derive(JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnPassword {
    /// The password until now.
    old_password: String,
    /// The password from now on, 12 characters or more.
    new_password: String,
}

/// Lists users.
pub async fn list(Extension(authentication): Extension<Authentication>) -> Json<UserList> {
    let users = authentication.users();
    let open = users.is_none();
    let users = users.unwrap_or_default();
    Json(UserList { items: users.users.keys().map(|name| item(&authentication, &users, name)).collect(), open })
}

/// Makes or changes a user. The rights count from the next request on; another password ends the user's sessions.
pub async fn put(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
    headers: HeaderMap,
    JsonBody(asked): JsonBody<UserChange>,
) -> Result<Response, Problem> {
    refuse_token(&principal)?;
    let name: Name = name.parse().map_err(|fault| wrong("name", &fault))?;
    if authentication.users().is_none() && !client.local {
        return Err(Problem::forbidden(
            "Nobody is asked here, and the first user is made on the server's own host: by its page there, or by `starmesh user add`.",
        ));
    }
    let only_new = headers.get(header::IF_NONE_MATCH).is_some_and(|tag| tag == "*");
    let (user, proxied, is_open) = (name.clone(), authentication.is_behind_proxy(), principal.way == Way::Open);
    let (rights, password) = (asked.rights.as_deref().map(shown), asked.password.is_some());
    let (made, before, after) = authentication
        .edit(move |users| {
            if is_open && !users.users.is_empty() {
                return Err(Problem::unauthenticated("There are users now: log in.").into());
            }
            let (is_first, before) = (users.users.is_empty(), grants(users, &user));
            let made = users.keeping_engineer(|users| change(users, user.clone(), asked, only_new, proxied))?;
            if is_first && !users.has_engineer() {
                let why = "the first user has to be an engineer of all telescopes, who makes the others: expected [\"engineer\"]";
                return Err(wrong("rights", &why).into());
            }
            Ok((made, before, grants(users, &user)))
        })
        .await?;
    let (verb, what) = match made {
        true => ("make_user", json!({ "rights": after })),
        false => ("change_user", json!({ "rights_before": before, "rights": after, "other_password": password })),
    };
    server.note_user(&principal, &client, verb, &name, &what);
    tracing::info!(by = %principal, address = %client.address, user = %name, made, rights, password, "a user was changed");
    let users = authentication.users().unwrap_or_default();
    let status = if made { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, Json(item(&authentication, &users, &name))).into_response())
}

/// True where the user is a new one.
fn change(users: &mut Users, name: Name, asked: UserChange, only_new: bool, proxied: bool) -> Result<bool, Refusal> {
    let UserChange { rights, password } = asked;
    if rights.as_ref().is_some_and(Vec::is_empty) {
        return Err(wrong("rights", &"expected one or more, such as \"viewer\"; DELETE removes a user").into());
    }
    let free = users.is_free(&name);
    if let (false, Some(user)) = (only_new, users.users.get_mut(&name)) {
        if rights.is_none() && password.is_none() {
            return Err(Problem::invalid("Expected rights, a password, or both: there is nothing to change.").into());
        }
        if let Some(password) = password {
            user.password = hashed("password", &password, &name)?;
        }
        user.grants = rights.unwrap_or_else(|| user.grants.clone());
        return Ok(false);
    }
    free.map_err(|fault| {
        let code = if matches!(fault, NameFault::Taken(_)) { Code::Precondition } else { Code::Conflict };
        Problem::new(code, "Name taken", format!("{fault}."))
    })?;
    let missing = |member| wrong(member, &format!("there is no user {name} yet, and a new one needs it"));
    let grants = rights.ok_or_else(|| missing("rights"))?;
    let password = match password {
        // Nobody knows it: the proxy alone lets this user in.
        None if proxied => Secret::fresh("")?.reveal().to_owned(),
        password => password.ok_or_else(|| missing("password"))?,
    };
    let password = hashed("password", &password, &name)?;
    users.users.insert(name, User { password, grants });
    Ok(true)
}

/// Removes a user with their sessions, tokens and the devices that get alerts.
pub async fn remove(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<StatusCode, Problem> {
    refuse_token(&principal)?;
    let none = || Problem::not_found("There is no such user; GET /api/v1/users lists all.");
    let name: Name = name.parse().map_err(|_| none())?;
    if authentication.users().is_none() {
        return Err(none());
    }
    let gone = name.clone();
    let removed = move |users: &mut Users| -> Result<_, Refusal> {
        let before = grants(users, &gone);
        if users.remove(&gone) { Ok(before) } else { Err(none().into()) }
    };
    let before = authentication.edit(|users| users.keeping_engineer(removed)).await?;
    server.note_user(&principal, &client, "remove_user", &name, &json!({ "rights_before": before }));
    // At once: in a moment another person may have the name.
    if let Err(error) = server.push.retain(|_, one| one.user != name.as_str()).await {
        // The user is removed; the phones follow with the next look at the users.
        tracing::error!(user = %name, %error, "the push subscriptions of a removed user are not removed yet");
    }
    tracing::info!(by = %principal, address = %client.address, user = %name, "a user was removed");
    Ok(StatusCode::NO_CONTENT)
}

/// Gives the caller another password. All sessions of theirs end, this one too.
pub async fn own_password(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(client): Extension<Client>,
    JsonBody(OwnPassword { old_password, new_password }): JsonBody<OwnPassword>,
) -> Result<StatusCode, Problem> {
    refuse_token(&principal)?;
    let users = authentication.users().unwrap_or_default();
    let Some((name, before)) = users.user(&principal.name).map(|(name, user)| (name.clone(), user.password.clone()))
    else {
        let detail = format!("{principal} is not in the users file of this server, and so has no password here.");
        return Err(Problem::new(Code::Conflict, "No password here", detail));
    };
    let proven = authentication.verify(users, name.as_str(), old_password, client.address).await?;
    if proven.is_none() {
        tracing::warn!(user = %name, address = %client.address, "a password was not changed: the old one was wrong");
        return Err(wrong("old_password", &"it is not your password; an engineer can give you another one"));
    }
    let user = name.clone();
    authentication
        .edit(move |users| {
            // Somebody may have changed it while the old one was verified.
            let found = users.users.get_mut(&user).filter(|found| found.password == before);
            let found =
                found.ok_or_else(|| Problem::unauthenticated("Your password was changed meanwhile: log in again."))?;
            found.password = hashed("new_password", &new_password, &user)?;
            Ok(())
        })
        .await?;
    server.note_user(&principal, &client, "change_own_password", &name, &json!({}));
    tracing::info!(user = %name, address = %client.address, "a user has changed their password");
    Ok(StatusCode::NO_CONTENT)
}

/// One that leaked could otherwise make itself a user and outlive its end.
fn refuse_token(principal: &Principal) -> Result<(), Problem> {
    match principal.way {
        Way::Token => Err(Problem::forbidden("A token changes no users and no password: log in with a password.")),
        _ => Ok(()),
    }
}

fn item(authentication: &Authentication, users: &Users, name: &Name) -> UserItem {
    let now = authentication.now().0;
    let sessions = authentication.sessions();
    let idle: Vec<Duration> = sessions
        .list(now)
        .filter(|(_, session)| session.user == *name)
        .map(|(_, session)| session.ages(now).0)
        .collect();
    UserItem {
        name: name.clone(),
        rights: grants(users, name).unwrap_or_default(),
        sessions: idle.len(),
        idle_s: idle.iter().min().map(Duration::as_secs),
        tokens: users.tokens.values().filter(|token| token.user == *name).count(),
    }
}

fn grants(users: &Users, name: &Name) -> Option<Vec<Grant>> {
    users.users.get(name).map(|user| user.grants.clone())
}

fn shown(rights: &[Grant]) -> String {
    rights.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn hashed(member: &str, password: &str, name: &Name) -> Result<PasswordHash, Problem> {
    PasswordHash::of_new(password, name.as_str()).map_err(|fault| match fault {
        PasswordFault::Hash(_) => Problem::internal(&fault),
        weak => wrong(member, &weak),
    })
}

fn wrong(member: &str, why: &dyn std::fmt::Display) -> Problem {
    let message = format!("{member}: {why}.");
    Problem::invalid(message.clone()).with("errors", json!([{ "pointer": format!("/{member}"), "message": message }]))
}
