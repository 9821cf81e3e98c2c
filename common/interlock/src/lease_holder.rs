//! The process that wants to command: when it asks for the lease, keeps it, doubts it, or stands by.
//!
//! ```text
//!            granted, and the orders of the commander before are adopted
//!   asking ───────────────────────────────────────────────────────────> holding
//!    ^  │ ^                                                                │
//!    │  │ └────────── doubted, forgotten, or a newer one was granted ──────┘
//!    │  │ another process has it          the arbiter is silent for 10 s, and nobody publishes
//!    │  ├──────────────────> standby       ──────────────────────> claiming
//! ```
//! In each of these states it asks once a second, unless it holds the lease.

use std::collections::BTreeSet;
use std::time::Duration;

use contract::{BootId, CommandId};
use units::MachineTime;

use crate::claim_note::{ClaimNote, Noted};
use crate::lease_known::LeaseKnown;

/// An arbiter that is there answers within this time.
const ASKING: Duration = Duration::from_secs(10);
/// One that does not for so long is an alert; one that refuses is as soon as this process publishes.
const NO_LEASE: Duration = Duration::from_secs(30);
/// An arbiter that has lost its memory publishes an older lease for good; right after a grant it does so for a moment.
const FORGOTTEN: Duration = Duration::from_secs(5);

/// A device that knew a newer token follows the arbiter's own count, which is published each second, within this time. A
/// refusal before that is no reason to claim anew: an arbiter that counts from the beginning would be asked for one
/// number after another.
const FOLLOWED: Duration = Duration::from_secs(3);

/// Whether a process has the lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LeaseState {
    /// The arbiter was asked and may yet answer that another node commands: nothing is published or done.
    Asking,
    /// The arbiter does not answer; nobody is known to command.
    Claiming,
    /// Somebody else commands and is alive; this node only watches.
    Standby,
    /// This node commands.
    Holding {
        /// The fencing token.
        token: u64,
    },
}

/// What was answered to a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ClaimAnswer {
    /// It was granted this token.
    Granted(u64),
    /// Another process holds the lease.
    Held,
    /// It was refused for another reason.
    Refused,
    /// Nothing: it may have been granted all the same.
    Silent,
}

/// What has happened.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum LeaseEvent {
    /// It is time to ask.
    Due,
    /// The note of the claim is on disk, or could not be written.
    Noted(Option<Noted>),
    /// The claim was answered.
    Answered(ClaimAnswer),
    /// What the commander before had ordered is adopted, as far as it is known.
    TookOver,
    /// The note was removed, or could not be.
    NoteRemoved(bool),
    /// The lease was published a second ago; what the guards publish of it, where there are any.
    Published(Option<LeaseKnown>),
    /// A device refused the token as old.
    Doubted,
}

/// What is done next; its result is the next event.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum LeaseTask {
    /// Write this note: [`LeaseEvent::Noted`].
    Note(Noted),
    /// Ask the arbiter with this id: [`LeaseEvent::Answered`].
    Claim(CommandId),
    /// Adopt what the commander before had ordered: [`LeaseEvent::TookOver`].
    TakeOver {
        /// The token that was granted; none where there is no arbiter.
        granted: Option<u64>,
        /// The token that this incarnation held before.
        held: Option<u64>,
        /// Tokens with which nobody commanded.
        unused: BTreeSet<u64>,
    },
    /// Remove the note: [`LeaseEvent::NoteRemoved`].
    RemoveNote,
    /// Publish the lease and wait for a second: [`LeaseEvent::Published`], or [`LeaseEvent::Doubted`].
    Publish(u64),
    /// Wait for a second: [`LeaseEvent::Due`].
    Wait,
}

/// A change of an alert.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LeaseAlert {
    /// The arbiter grants no lease.
    NoLease(bool),
    /// Two processes publish in the guard's name, and only one of them knows this lease.
    Disputed(bool),
}

/// What must be done.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct LeaseStep {
    /// The alert that changes.
    pub alert: Option<LeaseAlert>,
    /// What is done next.
    pub task: LeaseTask,
}

/// A lease that was published within the last 5 s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishedLease<'a> {
    /// The commander, empty while there is none.
    pub holder: &'a str,
    /// The incarnation that published it.
    pub boot_id: &'a BootId,
}

/// One incarnation of a process that wants to command.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct LeaseHolder {
    /// Its name, such as `observatory/callisto/main`.
    name: String,
    boot_id: BootId,
    /// A device grants the lease.
    has_arbiter: bool,
    state: LeaseState,
    /// Since when the arbiter has not answered.
    asked_since: MachineTime,
    note: ClaimNote,
    claim: CommandId,
    /// The claim is that of the incarnation before.
    is_left: bool,
    /// The token that was granted and is not held yet.
    granted: Option<u64>,
    /// The token that was held last.
    held: Option<u64>,
    /// Since when it is held.
    held_since: Option<MachineTime>,
    /// Since when the arbiter publishes an older lease.
    unknown_since: Option<MachineTime>,
    is_disputed: bool,
}

impl LeaseHolder {
    /// One that has not asked yet, with the note that the incarnation before left. `fresh`: the id of a claim that was
    /// never asked.
    pub fn new(
        (name, boot_id): (String, BootId),
        has_arbiter: bool,
        note: ClaimNote,
        fresh: CommandId,
        now: MachineTime,
    ) -> Self {
        Self {
            name,
            boot_id,
            has_arbiter,
            state: LeaseState::Asking,
            asked_since: now,
            is_left: note.left().is_some(),
            claim: note.left().cloned().unwrap_or(fresh),
            note,
            granted: None,
            held: None,
            held_since: None,
            unknown_since: None,
            is_disputed: false,
        }
    }

