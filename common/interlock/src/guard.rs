//! The guard: permission to be open must be renewed; without it the dome closes, whichever node is dead.
//!
//! A pure state machine: everything it knows comes in as an argument, everything it wants goes out as a [`GuardStep`].
//! The device node's `guard_task` gives it eyes and hands. Two facts are kept apart: *may it be open* (permits), and
//! *is it closed* (fresh readings of the shutter; nothing else proves it).
//!
//! ```text
//!             no permit, or unsafe, and not verified closed;
//!             or an opening that nobody commanded
//!   watching ──────────────────────────────────────────────> closing ──┐ every 10 s, for ever
//!      ^                                                        │  ^───┘
//!      │  resume (valid safe permit)                            │ verified closed
//!      ├───────────────────────────── hold <──────────────────┤ nobody had commanded it
//!      └────────────────────────────────────────────────────────┘ commanded
//! ```

use std::collections::BTreeMap;
use std::time::Duration;

use contract::device::dome::{CloseWithMount, Guard as PublishedGuard, GuardAction, Shutter};
use contract::observatory::Permit;
use contract::{BootId, Chunk, Reason, Stamped};
use units::MachineTime;

use crate::closing_requests::ClosingRequests;
use crate::permit_ledger::{Dropped, PermitLedger, Taken};
use crate::shutter_evidence::{Contradiction, ShutterEvidence};
use crate::turned::Turned;

/// Closing is tried again so often.
const RETRY: Duration = Duration::from_secs(10);
/// A shutter that opens again while it must close is asked again so soon.
const AGAIN: Duration = Duration::from_secs(2);
/// Between two tries at most so often: a status that sticks at opening proves nothing.
const MOST_AGAIN: u32 = 3;
/// After so many tries without success all movement is stopped before the next.
const TRIES_BEFORE_STOP: u32 = 2;
/// The commander sends the mounts to their park within this time; after it the guard process asks them itself.
const PARKS_WITHIN: Duration = Duration::from_secs(10);
/// A shutter reading that is older proves nothing.
pub const FRESH: Duration = Duration::from_secs(5);
/// Added to the travel time before a closing counts as failed.
const GRACE: Duration = Duration::from_secs(5);

/// What a guard gets when it is created.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Settings {
    /// Incarnation of this guard.
    pub boot_id: BootId,
    /// Telescopes under the dome; each must permit.
    pub telescopes: Vec<Chunk>,
    /// How long a permit lasts from the sending of the number in it.
    pub permit_valid: Duration,
    /// Must the mount be parked before the shutter moves?
    pub policy: CloseWithMount,
    /// How long to wait for that.
    pub parked_within: Duration,
    /// A shutter that moves longer is stuck, machine time.
    pub travel: Duration,
}

/// What a guard wants done.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum GuardStep {
    /// Close the shutter.
    Close,
    /// Stop all movement, then close the shutter.
    AbortThenClose,
    /// An alarm becomes active.
    Raise(Alarm),
    /// An alarm is no longer active.
    Clear(Alarm),
}

/// What a person must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Alarm {
    /// It should be closed and is not, or its state is unknown.
    NotClosed,
    /// It opened and nobody had commanded it.
    Uncommanded,
    /// It should close and waits for a mount that does not park.
    MountNotParked,
    /// It closed by itself and waits for the commander.
    Hold,
    /// The dome's status of its shutter does not fit what was asked of it.
    Contradicts(Contradiction),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Expected {
    /// Nothing is known yet: an open dome may be this night's.
    Unknown,
    /// Opening was commanded.
    Open { since: MachineTime },
    /// Closing was commanded: an opening of before may yet begin, until the proof or the end of the shutter's time.
    Closing { since: MachineTime },
    /// The commander has taken over from a closing of this guard: the same holds.
    Resumed { since: MachineTime },
    /// Was seen closed.
    Closed,
}

/// The guard of one dome: plain data, so that states can be compared and copied.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Guard {
    settings: Settings,
    /// An open dome may wait so long for its first permit.
    grace_until: MachineTime,
    /// The node was asked to end: close, and open no more.
    ending: bool,
    permits: PermitLedger,
    expected: Expected,
    /// The shutter was opened, or seen other than closed, since it was last proven closed.
    was_open: bool,
    evidence: ShutterEvidence,
    hold: bool,
    closing: Option<ClosingRequests>,
    /// A request of its own to close waits or is on its way to the dome.
    sends: bool,
    active: Vec<Alarm>,
}

