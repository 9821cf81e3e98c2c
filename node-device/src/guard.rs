//! The guard: permission to be open must be renewed; without it the dome closes, whoever is dead.
//!
//! A pure state machine: everything it knows comes in as an argument, everything it wants goes out as a
//! [`Deed`]. `guard_task` gives it eyes and hands. Two facts are kept apart: *may it be open* (permits), and
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

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use bus::MachineTime;
use config::CloseWithMount;
use contract::device::dome::{Guard as Said, GuardAction, HeardPermit, Shutter};
use contract::observatory::{Permit, Verdict};
use contract::{BootId, Chunk, Reason, Stamped};

use crate::gate::Turned;

/// Closing is tried again so often.
const RETRY: Duration = Duration::from_secs(10);
/// After so many tries without success all movement is stopped before the next.
const PATIENCE: u32 = 2;
/// Numbers that are remembered with the time they were sent; the longest permit lasts 30 s.
const NUMBERS: usize = 64;
/// Added to the travel time before a closing counts as failed.
const GRACE: Duration = Duration::from_secs(5);

/// What a guard is told at its birth.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Life of this guard.
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
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deed {
    /// Close the shutter.
    Close,
    /// Stop all movement, then close the shutter.
    AbortThenClose,
    /// An alarm begins to stand.
    Raise(Alarm),
    /// An alarm stands no more.
    Clear(Alarm),
}

/// What a person must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Alarm {
    /// It should be closed and is not, or nobody can tell.
    NotClosed,
    /// It opened and nobody had commanded it.
    Uncommanded,
    /// It should close and waits for a mount that does not park.
    MountNotParked,
    /// It closed by itself and waits for the commander.
    Hold,
}

/// Why a permit was dropped; each is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dropped {
    /// Of a telescope that is not under this dome.
    Stranger,
    /// Its number is of another life of this guard.
    OtherBoot,
    /// A number that this guard never sent, or so long ago that it does not remember.
    UnknownNumber,
    /// Sent before one that was heard already.
    Replayed,
    /// Of an older lease.
    OldToken,
}

#[derive(Debug, Clone)]
struct Held {
    boot_id: BootId,
    seq: u64,
    number: u64,
    sent: MachineTime,
    token: u64,
    safe: bool,
    commander: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    /// Nothing is known yet: an open dome may be this night's.
    Unknown,
    /// Opening was commanded.
    Open { since: MachineTime },
    /// Closing was commanded.
    Closing,
    /// Was seen closed.
    Closed,
}

#[derive(Debug, Clone, Copy)]
struct Closing {
    since: MachineTime,
    tries: u32,
    last_try: Option<MachineTime>,
    moving_since: Option<MachineTime>,
    commanded: bool,
}

impl Closing {
    fn begun(since: MachineTime, commanded: bool) -> Self {
        Self { since, tries: 0, last_try: None, moving_since: None, commanded }
    }
}

/// The guard of one dome.
#[derive(Debug)]
pub struct Guard {
    settings: Settings,
    started: MachineTime,
    next_number: u64,
    sent: VecDeque<(u64, MachineTime)>,
    permits: BTreeMap<Chunk, Held>,
    tokens: BTreeMap<Chunk, u64>,
    dropped: u64,
    expected: Expected,
    /// The shutter was seen other than closed since it was last seen closed.
    was_open: bool,
    hold: bool,
    closing: Option<Closing>,
    standing: Vec<Alarm>,
}

impl Guard {
    /// A guard that starts now. An open dome has `permit_valid` to be permitted.
    pub fn new(settings: Settings, tokens: BTreeMap<Chunk, u64>, now: MachineTime) -> Self {
        Self {
            settings,
            started: now,
            next_number: 0,
            sent: VecDeque::new(),
            permits: BTreeMap::new(),
            tokens,
            dropped: 0,
            expected: Expected::Unknown,
            was_open: false,
            hold: false,
            closing: None,
            standing: Vec::new(),
        }
    }

    /// The telescopes under the dome.
    pub fn telescopes(&self) -> &[Chunk] {
        &self.settings.telescopes
    }

    /// The next number, to be sent now; a permit that carries it is as old as this moment.
    pub fn beat(&mut self, now: MachineTime) -> u64 {
        let number = self.next_number;
        self.next_number += 1;
        self.sent.push_back((number, now));
        if self.sent.len() > NUMBERS {
            self.sent.pop_front();
        }
        number
    }