    /// Whether it has the lease.
    pub fn state(&self) -> LeaseState {
        self.state
    }

    /// The token that it held last, which it shows when it claims.
    pub fn held(&self) -> Option<u64> {
        self.held
    }

    /// What follows. `published`: the lease that was published lately; `fresh`: the id of a claim that was never asked.
    pub fn next(
        &mut self,
        event: LeaseEvent,
        published: Option<PublishedLease>,
        fresh: CommandId,
        now: MachineTime,
    ) -> LeaseStep {
        let mut alert = None;
        let task = match event {
            LeaseEvent::Due => self.ask(published),
            LeaseEvent::Noted(noted) => {
                self.note.written(noted);
                LeaseTask::Claim(self.claim.clone())
            }
            LeaseEvent::Answered(ClaimAnswer::Granted(token)) if std::mem::take(&mut self.is_left) => {
                // The incarnation before was ended as it was granted this token.
                self.note.was_granted(token);
                self.claim = fresh;
                self.ask(published)
            }
            LeaseEvent::Answered(ClaimAnswer::Granted(token)) => {
                self.granted = Some(token);
                LeaseTask::TakeOver {
                    granted: self.has_arbiter.then_some(token),
                    held: self.held,
                    unused: self.note.unused().clone(),
                }
            }
            LeaseEvent::Answered(ClaimAnswer::Held) => {
                self.state = LeaseState::Standby;
                alert = Some(LeaseAlert::NoLease(false));
                (self.asked_since, self.claim, self.is_left) = (now, fresh, false);
                LeaseTask::Wait
            }
            LeaseEvent::Answered(answer @ (ClaimAnswer::Refused | ClaimAnswer::Silent)) => {
                alert = self.is_not_granted(answer, published, now);
                // A refusal is an answer; after silence the same claim is asked again.
                if answer == ClaimAnswer::Refused {
                    (self.claim, self.is_left) = (fresh, false);
                }
                LeaseTask::Wait
            }
            LeaseEvent::TookOver => {
                self.held = self.granted;
                LeaseTask::RemoveNote
            }
            LeaseEvent::NoteRemoved(is_removed) => {
                if let Some(token) = self.granted.take()
                    && self.note.taken_back(is_removed)
                {
                    (self.state, self.unknown_since) = (LeaseState::Holding { token }, None);
                    self.held_since = Some(now);
                    alert = Some(LeaseAlert::NoLease(false));
                    LeaseTask::Publish(token)
                } else {
                    self.claim = fresh;
                    self.ask(published)
                }
            }
            LeaseEvent::Doubted => match (self.state, self.held_since) {
                (LeaseState::Holding { token }, Some(since)) if now.since(since) < FOLLOWED => {
                    LeaseTask::Publish(token)
                }
                _ => self.asks_again(published, fresh, now),
            },
            LeaseEvent::Published(known) => {
                let is_lost = self.is_lost_by(known, now);
                match self.state {
                    LeaseState::Holding { token } if !is_lost => {
                        alert = self.dispute(known);
                        LeaseTask::Publish(token)
                    }
                    _ => {
                        alert = std::mem::take(&mut self.is_disputed).then_some(LeaseAlert::Disputed(false));
                        self.asks_again(published, fresh, now)
                    }
                }
            }
        };
        LeaseStep { alert, task }
    }

    /// A living rival refuses; what is refused needs no note.
    fn ask(&self, published: Option<PublishedLease>) -> LeaseTask {
        let is_rival = published.is_some_and(|lease| !lease.holder.is_empty() && lease.holder != self.name);
        match self.note.asks(&self.claim).filter(|_| !is_rival) {
            Some(noted) => LeaseTask::Note(noted),
            None => LeaseTask::Claim(self.claim.clone()),
        }
    }

    /// Another node may command although the arbiter cannot answer just now.
    fn is_not_granted(
        &mut self,
        answer: ClaimAnswer,
        published: Option<PublishedLease>,
        now: MachineTime,
    ) -> Option<LeaseAlert> {
        let silent_for = now.since(self.asked_since);
        let is_rival = published.is_some_and(|lease| *lease.boot_id != self.boot_id);
        if !is_rival && silent_for >= ASKING {
            self.state = LeaseState::Claiming;
        }
        let is_refused = answer == ClaimAnswer::Refused && silent_for >= ASKING;
        (is_refused || silent_for > NO_LEASE).then_some(LeaseAlert::NoLease(true))
    }

    fn is_lost_by(&mut self, known: Option<LeaseKnown>, now: MachineTime) -> bool {
        if known != Some(LeaseKnown::Unknown) {
            self.unknown_since = None;
            return known == Some(LeaseKnown::Lost);
        }
        now.since(*self.unknown_since.get_or_insert(now)) >= FORGOTTEN
    }

    fn dispute(&mut self, known: Option<LeaseKnown>) -> Option<LeaseAlert> {
        let is_disputed = known? == LeaseKnown::Disputed;
        let is_new = std::mem::replace(&mut self.is_disputed, is_disputed) != is_disputed;
        is_new.then_some(LeaseAlert::Disputed(is_disputed))
    }

    fn asks_again(&mut self, published: Option<PublishedLease>, fresh: CommandId, now: MachineTime) -> LeaseTask {
        self.state = LeaseState::Asking;
        (self.asked_since, self.claim) = (now, fresh);
        self.ask(published)
    }
}

#[cfg(test)]
#[path = "lease_holder_tests.rs"]
mod tests;
