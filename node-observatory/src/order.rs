//! A person's orders: the robotic switch, closing, and the schedule.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use audit::{Entry, verb_and_parameters};
use bus::Service;
use contract::audit::Outcome;
use contract::{Accepted, CommandId, Key, Order, OrderKind, Reason, Refusal, Reply};

use crate::annunciator::Annunciator;
use crate::control_room::ControlRoom;
use crate::standing::Said;

/// Answers orders while this node commands or nobody does; a standby is silent, the commander answers.
pub async fn keep_answering(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut hold = room.hold.clone();
    let mut service: Option<Service> = None;
    loop {
        if !room.may_speak() {
            service = None;
        } else if service.is_none() {
            service = Some(serve(&room).await?);
        }
        if hold.changed().await.is_err() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

async fn serve(room: &Arc<ControlRoom>) -> anyhow::Result<Service> {
    let answered: Arc<Mutex<VecDeque<Reply>>> = Arc::default();
    let at = room.clone();
    let key = Key::Order(room.node.config.address());
    let service = room.node.bus.serve(&key, move |asked: Result<Order, String>| {
        let (room, answered) = (at.clone(), answered.clone());
        async move {
            match asked {
                Ok(order) => answer_once(&room, &answered, &order),
                Err(error) => {
                    let reply = refuse(&CommandId(String::new()), Reason::Malformed, &error);
                    account(&room, None, &reply);
                    reply
                }
            }
        }
    });
    Ok(service.await?)
}

/// A repeated order is answered again and not followed again.
fn answer_once(room: &Arc<ControlRoom>, answered: &Mutex<VecDeque<Reply>>, order: &Order) -> Reply {
    let mut answered = answered.lock().unwrap_or_else(PoisonError::into_inner);
    let same = |reply: &&Reply| match reply {
        Reply::Accepted(accepted) => accepted.id == order.id,
        Reply::Refusal(refusal) => refusal.id == order.id,
    };
    if let Some(reply) = answered.iter().find(same) {
        return reply.clone();
    }
    let reply = follow(room, order);
    account(room, Some(order), &reply);
    if answered.len() >= 64 {
        answered.pop_front();
    }
    answered.push_back(reply.clone());
    reply
}

/// Tells the audit what became of an order; what it moves has records of its own.
fn account(room: &ControlRoom, order: Option<&Order>, reply: &Reply) {
    let outcome = match reply {
        Reply::Accepted(_) => Outcome::Accepted,
        Reply::Refusal(refusal) => Outcome::Refused { reason: refusal.reason, detail: refusal.detail.clone() },
    };
    let (verb, parameters) =
        order.map_or_else(|| ("unreadable".to_owned(), String::new()), |order| verb_and_parameters(&order.kind));
    let (from, id, reason) =
        order.map(|order| (order.from.clone(), order.id.clone(), order.reason.clone())).unwrap_or_default();
    let token = room.hold.borrow().token();
    room.audit.note(Entry { from, id, device: String::new(), verb, parameters, token, reason, outcome });
}

fn follow(room: &Arc<ControlRoom>, order: &Order) -> Reply {
    tracing::info!(from = order.from, kind = ?order.kind, reason = order.reason, "order");
    match &order.kind {
        OrderKind::Robotic(on) => switch_robotic(room, *on, "the robotic switch was turned off"),
        OrderKind::Close => {
            let why = format!("{} ordered it", order.from);
            switch_robotic(room, false, &why);
            // also when it was off already
            room.wish_closed.send_replace(Some(why));
        }
        OrderKind::ReloadSchedule => room.reload.send_modify(|count| *count += 1),
        OrderKind::StayClosed(on) => {
            let said = on.then(|| said(room, order));
            room.standing.send_modify(|standing| standing.stay_closed = said);
        }
        OrderKind::Override { input, for_s } => {
            let mut standing = room.standing.borrow().clone();
            if let Err(why) = standing.do_without(&room.rules, input, *for_s, said(room, order)) {
                return refuse(&order.id, Reason::Malformed, &why);
            }
            room.standing.send_replace(standing);
        }
        OrderKind::Acknowledge(id) => {
            return about_alerts(room, order, |alerts, said| alerts.acknowledge(id, &said));
        }
        OrderKind::Shelve { alert, for_s } => {
            return about_alerts(room, order, |alerts, said| alerts.shelve(alert, *for_s, said));
        }
        OrderKind::Unshelve(id) => return about_alerts(room, order, |alerts, _| alerts.unshelve(id)),
    }
    Reply::Accepted(Accepted { id: order.id.clone(), token: None })
}

/// Does something about an alert; the task that merges alerts writes it down.
fn about_alerts(
    room: &Arc<ControlRoom>,
    order: &Order,
    does: impl FnOnce(&mut Annunciator, Said) -> Result<(), String>,
) -> Reply {
    let mut done = Ok(());
    room.annunciator.send_if_modified(|alerts| {
        done = does(alerts, said(room, order));
        done.is_ok()
    });
    match done {
        Ok(()) => Reply::Accepted(Accepted { id: order.id.clone(), token: None }),
        Err(why) => refuse(&order.id, Reason::Malformed, &why),
    }
}

/// Sets the switch; turning it off closes what it had opened.
pub(crate) fn switch_robotic(room: &Arc<ControlRoom>, on: bool, why: &str) {
    let was = room.robotic.send_replace(on);
    if was && !on {
        room.wish_closed.send_replace(Some(why.to_owned()));
    }
    if was != on {
        let room = room.clone();
        tokio::task::spawn_blocking(move || {
            if let Err(error) = room.journal.robotic(on, room.node.bus.clock().utc()) {
                tracing::warn!(%error, "the robotic switch is not in the journal; a restart will not know it");
            }
        });
    }
}

fn said(room: &ControlRoom, order: &Order) -> Said {
    Said { from: order.from.clone(), reason: order.reason.clone(), at_utc: room.node.bus.clock().utc() }
}

fn refuse(id: &CommandId, reason: Reason, detail: &str) -> Reply {
    Reply::Refusal(Refusal { id: id.clone(), reason, detail: detail.to_owned() })
}