impl Guard {
    /// A guard that starts now. An open dome has `permit_valid` to be permitted.
    pub fn new(settings: Settings, tokens: BTreeMap<Chunk, u64>, now: MachineTime) -> Self {
        let Settings { boot_id, telescopes, permit_valid, .. } = &settings;
        let permits = PermitLedger::new(boot_id.clone(), telescopes.clone(), *permit_valid, tokens);
        Self {
            evidence: ShutterEvidence::new(settings.travel),
            grace_until: now.plus(settings.permit_valid),
            ending: false,
            settings,
            permits,
            expected: Expected::Unknown,
            was_open: false,
            hold: false,
            closing: None,
            sends: false,
            active: Vec::new(),
        }
    }

    /// The same with another time of grace: until when the dome might have been open, had this guard not been started
    /// anew.
    pub fn with_grace_until(mut self, until: MachineTime) -> Self {
        self.grace_until = until.min(self.grace_until);
        self
    }

    /// The node was asked to end: from now on the dome is closed, and stays so.
    pub fn end(&mut self) {
        self.ending = true;
    }

    /// How long the dome may stay open from `now` on if nothing is received any more.
    pub fn may_be_open_for(&self, now: MachineTime) -> Duration {
        if self.ending || self.closing.is_some() {
            return Duration::ZERO;
        }
        if self.permits.none_received() {
            return self.grace_until.since(now);
        }
        self.permits.are_safe_for(now)
    }

