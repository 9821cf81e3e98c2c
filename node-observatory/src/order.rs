//! Answers a person's orders, each once, while this node publishes for the telescope; `obey.rs` executes them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use audit::{Entry, verb_and_parameters};
use bus::Service;
use contract::audit::Outcome;
use contract::observatory::OrderTaken;
use contract::{CommandId, Key, Order, Reason, Reply};
use safety::operators::{self, Refused, Weighed};

use crate::action;
use crate::control_room::ControlRoom;
use crate::obey::{self, Tightened};

/// Answers of so many orders are remembered.
const REMEMBERED: usize = 64;

/// Where orders are taken.
#[derive(Default)]
struct Desk {
    answered: Mutex<VecDeque<Reply>>,
    /// Held by the order that waits for the disk; those that act at once pass by.
    turn: tokio::sync::Mutex<()>,
    tightened: Tightened,
}

/// Answers orders, and which actions there are, while this node commands or nobody does; a standby is silent, the
/// commander answers.
pub async fn keep_answering(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut hold = room.hold.clone();
    let (desk, mut services): (Arc<Desk>, Option<[Service; 2]>) = Default::default();
    loop {
        if !room.may_speak() {
            services = None;
        } else if services.is_none() {
            services = Some([serve(&room, &desk).await?, action::serve(&room.node).await?]);
        }
        if hold.changed().await.is_err() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

async fn serve(room: &Arc<ControlRoom>, desk: &Arc<Desk>) -> anyhow::Result<Service> {
    let (at, desk) = (room.clone(), desk.clone());
    let key = Key::Order(room.node.config.address());
    let service = room.node.bus.serve(&key, move |asked: Result<Order, String>| {
        let (room, desk) = (at.clone(), desk.clone());
        async move {
            match asked {
                Ok(order) => desk.answer_once(&room, &order).await,
                Err(error) => {
                    let reply = obey::refuse(&CommandId(String::new()), Reason::Malformed, &error);
                    account(&room, None, &reply);
                    reply
                }
            }
        }
    });
    Ok(service.await?)
}

impl Desk {
    /// A repeated order is answered again and not followed again.
    async fn answer_once(&self, room: &Arc<ControlRoom>, order: &Order) -> Reply {
        if let Some(reply) = self.answered(&order.id) {
            return reply;
        }
        if obey::acts_at_once(&order.kind) {
            let reply = obey::at_once(room, &self.tightened, order);
            if let Ok(weighed) = self.weigh(room, order) {
                self.hand_over(room, order, &weighed, &reply);
            }
            self.remember(room, order, &reply);
            obey::settle(room).await;
            return reply;
        }
        let _turn = self.turn.lock().await;
        // A repeat that waited for the first.
        if let Some(reply) = self.answered(&order.id) {
            return reply;
        }
        let reply = match self.weigh(room, order) {
            Ok(weighed) => {
                let reply = obey::when_written(room, &self.tightened, order).await;
                self.hand_over(room, order, &weighed, &reply);
                reply
            }
            Err((reason, why)) => obey::refuse(&order.id, reason, &why),
        };
        self.remember(room, order, &reply);
        reply
    }

    fn weigh(&self, room: &ControlRoom, order: &Order) -> Result<Weighed, Refused> {
        operators::weigh(order, &room.standing.get(), *room.robotic.borrow(), room.node.bus.clock().utc())
    }

    /// Remembers who has the telescope after an order that was accepted, and whom it was taken from.
    fn hand_over(&self, room: &ControlRoom, order: &Order, weighed: &Weighed, reply: &Reply) {
        if matches!(reply, Reply::Refusal(_)) {
            return;
        }
        let said = obey::said(room, order);
        room.standing.change(|standing| {
            let before = standing.control.clone();
            operators::keep(standing, weighed.then, &said);
            standing.control != before
        });
        if let Some(held) = &weighed.from {
            tracing::warn!(
                operator = order.operator(),
                from = held.from,
                reason = order.reason,
                "an operator takes over"
            );
            room.audit.note(Entry {
                from: order.from.clone(),
                id: order.id.clone(),
                device: String::new(),
                verb: "takes_over".to_owned(),
                parameters: held.from.clone(),
                token: room.hold.borrow().token(),
                reason: order.reason.clone(),
                outcome: Outcome::Accepted,
            });
        }
    }

    fn answered(&self, id: &CommandId) -> Option<Reply> {
        let answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |reply: &&Reply| match reply {
            Reply::Accepted(accepted) => accepted.id == *id,
            Reply::Refusal(refusal) => refusal.id == *id,
        };
        answered.iter().find(same).cloned()
    }

    fn remember(&self, room: &ControlRoom, order: &Order, reply: &Reply) {
        account(room, Some(order), reply);
        if matches!(reply, Reply::Accepted(_)) {
            let (verb, _) = verb_and_parameters(&obey::brief(&order.kind));
            let (id, from, at_utc) = (order.id.clone(), order.from.clone(), room.node.bus.clock().utc());
            room.board.order(OrderTaken { id, from, verb, at_utc });
        }
        let mut answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        if answered.len() >= REMEMBERED {
            answered.pop_front();
        }
        answered.push_back(reply.clone());
    }
}

/// Records in the audit log the outcome of an order; the movements that it causes have records of their own.
fn account(room: &ControlRoom, order: Option<&Order>, reply: &Reply) {
    let outcome = match reply {
        Reply::Accepted(_) => Outcome::Accepted,
        Reply::Refusal(refusal) => Outcome::Refused { reason: refusal.reason, detail: refusal.detail.clone() },
    };
    let (verb, parameters) = order.map_or_else(
        || ("unreadable".to_owned(), String::new()),
        |order| verb_and_parameters(&obey::brief(&order.kind)),
    );
    let (from, id, reason) =
        order.map(|order| (order.from.clone(), order.id.clone(), order.reason.clone())).unwrap_or_default();
    let token = room.hold.borrow().token();
    room.audit.note(Entry { from, id, device: String::new(), verb, parameters, token, reason, outcome });
}