    /// Takes a permit, or drops and counts it; a dropped one has no effect on a valid one.
    pub fn hear(&mut self, telescope: &Chunk, said: &Stamped<Permit>) -> Result<(), Dropped> {
        let taken = self.weigh(telescope, said);
        match taken {
            Ok(held) => {
                self.learn_token(telescope.as_str(), held.token);
                self.permits.insert(telescope.clone(), held);
                Ok(())
            }
            Err(why) => {
                self.dropped += 1;
                Err(why)
            }
        }
    }

    fn weigh(&self, telescope: &Chunk, said: &Stamped<Permit>) -> Result<Held, Dropped> {
        let permit = &said.body;
        if !self.settings.telescopes.contains(telescope) {
            return Err(Dropped::Stranger);
        }
        if permit.guard_boot_id != self.settings.boot_id {
            return Err(Dropped::OtherBoot);
        }
        let sent = self.sent.iter().find(|(number, _)| *number == permit.guard_number).map(|(_, at)| *at);
        let sent = sent.ok_or(Dropped::UnknownNumber)?;
        if permit.token < self.tokens.get(telescope).copied().unwrap_or(0) {
            return Err(Dropped::OldToken);
        }
        if let Some(have) = self.permits.get(telescope).filter(|have| have.token == permit.token) {
            // of one lease nothing goes back: not the number, not the sender's life, not its count
            let older = match said.boot_id.cmp(&have.boot_id) {
                std::cmp::Ordering::Less => true,
                std::cmp::Ordering::Equal => said.seq <= have.seq,
                std::cmp::Ordering::Greater => false,
            };
            if older || permit.guard_number < have.number {
                return Err(Dropped::Replayed);
            }
        }
        Ok(Held {
            boot_id: said.boot_id.clone(),
            seq: said.seq,
            number: permit.guard_number,
            sent,
            token: permit.token,
            safe: permit.verdict == Verdict::Safe,
            commander: permit.commander.clone(),
        })
    }

    /// A lease was granted or heard of; permits of older ones are dropped from now on.
    pub fn learn_token(&mut self, telescope: &str, token: u64) {
        let Some(telescope) = self.settings.telescopes.iter().find(|own| own.as_str() == telescope) else { return };
        let known = self.tokens.entry(telescope.clone()).or_default();
        *known = token.max(*known);
    }

    fn left(&self, held: &Held, now: MachineTime) -> Duration {
        held.sent.plus(self.settings.permit_valid).since(now)
    }

    fn valid(&self, telescope: &Chunk, now: MachineTime) -> Option<&Held> {
        self.permits.get(telescope).filter(|held| !self.left(held, now).is_zero())
    }

    /// True while every telescope's permit is valid and safe.
    pub fn may_be_open(&self, now: MachineTime) -> bool {
        let telescopes = &self.settings.telescopes;
        !telescopes.is_empty()
            && telescopes.iter().all(|telescope| self.valid(telescope, now).is_some_and(|held| held.safe))
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
        if self.closing.is_some() {
            return refused("the guard is closing the dome");
        }
        if self.hold {
            return refused("the guard closed the dome and holds it; the commander must send resume first");
        }
        self.expected = Expected::Open { since: now };
        self.was_open = true;
        Ok(())
    }

    /// Somebody commanded closing.
    pub fn close_commanded(&mut self, now: MachineTime) {
        self.expected = Expected::Closing;
        if let Some(closing) = &mut self.closing {
            closing.commanded = true;
        } else if self.closes_by_itself() {
            self.closing = Some(Closing::begun(now, true));
        }
    }

    /// Over several telescopes a commander knows its own mounts alone: where the shutter must wait for the park, a command
    /// only begins the guard's own closing, which hears all of them.
    pub fn closes_by_itself(&self) -> bool {
        self.settings.telescopes.len() > 1 && self.settings.policy != CloseWithMount::Beside
    }

    /// The commander has taken over again.
    pub fn resume(&mut self, now: MachineTime) -> Result<(), Turned> {
        if !self.may_be_open(now) {
            let detail = "no valid safe permit from every telescope under this dome";
            return Err((Reason::NoPermit, detail.to_owned()));
        }
        self.hold = false;
        if self.closing.take().is_some() {
            self.expected = Expected::Unknown;
        }
        Ok(())
    }

