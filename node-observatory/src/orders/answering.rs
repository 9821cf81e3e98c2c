//! Answers a person's orders, each once, while this node publishes for the telescope; `execution.rs` executes them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use audit::{Entry, verb_and_parameters};
use bus::Service;
use contract::audit::AuditOutcome;
use contract::observatory::OrderTaken;
use contract::order_form::{LONGEST_REASON, check_reason};
use contract::{Accepted, CommandId, Key, Order, OrderKind, Reason, Reply};
use safety::operators::{self, Refused, Weighed};
use units::Angle;

use super::execution::{self, Telescope, Tightened};
use crate::action;
use crate::authority::Authority;
use crate::night::PublishedNight;

/// Answers of so many orders are remembered.
const REMEMBERED: usize = 64;

/// An order waits so long for the one before it.
const TURN: Duration = Duration::from_secs(10);

/// Where orders are taken.
struct OrderServer {
    telescope: Telescope,
    night: Arc<PublishedNight>,
    answered: Mutex<VecDeque<Reply>>,
    /// Held by the order that waits for the disk; those that act at once pass by.
    turn: tokio::sync::Mutex<()>,
    tightened: Tightened,
}

/// Answers orders, and which actions there are, while this node commands or nobody does; a standby is silent, the
/// commander answers.
pub async fn keep_answering(telescope: Telescope, night: Arc<PublishedNight>) -> anyhow::Result<()> {
    let authority = telescope.authority.clone();
    let (mut hold, mut services): (_, Option<[Service; 2]>) = (authority.hold.clone(), None);
    let (answered, turn, tightened) = Default::default();
    let server = Arc::new(OrderServer { telescope, night, answered, turn, tightened });
    loop {
        if !authority.is_publishing() {
            services = None;
        } else if services.is_none() {
            services = Some([serve(&server).await?, action::serve(&authority.node).await?]);
        }
        if hold.changed().await.is_err() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

async fn serve(server: &Arc<OrderServer>) -> anyhow::Result<Service> {
    let (at, node) = (server.clone(), &server.telescope.authority.node);
    let key = Key::Order(node.config.address());
    let service = node.bus.serve(&key, move |asked: Result<Order, String>| {
        let server = at.clone();
        async move {
            match asked {
                Ok(order) => server.answer_once(&order).await,
                Err(error) => {
                    let reply = execution::refuse(&CommandId(String::new()), Reason::Malformed, &error);
                    account(&server.telescope.authority, None, &reply);
                    reply
                }
            }
        }
    });
    Ok(service.await?)
}

impl OrderServer {
    /// A repeated order is answered again and not followed again.
    async fn answer_once(&self, order: &Order) -> Reply {
        if let Some(reply) = self.answered(&order.id) {
            return self.settled(order, reply).await;
        }
        if let Err(why) = check_reason(&order.reason) {
            let cut = Order { reason: order.reason.chars().take(LONGEST_REASON).collect(), ..order.clone() };
            if order.kind.only_tightens() {
                // Nobody's dome stays open because of the length of a text.
                return Box::pin(self.answer_once(&cut)).await;
            }
            let reply = execution::refuse(&order.id, Reason::Malformed, &why.to_string());
            account(&self.telescope.authority, Some(&cut), &reply);
            return reply;
        }
        let bus = &self.telescope.authority.node.bus;
        if let Err(why) = self.night.states.check(order, bus.boot_id(), bus.clock().machine()) {
            // Not remembered: its giver may give it again, under the same id.
            let reply = execution::refuse(&order.id, Reason::NotNow, &why);
            account(&self.telescope.authority, Some(order), &reply);
            return reply;
        }
        if execution::acts_at_once(&order.kind) {
            let reply = execution::at_once(&self.telescope, &self.tightened, order);
            if let Ok(weighed) = self.weigh(order) {
                self.hand_over(order, &weighed, &reply);
            }
            self.remember(order, &reply);
            return self.settled(order, reply).await;
        }
        // A disk that hangs holds the turn for ever; those who wait for it must not keep out who closes.
        let Ok(_turn) = tokio::time::timeout(TURN, self.turn.lock()).await else {
            let why =
                "an order before it waits for the disk of the observatory node and is not done; closing needs no disk";
            return execution::refuse(&order.id, Reason::NotNow, why);
        };
        // A repeat that waited for the first.
        if let Some(reply) = self.answered(&order.id) {
            return reply;
        }
        let reply = match self.weigh(order) {
            Ok(weighed) => {
                let reply = execution::when_written(&self.telescope, &self.tightened, order).await;
                self.hand_over(order, &weighed, &reply);
                reply
            }
            Err((reason, why)) => execution::refuse(&order.id, reason, &why),
        };
        self.remember(order, &reply);
        reply
    }

    /// The answer to an order that acted at once says whether it is on disk now; that to its repeat, too.
    async fn settled(&self, order: &Order, reply: Reply) -> Reply {
        if !execution::acts_at_once(&order.kind) {
            return reply;
        }
        let not_written = execution::settle(&self.telescope, &order.kind).await;
        match reply {
            Reply::Accepted(accepted) => Reply::Accepted(Accepted { not_written, ..accepted }),
            refusal @ Reply::Refusal(_) => refusal,
        }
    }

    fn weigh(&self, order: &Order) -> Result<Weighed, Refused> {
        let authority = &self.telescope.authority;
        operators::weigh(
            order,
            &self.telescope.orders.orders.get(),
            *authority.robotic.borrow(),
            authority.node.bus.clock().utc(),
        )
    }

    /// Remembers who has the telescope after an order that was accepted, and whom it was taken from.
    fn hand_over(&self, order: &Order, weighed: &Weighed, reply: &Reply) {
        if matches!(reply, Reply::Refusal(_)) {
            return;
        }
        let ordered_by = execution::ordered_by(&self.telescope, order);
        self.telescope.orders.orders.change(|orders| {
            let before = orders.control.clone();
            operators::keep(orders, weighed.then, &ordered_by);
            orders.control != before
        });
        if let Some(held) = &weighed.from {
            let authority = &self.telescope.authority;
            tracing::warn!(
                operator = order.operator(),
                from = held.from,
                reason = order.reason,
                "an operator takes over"
            );
            authority.audit.note(Entry {
                from: order.from.clone(),
                id: order.id.clone(),
                device: String::new(),
                verb: "takes_over".to_owned(),
                parameters: held.from.clone(),
                token: authority.hold.borrow().token(),
                reason: order.reason.clone(),
                outcome: AuditOutcome::Accepted,
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

    fn remember(&self, order: &Order, reply: &Reply) {
        account(&self.telescope.authority, Some(order), reply);
        if matches!(reply, Reply::Accepted(_)) {
            let (verb, _) = verb_and_parameters(&execution::brief(&order.kind));
            let (id, from, at_utc) =
                (order.id.clone(), order.from.clone(), self.telescope.authority.node.bus.clock().utc());
            let night = match &order.kind {
                OrderKind::CompleteHeaders { night: Some(night) } => Some(night.clone()),
                OrderKind::CompleteHeaders { night: None } => {
                    let longitude = Angle::from_degrees(self.telescope.authority.node.config.place.longitude_deg);
                    Some(sky::night_date(longitude, at_utc).to_string())
                }
                _ => None,
            };
            self.night.order(OrderTaken { id, from, verb, at_utc, night });
        }
        let mut answered = self.answered.lock().unwrap_or_else(PoisonError::into_inner);
        if answered.len() >= REMEMBERED {
            answered.pop_front();
        }
        answered.push_back(reply.clone());
    }
}

/// Records in the audit log the outcome of an order; the movements that it causes have records of their own.
fn account(authority: &Authority, order: Option<&Order>, reply: &Reply) {
    let outcome = match reply {
        Reply::Accepted(_) => AuditOutcome::Accepted,
        Reply::Refusal(refusal) => AuditOutcome::Refused { reason: refusal.reason, detail: refusal.detail.clone() },
    };
    let (verb, parameters) = order.map_or_else(
        || ("unreadable".to_owned(), String::new()),
        |order| verb_and_parameters(&execution::brief(&order.kind)),
    );
    let (from, id, reason) =
        order.map(|order| (order.from.clone(), order.id.clone(), order.reason.clone())).unwrap_or_default();
    let token = authority.hold.borrow().token();
    authority.audit.note(Entry { from, id, device: String::new(), verb, parameters, token, reason, outcome });
}
