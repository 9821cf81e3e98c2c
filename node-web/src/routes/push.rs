//! The browsers that get alerts: one's own, and for an engineer all.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::{Extension, Json};
use contract::observatory::Priority;
use notify::push::{NotTaken, Refused, Subscription};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;
use users::{Principal, Right, Way};

use crate::authentication::{Authentication, Credential};
use crate::json_body::JsonBody;
use crate::problem::{Code, Problem};
use crate::server::Server;

const LONGEST_NAME: usize = 60;

/// `GET /api/v1/push`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct PushState {
    /// The telescope whose alerts are sent.
    telescope: String,
    /// The public key of this server, base64url: what a browser subscribes with (`applicationServerKey`).
    key: String,
    /// The devices that get them, by user and name.
    devices: Vec<PushDevice>,
}

/// A browser that gets alerts.
#[derive(Debug, JsonSchema, Serialize)]
pub struct PushDevice {
    /// The first 16 hexadecimal digits of the SHA-256 of its endpoint.
    id: String,
    /// Whose it is.
    user: String,
    /// How its user calls it.
    device: String,
    /// Nothing less urgent than this.
    min_priority: Priority,
    /// Only what nobody has acknowledged for so many minutes.
    after_min: f64,
    /// When it was switched on.
    since_utc: Utc,
}

impl PushDevice {
    fn of(one: &Subscription) -> Self {
        let (user, device) = (one.user.clone(), one.device.clone());
        let Subscription { min_priority, after_min, since_utc, .. } = *one;
        Self { id: one.id(), user, device, min_priority, after_min, since_utc }
    }
}

/// The answer to `POST /api/v1/push/subscriptions`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct SubscribedDevice {
    /// A new device gets a message at once, which says that it gets alerts: was one sent?
    tried: bool,
    /// Why its push service has not taken that message, though it may take later ones; it has taken it where this is absent.
    error: Option<String>,
    /// What it gets from now on.
    #[serde(flatten)]
    subscribed: PushDevice,
}

/// `POST /api/v1/push/subscriptions`.
#[derive(JsonSchema, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewSubscription {
    /// What the browser's `PushSubscription` is as JSON.
    subscription: BrowserSubscription,
    /// The public key that it was made with: that of `GET /api/v1/push`.
    key: String,
    /// How you call the device, at most 60 characters.
    device: String,
    /// Nothing less urgent than this; `high` where absent.
    #[serde(default = "high")]
    min_priority: Priority,
    /// Only what nobody has acknowledged for so many minutes, 0 to 1440; 0 where absent.
    #[serde(default)]
    after_min: f64,
}

/// A browser's `PushSubscription` as JSON.
#[derive(JsonSchema, Deserialize)]
pub struct BrowserSubscription {
    /// Its address at the push service.
    endpoint: String,
    /// Its keys.
    keys: BrowserKeys,
}

/// The keys of a browser's subscription, base64url.
#[derive(JsonSchema, Deserialize)]
pub struct BrowserKeys {
    /// Its public key.
    p256dh: String,
    /// The secret that it shares with this server.
    auth: String,
}

fn high() -> Priority {
    Priority::High
}

/// Lists them, with what a browser needs to become one.
pub async fn state(State(server): State<Arc<Server>>, Extension(principal): Extension<Principal>) -> Json<PushState> {
    let known = server.push.watch();
    let known = known.borrow();
    let mut devices: Vec<_> = known.values().filter(|one| is_for(&principal, one)).map(PushDevice::of).collect();
    devices.sort_by(|a, b| (&a.user, &a.device, &a.id).cmp(&(&b.user, &b.device, &b.id)));
    Json(PushState { telescope: server.config.address().to_string(), key: server.push.public_key(), devices })
}

