//! One command of a device from its start to its end: what was sent, what the readings show of it, and how it ended.

use std::time::Duration;

use alpaca::AlpacaError;
use contract::audit::AuditOutcome as Ended;
use contract::{CommandOutcome, LastCommand, Link};
use tokio::task::JoinError;
use tokio::time::Instant;

use super::{Loop, STOP_TURN};
use crate::command_server::Order;
use crate::deadline::machine_limit;
use crate::driver::{Command, Driver, Executed, Progress};

/// A device that rests for so long after a command without an answer has not received it.
const DOUBT: Duration = Duration::from_secs(3);

/// A device that rests elsewhere for so long, sky time, does not go where it was sent: some begin to move late.
const STRANDED: Duration = Duration::from_secs(15);

/// An accepted command under way.
pub(super) struct RunningCommand<D: Driver> {
    pub(super) order: Order<Command<D>>,
    /// When the device had taken it; only later readings judge it.
    sent: Option<Instant>,
    pub(super) deadline: Option<Instant>,
    settling_since: Option<Instant>,
    /// No answer came: perhaps the device never received it.
    in_doubt: bool,
    resting_since: Option<Instant>,
    /// How far it rests from where it was sent, in units of its tolerance, and since when.
    stranded: Option<(f64, Instant)>,
    /// It is where it was sent, and says that it moves.
    says_it_moves: bool,
}

impl<D: Driver> Loop<D> {
    /// A command was accepted. It interrupts what runs, but for a stop that has no answer yet: it waits for its turn.
    pub(super) fn take(&mut self, order: Order<Command<D>>) {
        let driver = self.serve.driver.clone();
        let unsent = self.running.as_ref().filter(|running| driver.interrupts(&running.order.command));
        let Some(stop) = unsent.filter(|_| self.job.is_some()) else { return self.start(order) };
        if !driver.interrupts(&order.command) {
            // The command server lets none through that would come after a stop.
            return self.account(&order, Ended::Superseded { by: stop.order.id.clone() });
        }
        // What is asked for again waits once, behind the others: the newest decides what comes last.
        let same = |waiting: &Order<Command<D>>| words(&waiting.command) == words(&order.command);
        let before = self.stops.iter().position(same).and_then(|place| self.stops.remove(place));
        if let Some(before) = before {
            self.account(&before, Ended::Superseded { by: order.id.clone() });
        }
        self.stops.push_back(order);
    }

    /// Starts the next stop that waits, when the one before it was answered or its turn is over.
    pub(super) fn next_stop(&mut self) {
        if self.stops.is_empty() || (self.job.is_some() && Instant::now() < self.turn_ends) {
            return;
        }
        if let Some(unanswered) = self.job.take() {
            self.unanswered.spawn(unanswered);
        }
        if let Some(order) = self.stops.pop_front() {
            self.start(order);
        }
    }

