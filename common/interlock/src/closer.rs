//! Closes one dome for a process that receives no permit: the guard process, with what it knows of the dome.
//!
//! The shutter is looked at before it is asked to close, because it may be closed already. The guard in it decides when
//! it is asked, and whether it is closed; where the shutter waits for mounts, they are asked to park.

use std::time::Duration;

use units::MachineTime;

use crate::guard::{Alarm, FRESH, Guard, GuardStep, Settings};
use crate::guard_loop::ShutterReading;
use crate::request::{Answer, Request};
use crate::watch::Who;

/// Shutter and mounts are asked so often while this process closes, or looks whether it has to.
const LOOK: Duration = Duration::from_secs(1);
/// A mount that does not park is asked again so often.
const PARK_AGAIN: Duration = Duration::from_secs(30);
/// An address at which nobody has answered for so long has no dome any more.
const NOBODY: Duration = Duration::from_secs(3600);

/// The mounts under a dome, as far as a process without the bus knows them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct KnownMounts {
    /// There are some that can be asked.
    pub some: bool,
    /// No mount under the dome is unknown.
    pub all: bool,
}

/// An end does not wait for an address at which nobody has answered for so long: the next start goes on with it.
const UNANSWERED: Duration = Duration::from_secs(20);

/// What has been answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CloserEvent {
    /// The shutter's reading that was asked for has come, or none.
    Looked(Option<ShutterReading>),
    /// Whether all mounts are parked, and when they were asked.
    Mounts(bool, MachineTime),
    /// The request to close has come to this.
    Answered(Answer),
    /// A request has ended without any result: none is under way.
    Lost,
}

/// What must be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CloserEffect {
    /// An alarm becomes active.
    Raise(Alarm),
    /// An alarm is no longer active.
    Clear(Alarm),
    /// Read the shutter; the result is a [`CloserEvent::Looked`].
    Look {
        /// The time that counts as that of the question.
        asked: MachineTime,
    },
    /// Ask every mount whether it is parked; the result is a [`CloserEvent::Mounts`].
    AskMounts {
        /// The time that counts as that of the question.
        asked: MachineTime,
        /// Ask those to park that are not.
        park: bool,
    },
    /// Send this request to the dome; its result is a [`CloserEvent::Answered`].
    Send(Request),
}

/// What is known of one dome.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Closer {
    settings: Settings,
    mounts: KnownMounts,
    guard: Guard,
    shutter: Option<ShutterReading>,
    parked: Option<(bool, MachineTime)>,
    asked_at: Option<MachineTime>,
    asked_park_at: Option<MachineTime>,
    is_looking: bool,
    is_asking_mounts: bool,
    is_sending: bool,
    has_looked: bool,
    /// When this dome was first closed although no configuration names it any more.
    left_since: Option<MachineTime>,
}

impl Closer {
    /// A dome of which nothing was read yet.
    pub fn new(settings: Settings, mounts: KnownMounts) -> Self {
        Self {
            guard: guard(&settings),
            settings,
            mounts,
            shutter: None,
            parked: None,
            asked_at: None,
            asked_park_at: None,
            is_looking: false,
            is_asking_mounts: false,
            is_sending: false,
            has_looked: false,
            left_since: None,
        }
    }

    /// The shutter is proven closed by a reading of the last seconds.
    pub fn is_verified_closed(&self, now: MachineTime) -> bool {
        self.guard.is_closed(now)
    }

    /// Takes in what was answered.
    pub fn take(&mut self, event: CloserEvent, now: MachineTime) {
        match event {
            CloserEvent::Looked(read) => {
                (self.is_looking, self.has_looked) = (false, true);
                self.shutter = read.or(self.shutter);
            }
            CloserEvent::Mounts(parked, asked) => {
                self.is_asking_mounts = false;
                self.parked = Some((parked, asked));
            }
            CloserEvent::Answered(answer) => {
                self.is_sending = false;
                answer.apply(&mut self.guard, now);
            }
            CloserEvent::Lost => {
                (self.is_looking, self.is_asking_mounts, self.is_sending) = (false, false, false);
            }
        }
    }

