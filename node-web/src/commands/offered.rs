//! What may be ordered of a telescope now, and what stands against it.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::response::{IntoResponse as _, Response};
use contract::command::operator;
use contract::observatory::{CONTROL_LAPSES_S, OperatorOrders, Ordered};
use contract::order_form::{ORDERS, OrderForm};
use contract::{Address, Key, Part, Right};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use units::Utc;
use users::Principal;

use crate::freshness::Quality;
use crate::model::Telescope;
use crate::problem::Problem;
use crate::routes::network::{NEVER_CACHED, known};
use crate::safety::SafetyWord;
use crate::server::Server;
use crate::summary::Summary;

/// An order, and whether this caller may give it now.
#[derive(Debug, JsonSchema, Serialize)]
pub struct OrderOffered {
    /// Its word.
    pub command: &'static str,
    /// What it does.
    pub meaning: &'static str,
    /// The right that it needs.
    pub right: Right,
    /// May this caller give it?
    pub may: bool,
    /// It has ended when the telescope is verified closed.
    pub closes: bool,
    /// It needs a reason.
    pub needs_reason: bool,
    /// JSON Schema of its parameters.
    pub parameters: Value,
    /// What stands against it now: it would be refused, or would change nothing yet. The observatory node decides.
    pub against: Vec<String>,
}

/// Every order with what stands against it.
pub async fn catalog(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Principal>,
    Path((site, telescope)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let address = known(&server.network, &site, &telescope)?;
    let (now, utc) = (server.network.clock().machine(), server.network.clock().utc());
    let model = server.network.read();
    let Some(telescope) = model.telescopes.get(&address) else {
        return Err(Problem::not_found("It has just been forgotten."));
    };
    let summary = Summary::of(&model, &address, telescope, now, utc);
    let against = |form: &OrderForm| {
        let held = held(form, &address, telescope, (&caller.name, utc));
        held.into_iter().chain(against(form, &address, telescope, &summary)).collect()
    };
    let offered = ORDERS.iter().map(|form| OrderOffered {
        command: form.word,
        meaning: form.meaning,
        right: form.right,
        may: caller.right_at(&address) >= Some(form.right),
        closes: form.closes,
        needs_reason: form.needs_reason,
        parameters: form.schema(),
        against: against(form),
    });
    Ok((NEVER_CACHED, Json(offered.collect::<Vec<_>>())).into_response())
}

/// What stands now against the effect of an order; nothing where its telescope is not known.
pub(super) fn against_now(server: &Server, form: &OrderForm, address: &Address) -> Vec<String> {
    let (now, utc) = (server.network.clock().machine(), server.network.clock().utc());
    let model = server.network.read();
    let Some(telescope) = model.telescopes.get(address) else { return Vec::new() };
    against(form, address, telescope, &Summary::of(&model, address, telescope, now, utc))
}

fn operator_orders(address: &Address, telescope: &Telescope) -> Option<OperatorOrders> {
    let key = Key::Observatory(address.clone(), Part::OperatorOrders);
    telescope.read::<OperatorOrders>(&key).map(|(_, orders)| orders)
}

/// Who ordered something, when, and why where there is a reason.
fn ordered(held: &Ordered) -> (&str, String, String) {
    let why = if held.reason.is_empty() { String::new() } else { format!(" ({})", held.reason) };
    (operator(&held.from), held.at_utc.to_second(), why)
}

/// Another operator has the telescope that this caller would start.
fn held(form: &OrderForm, address: &Address, telescope: &Telescope, (caller, now): (&str, Utc)) -> Option<String> {
    let is_others = |held: &Ordered| {
        let is_old = now.seconds_since(held.at_utc).abs() >= CONTROL_LAPSES_S;
        held.from.contains('/') && operator(&held.from) != caller && !is_old
    };
    let orders = operator_orders(address, telescope).filter(|_| form.word == "start");
    let held = orders?.control.filter(is_others)?;
    let (name, at, why) = ordered(&held);
    Some(format!("{name} has the telescope since {at}{why}: give a reason to take it over"))
}

/// What keeps an order from having an effect, also where it is accepted.
fn against(form: &OrderForm, address: &Address, telescope: &Telescope, summary: &Summary) -> Vec<String> {
    let mut found = Vec::new();
    if summary.face.quality != Quality::Fresh {
        let closes = if form.closes { ": the device node of the dome closes at this order" } else { "" };
        found.push(format!("{}{closes}", overview::silent(summary.face.observatory_silent_since_utc)));
    }
    match (form.word, operator_orders(address, telescope).and_then(|orders| orders.stay_closed)) {
        ("start", Some(held)) => {
            let (name, at, why) = ordered(&held);
            found.push(format!("it stays closed until `open-again`: {name} ordered so at {at}{why}"));
        }
        ("open-again", None) => found.push("nobody has ordered that it stays closed".to_owned()),
        _ => {}
    }
    if form.word == "start" && summary.face.safety.state != SafetyWord::Safe {
        let reasons = &summary.face.safety.reasons;
        found.extend(reasons.iter().map(|reason| format!("{}: {}", reason.input, reason.why)));
        if reasons.is_empty() {
            found.push("no verdict was received: the dome stays closed until there is one".to_owned());
        }
    }
    found
}
