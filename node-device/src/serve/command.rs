//! One command of a device from its start to its end: what was sent, what the readings show of it, and how it ended.

use std::time::Duration;

use alpaca::AlpacaError;
use contract::audit::Outcome as Ended;
use contract::{LastCommand, Link, Outcome};
use tokio::time::Instant;

use super::Loop;
use crate::deadline::machine_limit;
use crate::driver::{Command, Driver, Obeyed, Progress};
use crate::front::Order;

/// A device that rests for so long after a command without an answer has not received it.
const DOUBT: Duration = Duration::from_secs(3);

/// An accepted command under way.
pub(super) struct Running<D: Driver> {
    pub(super) order: Order<Command<D>>,
    /// When the device had taken it; only later readings judge it.
    sent: Option<Instant>,
    pub(super) deadline: Option<Instant>,
    standing_since: Option<Instant>,
    /// No answer came: perhaps the device never received it.
    in_doubt: bool,
    resting_since: Option<Instant>,
}

impl<D: Driver> Loop<D> {
    /// A command was accepted.
    pub(super) fn start(&mut self, order: Order<Command<D>>) {
        let verb = verb(&order.deed);
        if let Some(running) = &self.running {
            self.account(&running.order, Ended::Superseded { by: order.id.clone() });
            let id = running.order.id.clone();
            tracing::info!(device = %self.serve.device, command = %id, by = verb, "command interrupted");
        }
        tracing::info!(device = %self.serve.device, verb, from = order.from, "command");
        self.last_command = Some(LastCommand {
            id: order.id.clone(),
            from: order.from.clone(),
            verb,
            taken_utc: order.taken_utc,
            outcome: Outcome::Running,
            answer: None,
        });
        let driver = self.serve.driver.clone();
        let urgent = driver.interrupts(&order.deed);
        let alpaca = if urgent { self.serve.alpaca.at_once() } else { self.serve.alpaca.clone() };
        let fields = driver.fields(&self.readings);
        let (id, deed) = (order.id.clone(), order.deed.clone());
        // Dropping the job before ends its requests.
        self.job = Some(Box::pin(async move { driver.obey(&alpaca, &id, &deed, &fields).await }));
        self.running = Some(Running {
            order,
            sent: None,
            deadline: None,
            standing_since: None,
            in_doubt: false,
            resting_since: None,
        });
    }

    /// The device has answered a command.
    pub(super) fn obeyed(&mut self, result: Result<Obeyed, AlpacaError>) {
        let Some(running) = &mut self.running else { return };
        let now = Instant::now();
        match result {
            Ok(Obeyed::Done) => self.end(Outcome::Done),
            Ok(Obeyed::Answered(answer)) => {
                if let Some(last) = &mut self.last_command {
                    last.answer = Some(answer);
                }
                self.end(Outcome::Done);
            }
            Err(error) if !error.is_unknown_outcome() => self.end(Outcome::Failed { reason: error.to_string() }),
            // A missing answer does not show whether it was done; the state will.
            answer @ (Ok(Obeyed::Watch) | Err(_)) => {
                running.in_doubt = answer.is_err();
                let limit = self.serve.driver.limit(&running.order.deed);
                running.sent = Some(now);
                running.deadline = Some(now + machine_limit(self.serve.node.bus.clock(), limit));
            }
        }
        if self.link == Link::Connected {
            self.next_contact = now;
        }
    }

    /// How far is the command, by readings of a poll that began then?
    pub(super) fn judge(&mut self, began: Option<Instant>) {
        let Some(running) = &mut self.running else { return };
        let Some(sent) = running.sent else { return };
        if let Some(began) = began.filter(|began| *began >= sent && self.link == Link::Connected) {
            let driver = &self.serve.driver;
            match driver.progress(&running.order.deed, &driver.fields(&self.readings)) {
                Progress::Done => return self.end(Outcome::Done),
                Progress::Failed(reason) => return self.end(Outcome::Failed { reason }),
                Progress::Running => {
                    running.standing_since = None;
                    let rests = running.in_doubt && !driver.is_busy(&driver.fields(&self.readings));
                    let since = if rests { *running.resting_since.get_or_insert(began) } else { began };
                    running.resting_since = rests.then_some(since);
                    if began.duration_since(since) >= DOUBT {
                        let reason = "no answer came, and the device rests without having done it".to_owned();
                        return self.end(Outcome::Failed { reason });
                    }
                }
                Progress::Settling(seconds) => {
                    let since = *running.standing_since.get_or_insert(began);
                    let settle = Duration::from_secs_f64(seconds.clamp(0.0, 3600.0));
                    if began.duration_since(since) >= self.serve.node.bus.clock().machine_duration(settle) {
                        return self.end(Outcome::Done);
                    }
                }
            }
        }
        if running.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            let limit = self.serve.driver.limit(&running.order.deed).as_secs_f64();
            self.end(Outcome::Failed { reason: format!("not done within {limit} s") });
        }
    }

    fn end(&mut self, outcome: Outcome) {
        if let Some(running) = self.running.take() {
            self.account(&running.order, ended(&outcome));
        }
        self.front().running = None;
        if let Some(last) = &mut self.last_command {
            match &outcome {
                Outcome::Failed { reason } => {
                    tracing::warn!(device = %self.serve.device, verb = last.verb, reason, "command failed");
                }
                Outcome::Done | Outcome::Running => {}
            }
            last.outcome = outcome;
        }
    }

    /// Records in the audit log how a command ended.
    pub(super) fn account(&self, order: &Order<Command<D>>, how: Ended) {
        if self.serve.driver.moves(&order.deed) {
            self.serve.front.accounts.note(order.asked(), &order.deed, how);
        }
    }
}

fn ended(outcome: &Outcome) -> Ended {
    match outcome {
        // A command ends only once.
        Outcome::Done | Outcome::Running => Ended::Done,
        Outcome::Failed { reason } => Ended::Failed { detail: reason.clone() },
    }
}

/// What a command is called: the name that it has on the bus.
fn verb<C: serde::Serialize>(deed: &C) -> String {
    match serde_json::to_value(deed) {
        Ok(serde_json::Value::String(word)) => word,
        Ok(serde_json::Value::Object(object)) => object.keys().next().cloned().unwrap_or_default(),
        _ => String::new(),
    }
}