    /// Looks at the dome: `shutter` is a fresh reading or none, `parked` says that every mount is known to be parked.
    pub fn look(&mut self, now: MachineTime, shutter: Option<Shutter>, parked: bool) -> Vec<Deed> {
        let closed = shutter == Some(Shutter::Closed);
        let uncommanded = self.compare(now, shutter);
        if self.closing.is_none() && !closed && (uncommanded || self.must_close(now)) {
            let commanded = self.expected == Expected::Closing;
            self.closing = Some(Closing::begun(now, commanded));
        }
        let mut deeds = Vec::new();
        let mut alarms = Vec::new();
        if uncommanded || (self.standing.contains(&Alarm::Uncommanded) && (self.closing.is_some() || self.hold)) {
            alarms.push(Alarm::Uncommanded);
        }
        match self.closing.take() {
            Some(closing) if closed => {
                self.hold |= !closing.commanded && self.was_open;
                self.was_open = false;
                self.expected = Expected::Closed;
            }
            Some(mut closing) => {
                self.close(&mut closing, now, shutter, parked, &mut deeds, &mut alarms);
                self.closing = Some(closing);
            }
            None if closed => self.was_open = false,
            None => {}
        }
        if self.hold {
            alarms.push(Alarm::Hold);
        }
        deeds.extend(self.show(alarms));
        deeds
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
                // right after the command a dome may still say closed
                let about_to_open =
                    matches!(self.expected, Expected::Open { since } if now.since(since) < self.settings.travel);
                if !about_to_open {
                    self.expected = Expected::Closed;
                }
                false
            }
            None => false,
        }
    }

    fn must_close(&self, now: MachineTime) -> bool {
        let telescopes = &self.settings.telescopes;
        let said_unsafe = telescopes.iter().any(|one| self.valid(one, now).is_some_and(|held| !held.safe));
        // a node that was restarted in the middle of the night gives its commander time to speak
        let starting = now.since(self.started) < self.settings.permit_valid && self.permits.is_empty();
        said_unsafe || (!self.may_be_open(now) && !starting)
    }

    fn close(
        &self,
        closing: &mut Closing,
        now: MachineTime,
        shutter: Option<Shutter>,
        parked: bool,
        deeds: &mut Vec<Deed>,
        alarms: &mut Vec<Alarm>,
    ) {
        let Settings { policy, parked_within, travel, .. } = self.settings;
        let waited = now.since(closing.since) >= parked_within;
        let may_move = match policy {
            CloseWithMount::Beside => true,
            CloseWithMount::ParkedWithinS => parked || waited,
            CloseWithMount::ParkedOnly => parked,
        };
        if !may_move {
            if waited {
                alarms.push(Alarm::MountNotParked);
            }
            return;
        }
        let moving = shutter == Some(Shutter::Closing);
        if moving {
            closing.moving_since.get_or_insert(now);
        } else {
            closing.moving_since = None;
        }
        // on its way: a second command, let alone a stop, would only disturb it
        let on_its_way = closing.moving_since.is_some_and(|since| now.since(since) < travel);
        let due = closing.last_try.is_none_or(|last| now.since(last) >= RETRY);
        if due && !on_its_way {
            deeds.push(if closing.tries >= PATIENCE { Deed::AbortThenClose } else { Deed::Close });
            closing.tries += 1;
            closing.last_try = Some(now);
            closing.moving_since = None;
        }
        if closing.tries > PATIENCE || now.since(closing.since) >= travel + GRACE {
            alarms.push(Alarm::NotClosed);
        }
    }

    /// The difference between the alarms that stood and those that stand now.
    fn show(&mut self, alarms: Vec<Alarm>) -> Vec<Deed> {
        let begun = alarms.iter().filter(|alarm| !self.standing.contains(alarm)).map(|alarm| Deed::Raise(*alarm));
        let ended = self.standing.iter().filter(|alarm| !alarms.contains(alarm)).map(|alarm| Deed::Clear(*alarm));
        let changes = begun.chain(ended).collect();
        self.standing = alarms;
        changes
    }

    /// What the guard publishes with a number; `malformed` permits were dropped before it heard them.
    pub fn says(&self, number: u64, now: MachineTime, malformed: u64) -> Said {
        let permits = self.permits.iter().map(|(telescope, held)| {
            let (valid, age) = (self.settings.permit_valid.as_secs_f64(), now.since(held.sent).as_secs_f64());
            HeardPermit {
                telescope: telescope.to_string(),
                commander: held.commander.clone(),
                safe: held.safe,
                left_s: valid - age,
            }
        });
        Said {
            number,
            token: self.tokens.values().copied().max().unwrap_or(0),
            permit_valid_s: self.settings.permit_valid.as_secs_f64(),
            permits: permits.collect(),
            may_be_open: self.may_be_open(now),
            action: if self.closing.is_some() { GuardAction::Closing } else { GuardAction::Watching },
            hold: self.hold,
            dropped: self.dropped + malformed,
        }
    }
}

#[cfg(test)]
#[path = "guard_tests.rs"]
mod tests;
