//! The permits of one dome: which are accepted, whose count, and how long; pure.
//!
//! A permit counts by the number in it, which this guard sent, and by the lease in it, which this node granted to one
//! incarnation of one process. No sample on the bus teaches a token: a peer that invents one is dropped and counted.

use std::cmp::Ordering;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use contract::device::dome::{GrantedToken, ReceivedPermit};
use contract::observatory::{Permit, Verdict};
use contract::{BootId, Chunk, Stamped};
use units::MachineTime;

/// Numbers that are remembered with the time they were sent; the longest permit lasts 30 s.
const NUMBERS: usize = 64;

/// Why a permit was dropped; each is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Dropped {
    /// Of a telescope that is not under this dome.
    Stranger,
    /// Its number is of another incarnation of this guard.
    OtherBoot,
    /// A number that this guard never sent, or so long ago that it does not remember.
    UnknownNumber,
    /// Sent before one that was received already.
    Replayed,
    /// Of an older lease.
    OldToken,
    /// Of a lease that this arbiter never granted.
    NeverGranted,
    /// The lease was granted to another incarnation.
    OtherIncarnation,
}

/// What became of a permit that was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Taken {
    /// It follows the one before.
    Next,
    /// Two publish with one lease and in one name: a permit answers a newer number and is counted as an older one.
    Contested,
}

/// A lease as it was granted.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Granted {
    token: u64,
    /// The incarnation that it was granted to; not known of one that was granted before this node started.
    boot_id: Option<BootId>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Held {
    boot_id: BootId,
    seq: u64,
    number: u64,
    sent: MachineTime,
    token: u64,
    safe: bool,
    commander: String,
}

/// The permits of one dome.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct PermitLedger {
    boot_id: BootId,
    telescopes: Vec<Chunk>,
    permit_valid: Duration,
    next_number: u64,
    sent: VecDeque<(u64, MachineTime)>,
    permits: BTreeMap<Chunk, Held>,
    granted: BTreeMap<Chunk, Granted>,
    /// Leases with which permits of two senders were received.
    shared: BTreeMap<Chunk, u64>,
    /// When the number was sent that the newest unsafe permit of two speakers answers.
    contested: BTreeMap<Chunk, MachineTime>,
    dropped: u64,
}