    /// The device has answered a stop whose turn was over, or has not answered in time.
    pub(super) fn late(&self, answered: Result<Result<Executed, AlpacaError>, JoinError>) {
        let error = match answered {
            Ok(Ok(_)) => return,
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::warn!(device = %self.serve.device, error, "a stop was not answered; those after it were sent all the same");
    }

    /// Starts a command; what ran before ends.
    fn start(&mut self, order: Order<Command<D>>) {
        let verb = verb(&order.command);
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
            outcome: CommandOutcome::Running,
            answer: None,
        });
        let driver = self.serve.driver.clone();
        let urgent = driver.interrupts(&order.command);
        let alpaca = if urgent { self.serve.alpaca.at_once() } else { self.serve.alpaca.clone() };
        let fields = driver.fields(&self.readings);
        let (id, action) = (order.id.clone(), order.command.clone());
        self.turn_ends = Instant::now() + STOP_TURN;
        // Dropping the job before ends its requests.
        self.job = Some(Box::pin(async move { driver.execute(&alpaca, &id, &action, &fields).await }));
        self.running = Some(RunningCommand {
            order,
            sent: None,
            deadline: None,
            settling_since: None,
            in_doubt: false,
            resting_since: None,
            stranded: None,
            says_it_moves: false,
        });
    }

    /// The device has answered a command.
    pub(super) fn executed(&mut self, result: Result<Executed, AlpacaError>) {
        let Some(running) = &mut self.running else { return };
        let now = Instant::now();
        match result {
            Ok(Executed::Done) => self.end(CommandOutcome::Done),
            Ok(Executed::Answered(answer)) => {
                if let Some(last) = &mut self.last_command {
                    last.answer = Some(answer);
                }
                self.end(CommandOutcome::Done);
            }
            Err(error) if !error.is_unknown_outcome() => self.end(CommandOutcome::Failed { reason: error.to_string() }),
            // A missing answer does not show whether it was done; the state will.
            answer @ (Ok(Executed::Watch) | Err(_)) => {
                running.in_doubt = answer.is_err();
                let limit = self.serve.driver.limit(&running.order.command);
                running.sent = Some(now);
                running.deadline = Some(now + machine_limit(self.serve.node.bus.clock(), limit));
            }
        }
        if self.link == Link::Connected {
            self.next_turn = now;
        }
    }

    /// How far is the command, by readings of a poll that began then?
    pub(super) fn judge(&mut self, began: Option<Instant>) {
        let Some(running) = &mut self.running else { return };
        let Some(sent) = running.sent else { return };
        if let Some(began) = began.filter(|began| *began >= sent && self.link == Link::Connected) {
            let driver = &self.serve.driver;
            let fields = driver.fields(&self.readings);
            let progress = driver.progress(&running.order.command, &fields);
            running.says_it_moves = progress == Progress::SaysItMoves;
            if !matches!(progress, Progress::Stranded { .. }) {
                running.stranded = None;
            }
            match progress {
                Progress::Done => return self.end(CommandOutcome::Done),
                Progress::Failed(reason) => return self.end(CommandOutcome::Failed { reason }),
                Progress::Running | Progress::SaysItMoves | Progress::Stranded { .. } => {
                    running.settling_since = None;
                    if let Progress::Stranded { off, why } = progress {
                        let (_, since) = *running.stranded.insert(rests_since(running.stranded, off, began));
                        let limit = machine_limit(self.serve.node.bus.clock(), STRANDED);
                        if began.duration_since(since) >= limit {
                            return self.end(CommandOutcome::Failed { reason: why });
                        }
                    }
                    let rests = running.in_doubt && !driver.works_at(&running.order.command, &fields);
                    let since = if rests { *running.resting_since.get_or_insert(began) } else { began };
                    running.resting_since = rests.then_some(since);
                    if began.duration_since(since) >= DOUBT {
                        let reason = "no answer came, and the device rests without having done it".to_owned();
                        return self.end(CommandOutcome::Failed { reason });
                    }
                }
                Progress::Settling(seconds) => {
                    let since = *running.settling_since.get_or_insert(began);
                    let settle = Duration::from_secs_f64(seconds.clamp(0.0, 3600.0));
                    if began.duration_since(since) >= self.serve.node.bus.clock().machine_duration(settle) {
                        return self.end(CommandOutcome::Done);
                    }
                }
            }
        }
        if running.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            if running.says_it_moves {
                tracing::warn!(device = %self.serve.device, "it says that it moves, and is where it was sent: taken for done");
                return self.end(CommandOutcome::Done);
            }
            let limit = self.serve.driver.limit(&running.order.command).as_secs_f64();
            self.end(CommandOutcome::Failed { reason: format!("not done within {limit} s") });
        }
    }

    fn end(&mut self, outcome: CommandOutcome) {
        if let Some(running) = self.running.take() {
            self.account(&running.order, ended(&outcome));
            self.status().ended(&running.order.id);
        }
        if let Some(last) = &mut self.last_command {
            match &outcome {
                CommandOutcome::Failed { reason } => {
                    tracing::warn!(device = %self.serve.device, verb = last.verb, reason, "command failed");
                }
                CommandOutcome::Done | CommandOutcome::Running => {}
            }
            last.outcome = outcome;
        }
    }

    /// Records in the audit log how a command ended.
    pub(super) fn account(&self, order: &Order<Command<D>>, how: Ended) {
        if self.serve.driver.moves(&order.command) {
            self.serve.command_server.audit_log.note(order.asked(), &order.command, how);
        }
    }
}

/// How far a device rests from where it was sent, in units of its tolerance, and since when. Its encoder may flicker, but
/// one that comes nearer or goes the other way round still moves.
fn rests_since(before: Option<(f64, Instant)>, off: f64, now: Instant) -> (f64, Instant) {
    before.filter(|(before, _)| (off - before).abs() < 1.0).unwrap_or((off, now))
}

fn ended(outcome: &CommandOutcome) -> Ended {
    match outcome {
        // A command ends only once.
        CommandOutcome::Done | CommandOutcome::Running => Ended::Done,
        CommandOutcome::Failed { reason } => Ended::Failed { detail: reason.clone() },
    }
}

fn words<C: serde::Serialize>(command: &C) -> Option<serde_json::Value> {
    serde_json::to_value(command).ok()
}

/// What a command is called: the name that it has on the bus.
fn verb<C: serde::Serialize>(command: &C) -> String {
    match serde_json::to_value(command) {
        Ok(serde_json::Value::String(word)) => word,
        Ok(serde_json::Value::Object(object)) => object.keys().next().cloned().unwrap_or_default(),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoder_that_flickers_rests_and_one_that_comes_nearer_moves() {
        let begun = Instant::now();
        let at = |s: u64| begun + Duration::from_secs(s);
        let mut rests = None;
        for (s, off, since) in
            [(0, 8.0, 0), (1, 8.3, 0), (2, 7.6, 0), (3, 8.9, 0), (4, 7.0, 4), (5, 6.4, 4), (6, 5.9, 6)]
        {
            rests = Some(rests_since(rests, off, at(s)));
            assert_eq!(rests.map(|(_, since)| since), Some(at(since)), "at {s} s, {off} tolerances off");
        }
    }
}
