//! Endpoints of browsers that get alerts.

use axum::http::StatusCode;
use contract::Right::Viewer;

use super::endpoint::{Endpoint, Needs};
use crate::routes::push;

/// The endpoints.
pub(super) fn endpoints() -> Vec<Endpoint> {
    const VIEW: Needs = Needs::Anywhere(Viewer);
    vec![
        Endpoint::get("/api/v1/push", "push", VIEW, push::state)
            .summary(
                "Browsers of the caller that get alerts of this server's telescope by Web Push, for an engineer of all telescopes those \
                 of everybody, and the key that a browser subscribes with.",
            )
            .gives::<push::PushState>("The browsers."),
        Endpoint::post("/api/v1/push/subscriptions", "subscribe", VIEW, push::subscribe)
            .summary(
                "Sends alerts to a browser from now on, each encrypted for it; a new one gets a first message at once, within 10 s. The \
                 same browser again changes what it gets.",
            )
            .takes::<push::NewSubscription>()
            .answers::<push::SubscribedDevice>(StatusCode::CREATED, "It gets alerts."),
        Endpoint::delete("/api/v1/push/subscriptions/{id}", "unsubscribe", VIEW, push::unsubscribe)
            .summary("Sends a browser no more alerts.")
            .gives_nothing(StatusCode::NO_CONTENT, "It gets none."),
    ]
}