    /// The active alarms.
    pub fn active_alarms(&self) -> impl Iterator<Item = Alarm> + '_ {
        self.active.iter().copied()
    }

    /// The highest tokens that were granted.
    pub fn tokens(&self) -> impl Iterator<Item = (String, u64)> {
        self.permits.granted().into_iter().map(|granted| (granted.telescope, granted.token))
    }

    /// The telescopes under the dome.
    pub fn telescopes(&self) -> &[Chunk] {
        &self.settings.telescopes
    }

    /// The next number, to be sent now; a permit that carries it is as old as this moment.
    pub fn beat(&mut self, now: MachineTime) -> u64 {
        self.permits.beat(now)
    }

    /// Takes a permit, or drops and counts it; a dropped one has no effect on a valid one.
    pub fn observe(&mut self, telescope: &Chunk, sample: &Stamped<Permit>) -> Result<Taken, Dropped> {
        self.permits.observe(telescope, sample)
    }

    /// This node granted a lease; permits of older ones, and of other incarnations, are dropped from now on.
    pub fn grant(&mut self, telescope: &str, token: u64, boot_id: Option<&BootId>) {
        self.permits.grant(telescope, token, boot_id);
    }

    /// True while every telescope's permit is valid and safe.
    pub fn may_be_open(&self, now: MachineTime) -> bool {
        !self.ending && self.permits.are_safe(now)
    }

    /// Is the guard itself closing the dome?
    pub fn is_closing(&self) -> bool {
        self.closing.is_some()
    }

    /// Somebody with the right token wants to open.
    pub fn open_commanded(&mut self, now: MachineTime) -> Result<(), Turned> {
        let refused = |detail: &str| Err((Reason::NoPermit, detail.to_owned()));
        if !self.may_be_open(now) {
            return refused("no valid safe permit from every telescope under this dome");
        }
        if self.evidence.speaks_percent() {
            return refused("whether this dome is closed cannot be known: its ShutterStatus is a percentage");
        }
        if self.holds() {
            return refused("the guard closed the dome and holds it; the commander must send resume first");
        }
        if self.sends {
            // It could arrive after the request to open.
            return Err((Reason::Busy, "the guard's own request to close is on its way to the dome".to_owned()));
        }
        // One whose status is closed and that only waits for the proof of it may be opened again.
        if self.closing.is_some() && !self.evidence.reports_closed() {
            return refused("the guard is closing the dome");
        }
        self.closing = None;
        self.expected = Expected::Open { since: now };
        self.was_open = true;
        Ok(())
    }

    /// Whether a request of its own to close waits, or is on its way to the dome.
    pub fn set_sends(&mut self, sends: bool) {
        self.sends = sends;
    }

    /// A request to open leaves for the device: from now on the shutter may be open, whatever its status.
    pub fn open_sent(&mut self, now: MachineTime) {
        self.evidence.opening(now);
    }

    /// The device refused a request to open.
    pub fn open_refused(&mut self) {
        self.evidence.opening_refused();
    }

    /// A request to close leaves for the device.
    pub fn close_sent(&mut self, now: MachineTime) {
        self.evidence.close_sent(now);
    }

    /// The device took a request to close, or refused it.
    pub fn close_answered(&mut self, accepted: bool, now: MachineTime) {
        self.evidence.close_answered(accepted, now);
    }

    /// The shutter was read; `asked` is when that reading was asked for.
    pub fn read(&mut self, shutter: Shutter, asked: MachineTime) {
        self.evidence.read(shutter, asked);
    }

    /// The status was read, and is none of ASCOM's numbers.
    pub fn odd_status(&mut self, number: i64) {
        self.evidence.odd_number(number);
    }

    /// Is the shutter proven closed?
    pub fn is_closed(&self, now: MachineTime) -> bool {
        self.evidence.is_closed(now, FRESH)
    }

    /// It was asked to close, and is on its way.
    pub fn is_on_its_way(&self, now: MachineTime) -> bool {
        self.evidence.is_on_its_way(now)
    }

    /// The dome must close, and is not proven closed: nobody may stop or turn it.
    pub fn needs_closing(&self, now: MachineTime) -> bool {
        !self.is_closed(now) && (self.closing.is_some() || self.must_close(now))
    }

    /// The guard closed by itself, as far as the shutter's status shows, and waits for the commander.
    fn holds(&self) -> bool {
        let closed_itself = self.closing.is_some_and(|closing| !closing.commanded) && self.was_open;
        self.hold || (closed_itself && self.evidence.reports_closed())
    }

    /// Somebody commanded closing.
    pub fn close_commanded(&mut self, now: MachineTime) {
        self.expected = Expected::Closing { since: now };
        if let Some(closing) = &mut self.closing {
            closing.commanded = true;
        } else if self.closes_by_itself() {
            self.closing = Some(ClosingRequests::begun(now, true));
        }
    }

    /// Where the shutter must wait for the park, a command only begins the guard's own closing, which knows all mounts:
    /// the commander may know some of them or none.
    pub fn closes_by_itself(&self) -> bool {
        self.settings.policy != CloseWithMount::Alongside
    }

    /// It must close, and waits for mounts that are not known to be `parked` and that nobody has sent to their park
    /// yet. Of one that reports closed only the proof is missing, for which no mount need move before this node ends.
    pub fn needs_help_with_mounts(&self, now: MachineTime, parked: bool) -> bool {
        let is_late = self.closing.is_some_and(|closing| now.since(closing.since) >= PARKS_WITHIN);
        let is_open = is_late && !self.evidence.is_credible(now, FRESH);
        self.closes_by_itself() && !parked && self.needs_closing(now) && (self.ending || is_open)
    }

    /// The commander has taken over again.
    pub fn resume(&mut self, now: MachineTime) -> Result<(), Turned> {
        if !self.may_be_open(now) {
            let detail = "no valid safe permit from every telescope under this dome";
            return Err((Reason::NoPermit, detail.to_owned()));
        }
        self.hold = false;
        if self.closing.take().is_some() {
            self.expected = Expected::Resumed { since: now };
        }
        Ok(())
    }

    /// Looks at the dome: `seen` is a fresh reading of the shutter and when it was asked for, or none; `parked` means
    /// that every mount is known to be parked.
    pub fn look(&mut self, now: MachineTime, seen: Option<(Shutter, MachineTime)>, parked: bool) -> Vec<GuardStep> {
        if let Some((shutter, asked)) = seen {
            self.evidence.read(shutter, asked);
        }
        let shutter = seen.map(|(shutter, _)| shutter);
        let closed = seen.is_some() && self.is_closed(now);
        let uncommanded = self.compare(now, shutter);
        if self.closing.is_none() && !closed && (uncommanded || self.must_close(now)) {
            // A command that moved nothing in the shutter's time is not the cause of a closing that begins after it.
            let commanded = matches!(self.expected, Expected::Closing { since } if self.is_within_travel(since, now));
            self.closing = Some(ClosingRequests::begun(now, commanded));
        }
        let mut steps = Vec::new();
        let mut alarms = Vec::new();
        if uncommanded || (self.active.contains(&Alarm::Uncommanded) && (self.closing.is_some() || self.hold)) {
            alarms.push(Alarm::Uncommanded);
        }
        match self.closing.take() {
            Some(closing) if closed => {
                self.hold |= !closing.commanded && self.was_open;
                self.was_open = false;
                self.expected = Expected::Closed;
            }
            Some(mut closing) => {
                self.close(&mut closing, now, seen, parked, &mut steps, &mut alarms);
                self.closing = Some(closing);
            }
            None if closed => self.was_open = false,
            None => {}
        }
        if self.hold {
            alarms.push(Alarm::Hold);
        }
        if let Some(contradiction) = self.evidence.contradiction(now) {
            alarms.push(Alarm::Contradicts(contradiction));
        }
        steps.extend(self.show(alarms));
        steps
    }

    /// Keeps what is expected of the shutter; true when it opened and nobody had commanded it.
    fn compare(&mut self, now: MachineTime, shutter: Option<Shutter>) -> bool {
        match shutter {
            Some(Shutter::Open | Shutter::Opening) => {
                self.was_open = true;
                self.expected == Expected::Closed
            }
            Some(Shutter::Closing | Shutter::Error) => {
                self.was_open |= self.expected != Expected::Closed;
                false
            }
            Some(Shutter::Closed) => {
                // Right after a command to open a dome may still report closed, also if it was told to close since.
                let may_open = match self.expected {
                    Expected::Open { since } => self.is_within_travel(since, now),
                    // Not for ever, where nothing is ever proven, as after a request that the dome refused.
                    Expected::Closing { since } | Expected::Resumed { since } => {
                        self.is_within_travel(since, now) && !self.evidence.is_credible(now, FRESH)
                    }
                    Expected::Unknown | Expected::Closed => false,
                };
                if !may_open {
                    self.expected = Expected::Closed;
                }
                false
            }
            None => false,
        }
    }

    /// What was commanded then may yet begin.
    fn is_within_travel(&self, since: MachineTime, now: MachineTime) -> bool {
        now.since(since) < self.settings.travel
    }

    fn must_close(&self, now: MachineTime) -> bool {
        // A node that was restarted in the middle of the night gives its commander time to publish.
        let starting = now < self.grace_until && self.permits.none_received();
        self.ending || self.permits.is_reported_unsafe(now) || (!self.may_be_open(now) && !starting)
    }

    fn close(
        &mut self,
        closing: &mut ClosingRequests,
        now: MachineTime,
        seen: Option<(Shutter, MachineTime)>,
        parked: bool,
        steps: &mut Vec<GuardStep>,
        alarms: &mut Vec<Alarm>,
    ) {
        let Settings { policy, parked_within, travel, .. } = self.settings;
        let waited = now.since(closing.since) >= parked_within;
        let may_move = match policy {
            CloseWithMount::Alongside => true,
            CloseWithMount::ParkedWithinS => parked || waited,
            CloseWithMount::ParkedOnly => parked,
        };
        let reports_closed = seen.is_some_and(|(shutter, _)| shutter == Shutter::Closed);
        if !may_move {
            // For a shutter whose status is closed, and that nobody is known to have opened since, only the proof is
            // missing.
            if waited && (!reports_closed || self.evidence.is_doubted()) {
                alarms.push(Alarm::MountNotParked);
            }
            return;
        }
        let due = closing.last_try.is_none_or(|last| now.since(last) >= RETRY);
        // On its way: a second command, let alone a stop, would only disturb it.
        if due && !self.evidence.is_on_its_way(now) {
            // A dome that reports that it does not move is not stopped: it may be closing all the same.
            let stops = closing.tries >= TRIES_BEFORE_STOP && !reports_closed;
            steps.push(if stops { GuardStep::AbortThenClose } else { GuardStep::Close });
            closing.tries = (closing.tries + 1).min(TRIES_BEFORE_STOP + 1);
            (closing.last_try, closing.agains, closing.went) = (Some(now), 0, false);
            self.evidence.close_sent(now);
        } else if closing.opens_again(seen)
            && closing.agains < MOST_AGAIN
            && closing.last_request().is_none_or(|at| now.since(at) >= AGAIN)
        {
            // A request to open that came late, or another client: what it shows is no reason to wait for the next try.
            steps.push(GuardStep::Close);
            (closing.last_again, closing.went) = (Some(now), false);
            closing.agains += 1;
            self.evidence.close_sent(now);
        }
        if closing.tries > TRIES_BEFORE_STOP || now.since(closing.since) >= travel + GRACE {
            alarms.push(Alarm::NotClosed);
        }
    }

    /// The difference between the alarms that were active and those that are active now.
    fn show(&mut self, alarms: Vec<Alarm>) -> Vec<GuardStep> {
        let begun = alarms.iter().filter(|alarm| !self.active.contains(alarm)).map(|alarm| GuardStep::Raise(*alarm));
        let ended = self.active.iter().filter(|alarm| !alarms.contains(alarm)).map(|alarm| GuardStep::Clear(*alarm));
        // Of two causes of one alarm the new one counts.
        let changes = ended.chain(begun).collect();
        self.active = alarms;
        changes
    }

    /// What the guard publishes with a number; `malformed` permits were dropped before they reached it.
    pub fn published(&self, number: u64, now: MachineTime, malformed: u64) -> PublishedGuard {
        let granted = self.permits.granted();
        PublishedGuard {
            number,
            token: granted.iter().map(|granted| granted.token).max().unwrap_or(0),
            permit_valid_s: self.settings.permit_valid.as_secs_f64(),
            permits: self.permits.published(now),
            may_be_open: self.may_be_open(now),
            action: if self.closing.is_some() { GuardAction::Closing } else { GuardAction::Watching },
            hold: self.holds(),
            dropped: self.permits.dropped() + malformed,
            verified_closed: Some(self.evidence.is_credible(now, FRESH)),
            waits_for_mounts: Some(self.closes_by_itself()),
            watchdog_s: None,
            granted,
        }
    }
}

#[cfg(test)]
#[path = "guard_tests.rs"]
pub(crate) mod tests;

#[cfg(test)]
#[path = "guard_evidence_tests.rs"]
mod evidence_tests;