impl PermitLedger {
    /// Nothing is received yet; `tokens` were granted before.
    pub fn new(boot_id: BootId, telescopes: Vec<Chunk>, permit_valid: Duration, tokens: BTreeMap<Chunk, u64>) -> Self {
        let granted = tokens.into_iter().map(|(telescope, token)| (telescope, Granted { token, boot_id: None }));
        Self {
            boot_id,
            telescopes,
            permit_valid,
            next_number: 0,
            sent: VecDeque::new(),
            permits: BTreeMap::new(),
            granted: granted.collect(),
            shared: BTreeMap::new(),
            contested: BTreeMap::new(),
            dropped: 0,
        }
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
    pub fn observe(&mut self, telescope: &Chunk, sample: &Stamped<Permit>) -> Result<Taken, Dropped> {
        match self.weigh(telescope, sample) {
            Ok((held, taken)) => {
                let before = self.permits.insert(telescope.clone(), held.clone());
                if taken == Taken::Contested {
                    self.shared.insert(telescope.clone(), held.token);
                }
                if self.shared.get(telescope) == Some(&held.token) {
                    // If two publish in one name, nobody can know which is the commander: the safer permit counts.
                    let both = before.iter().chain([&held]);
                    if let Some(sent) = both.filter(|one| !one.safe).map(|one| one.sent).max() {
                        self.contested.insert(telescope.clone(), sent);
                    }
                }
                Ok(taken)
            }
            Err(why) => {
                self.dropped += 1;
                Err(why)
            }
        }
    }

    fn weigh(&self, telescope: &Chunk, sample: &Stamped<Permit>) -> Result<(Held, Taken), Dropped> {
        let permit = &sample.body;
        if !self.telescopes.contains(telescope) {
            return Err(Dropped::Stranger);
        }
        if permit.guard_boot_id != self.boot_id {
            return Err(Dropped::OtherBoot);
        }
        let sent = self.sent.iter().find(|(number, _)| *number == permit.guard_number).map(|(_, at)| *at);
        let sent = sent.ok_or(Dropped::UnknownNumber)?;
        // The arbiter alone grants: a token that it never granted teaches it nothing.
        let granted = self.granted.get(telescope).cloned().unwrap_or_default();
        match permit.token.cmp(&granted.token) {
            Ordering::Less => return Err(Dropped::OldToken),
            Ordering::Greater => return Err(Dropped::NeverGranted),
            Ordering::Equal => {}
        }
        if granted.boot_id.is_some_and(|boot_id| boot_id != sample.boot_id) {
            return Err(Dropped::OtherIncarnation);
        }
        let mut taken = Taken::Next;
        if let Some(have) = self.permits.get(telescope).filter(|have| have.token == permit.token) {
            // Within one lease nothing goes back: not the number, and not the sender's count.
            let counts_on = have.boot_id == sample.boot_id && sample.seq > have.seq;
            let reports_more = have.boot_id != sample.boot_id || (have.safe && permit.verdict == Verdict::Unsafe);
            let repeats = permit.guard_number == have.number && !counts_on && !reports_more;
            if permit.guard_number < have.number || repeats {
                return Err(Dropped::Replayed);
            }
            if !counts_on {
                taken = Taken::Contested;
            }
        }
        let held = Held {
            boot_id: sample.boot_id.clone(),
            seq: sample.seq,
            number: permit.guard_number,
            sent,
            token: permit.token,
            safe: permit.verdict == Verdict::Safe,
            commander: permit.commander.clone(),
        };
        Ok((held, taken))
    }

    /// This node granted a lease; permits of older ones, and of other incarnations, are dropped from now on.
    pub fn grant(&mut self, telescope: &str, token: u64, boot_id: Option<&BootId>) {
        let Some(telescope) = self.telescopes.iter().find(|own| own.as_str() == telescope) else { return };
        let known = self.granted.entry(telescope.clone()).or_default();
        if token >= known.token {
            *known = Granted { token, boot_id: boot_id.cloned() };
        }
    }

    fn left(&self, held: &Held, now: MachineTime) -> Duration {
        held.sent.plus(self.permit_valid).since(now)
    }

    fn valid(&self, telescope: &Chunk, now: MachineTime) -> Option<&Held> {
        self.permits.get(telescope).filter(|held| !self.left(held, now).is_zero())
    }

    /// Of two that publish with one lease, one is or was unsafe, and that permit is still valid.
    fn is_contested(&self, telescope: &Chunk, now: MachineTime) -> bool {
        self.contested.get(telescope).is_some_and(|sent| sent.plus(self.permit_valid) > now)
    }

    /// True while every telescope's permit is valid and safe.
    pub fn are_safe(&self, now: MachineTime) -> bool {
        let is_safe = |telescope: &Chunk| {
            self.valid(telescope, now).is_some_and(|held| held.safe) && !self.is_contested(telescope, now)
        };
        !self.telescopes.is_empty() && self.telescopes.iter().all(is_safe)
    }

    /// How long every telescope's permit stays valid and safe if nothing more is received.
    pub fn are_safe_for(&self, now: MachineTime) -> Duration {
        if !self.are_safe(now) {
            return Duration::ZERO;
        }
        let left = self.telescopes.iter().map(|one| self.valid(one, now).map(|held| self.left(held, now)));
        left.map(Option::unwrap_or_default).min().unwrap_or_default()
    }

    /// Is a valid permit unsafe?
    pub fn is_reported_unsafe(&self, now: MachineTime) -> bool {
        let is_unsafe = |one| self.valid(one, now).is_some_and(|held| !held.safe) || self.is_contested(one, now);
        self.telescopes.iter().any(is_unsafe)
    }

    /// No permit was taken yet.
    pub fn none_received(&self) -> bool {
        self.permits.is_empty()
    }

    /// Permits that were dropped.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// The newest permits, for people.
    pub fn published(&self, now: MachineTime) -> Vec<ReceivedPermit> {
        let permits = self.permits.iter().map(|(telescope, held)| {
            let (valid, age) = (self.permit_valid.as_secs_f64(), now.since(held.sent).as_secs_f64());
            ReceivedPermit {
                telescope: telescope.to_string(),
                commander: held.commander.clone(),
                safe: held.safe,
                left_s: valid - age,
            }
        });
        permits.collect()
    }

    /// The leases that this node granted.
    pub fn granted(&self) -> Vec<GrantedToken> {
        let granted = self.granted.iter().filter(|(_, granted)| granted.token > 0);
        granted
            .map(|(telescope, granted)| GrantedToken { telescope: telescope.to_string(), token: granted.token })
            .collect()
    }
}

#[cfg(test)]
#[path = "permit_ledger_tests.rs"]
mod tests;