    /// One round: closes the dome if this process guards it, or helps with its mounts; else what it had begun is
    /// forgotten.
    pub fn step(&mut self, who: Who, now: MachineTime) -> Vec<CloserEffect> {
        match who {
            // It waits for mounts that maybe nobody else sends to their park, or whose states the node does not receive.
            Who::This | Who::Both => self.close(now),
            Who::Node | Who::Permit => self.rest(),
        }
    }

    /// One round for a dome that no configuration names any more: nobody else closes it.
    pub fn leave(&mut self, now: MachineTime) -> Vec<CloserEffect> {
        self.left_since.get_or_insert(now);
        self.close(now)
    }

    /// Why such a dome need not be looked after any more, if so.
    pub fn is_let_go(&self, now: MachineTime) -> Option<&'static str> {
        if self.is_verified_closed(now) {
            return Some("it is verified closed");
        }
        self.is_unanswered_for(NOBODY, now).then_some("nobody has answered at its old address for an hour")
    }

    /// Does the end of this process wait until such a dome is closed?
    pub fn holds_up_the_end(&self, now: MachineTime) -> bool {
        !self.is_unanswered_for(UNANSWERED, now)
    }

    fn is_unanswered_for(&self, time: Duration, now: MachineTime) -> bool {
        self.shutter.is_none() && self.left_since.is_some_and(|since| now.since(since) >= time)
    }

    fn rest(&mut self) -> Vec<CloserEffect> {
        if self.asked_at.is_none() {
            return Vec::new();
        }
        let effects = self.guard.active_alarms().map(CloserEffect::Clear).collect();
        self.guard = guard(&self.settings);
        (self.asked_at, self.asked_park_at, self.has_looked) = (None, None, false);
        effects
    }

    /// It is closed, and closed again, until it is read to be closed.
    fn close(&mut self, now: MachineTime) -> Vec<CloserEffect> {
        let mut effects = Vec::new();
        let is_due = self.asked_at.is_none_or(|at| now.since(at) >= LOOK);
        if is_due && !self.is_looking {
            (self.is_looking, self.asked_at) = (true, Some(now));
            effects.push(CloserEffect::Look { asked: now });
        }
        // A shutter that may be closed already is looked at first; a server that is away does not prevent the attempt.
        if !self.has_looked {
            return effects;
        }
        let waits = self.guard.closes_by_itself();
        if waits && is_due && !self.is_verified_closed(now) && self.mounts.some && !self.is_asking_mounts {
            self.is_asking_mounts = true;
            let park = self.asked_park_at.is_none_or(|at| now.since(at) >= PARK_AGAIN);
            if park {
                self.asked_park_at = Some(now);
            }
            effects.push(CloserEffect::AskMounts { asked: now, park });
        }
        let are_parked = self.parked.is_some_and(|(parked, asked)| parked && now.since(asked) <= FRESH);
        let parked = !waits || (self.mounts.all && are_parked);
        let fresh = self.shutter.filter(|(_, asked)| now.since(*asked) <= FRESH);
        for step in self.guard.look(now, fresh, parked) {
            let request = match step {
                // It holds nothing, because it gives nothing free.
                GuardStep::Raise(Alarm::Hold | Alarm::Uncommanded)
                | GuardStep::Clear(Alarm::Hold | Alarm::Uncommanded) => {
                    continue;
                }
                GuardStep::Raise(alarm) => {
                    effects.push(CloserEffect::Raise(alarm));
                    continue;
                }
                GuardStep::Clear(alarm) => {
                    effects.push(CloserEffect::Clear(alarm));
                    continue;
                }
                GuardStep::Close => Request::Close,
                GuardStep::AbortThenClose => Request::AbortThenClose,
            };
            if !std::mem::replace(&mut self.is_sending, true) {
                effects.push(CloserEffect::Send(request));
            }
        }
        effects
    }
}

/// A guard that no permit ever reaches: it closes.
fn guard(settings: &Settings) -> Guard {
    let never = MachineTime::from_boot(Duration::ZERO);
    Guard::new(settings.clone(), Default::default(), never).with_grace_until(never)
}

#[cfg(test)]
#[path = "closer_tests.rs"]
mod tests;