/// Takes a browser's subscription, a new one after a first message; another one of the same browser takes its place. A token makes none:
/// one that leaked could otherwise outlive its end.
pub async fn subscribe(
    State(server): State<Arc<Server>>,
    Extension(authentication): Extension<Authentication>,
    Extension(principal): Extension<Principal>,
    Extension(credential): Extension<Credential>,
    JsonBody(asked): JsonBody<NewSubscription>,
) -> Result<(StatusCode, Json<SubscribedDevice>), Problem> {
    let (address, user) = (server.config.address(), principal.name.clone());
    if principal.way == Way::Token {
        return Err(Problem::forbidden(
            "A token gets no alerts: log in with a password on the device that shall show them.",
        ));
    }
    if principal.right_at(&address).is_none() {
        return Err(Problem::forbidden(format!(
            "This server sends alerts of {address}, and {user} has no right there."
        )));
    }
    let NewSubscription { subscription, key, device, min_priority, after_min } = asked;
    if key != server.push.public_key() {
        let detail = "key: the browser has subscribed with another key than that of this server: read GET /api/v1/push again, \
                      and subscribe anew.";
        return Err(Problem::new(Code::Conflict, "Another key", detail));
    }
    if !(1..=LONGEST_NAME).contains(&device.chars().count()) || device.chars().any(char::is_control) {
        return Err(Problem::invalid(format!("device: expected a name of 1 to {LONGEST_NAME} characters.")));
    }
    if !(0.0..=1440.0).contains(&after_min) {
        return Err(Problem::invalid(format!("after_min = {after_min}: expected 0 to 1440.")));
    }
    let (BrowserSubscription { endpoint, keys }, since_utc) = (subscription, authentication.now().1);
    let BrowserKeys { p256dh, auth } = keys;
    let new = Subscription { user, device, endpoint, p256dh, auth, min_priority, after_min, since_utc };
    let subscribed = PushDevice::of(&new);
    let tried = server.push.check(&new).map_err(not_taken)?;
    let error = if tried { try_first(&server, &new).await? } else { None };
    // That took a while: somebody who was removed meanwhile gets nothing.
    authentication.principal(&credential)?;
    server.push.add(new).await.map_err(not_taken)?;
    tracing::info!(by = %principal, device = subscribed.device, id = subscribed.id, tried, error, "a browser gets alerts");
    Ok((StatusCode::CREATED, Json(SubscribedDevice { tried, error, subscribed })))
}

/// Sends a new browser its first message: why its push service has not taken it, where it may take later ones.
async fn try_first(server: &Server, to: &Subscription) -> Result<Option<String>, Problem> {
    match notify::send_first(&server.config, &server.push, to, server.bus.clock().utc()).await {
        Ok(()) => Ok(None),
        Err(why) if why.is::<Refused>() => Err(Problem::invalid(format!(
            "subscription: its push service takes no message for this browser: {why}. Nothing was stored: try again on that device."
        ))),
        Err(why) => Ok(Some(format!("{why:#}"))),
    }
}

/// Sends a browser no more alerts.
pub async fn unsubscribe(
    State(server): State<Arc<Server>>,
    Extension(principal): Extension<Principal>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let removed = server.push.retain(|known, one| known != id || !is_for(&principal, one)).await;
    if removed.map_err(|error| failed(&error))? == 0 {
        return Err(Problem::not_found(
            "There is no such device of yours that gets alerts; GET /api/v1/push lists them.",
        ));
    }
    tracing::info!(by = %principal, id, "a browser gets no more alerts");
    Ok(StatusCode::NO_CONTENT)
}

fn not_taken(why: NotTaken) -> Problem {
    match why {
        NotTaken::Wrong(what) => Problem::invalid(format!("subscription: {what}.")),
        NotTaken::TooMany(what) => Problem::new(Code::Conflict, "Too many devices", format!("{what}.")),
        NotTaken::Disk(error) => failed(&error),
    }
}

fn failed(error: &std::io::Error) -> Problem {
    tracing::error!(%error, "the browsers that get alerts could not be written down");
    let detail = format!("The disk of this server does not take the change: {error}. Nothing was changed.");
    Problem::new(Code::Internal, "The disk failed", detail)
}

fn is_for(principal: &Principal, one: &Subscription) -> bool {
    principal.right_everywhere() == Some(Right::Engineer) || one.user == principal.name
}
