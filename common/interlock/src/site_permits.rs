//! Which process commands each telescope of a site, as the permits, leases and guards on the bus show; pure.

use std::collections::BTreeMap;

use contract::device::dome::Guard;
use contract::observatory::{Lease, Permit, Verdict};
use contract::{BootId, Device, Stamped};
use units::MachineTime;

use crate::guard_words::{GuardWords, PERMIT_VALID, Roofs};
use crate::holder::{Claimant, Holding};

/// The arbiter counts one by one; a commander's permit that leaps farther does not count at once.
const STEP: u64 = 1000;

/// The newest of what was received, by telescope.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct SitePermits {
    newest: BTreeMap<String, Newest>,
    guards: GuardWords,
    /// By telescope, where no guard publishes its lease: the newest token that its commander published.
    leases: BTreeMap<String, (u64, MachineTime)>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Newest {
    holding: Holding,
    permit: Option<ReceivedPermit>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct ReceivedPermit {
    boot_id: BootId,
    seq: u64,
    number: u64,
    token: u64,
    safe: bool,
    arrived: MachineTime,
}

impl SitePermits {
    /// Is there a permit that is safe and young?
    pub fn is_safe(&self, telescope: &str, now: MachineTime) -> bool {
        let permit = self.newest.get(telescope).and_then(|newest| newest.permit.as_ref());
        permit.is_some_and(|permit| permit.safe && now.since(permit.arrived) <= PERMIT_VALID)
    }

    /// Another process that holds the lease and published within the last 5 s, by its name.
    pub fn rival(&self, telescope: &str, claimant: Claimant, now: MachineTime) -> Option<&str> {
        self.newest.get(telescope)?.holding.rival(claimant, now)
    }

    /// Somebody holds the lease now.
    pub fn granted(&mut self, telescope: &str, claimant: Claimant, now: MachineTime) {
        self.newest.entry(telescope.to_owned()).or_default().holding.grant(claimant, now);
    }

    /// A lease was published: an empty holder has released it. Where permits are published, they alone keep it alive.
    pub fn lease(&mut self, telescope: &str, sample: &Stamped<Lease>, arrived: MachineTime) {
        let (lease, boot_id) = (&sample.body, &sample.boot_id);
        let entry = self.newest.entry(telescope.to_owned()).or_default();
        if lease.holder.is_empty() {
            entry.holding.release(boot_id, lease.token);
        } else if entry.permit.is_none() {
            entry.holding.observe(&lease.holder, boot_id, lease.token, arrived);
        }
    }

    /// What the guards of a telescope's enclosures publish now.
    pub fn roofs(&self, enclosures: &[Device], now: MachineTime) -> Roofs {
        self.guards.roofs(enclosures, now)
    }

    /// A dome's guard has published.
    pub fn guard(&mut self, dome: Device, boot_id: &BootId, sample: &Guard, arrived: MachineTime) {
        self.guards.observe(dome, boot_id, sample, arrived);
    }

    /// The token that the guards of the site publish for a telescope, if any does.
    pub fn token_of_guards(&self, telescope: &str, now: MachineTime) -> Option<u64> {
        self.guards.token(telescope, now)
    }

    /// Does a permit answer a number that its dome's guard has published lately? The guard itself would drop it
    /// otherwise.
    pub fn is_answer(&self, dome: &str, permit: &Permit, now: MachineTime) -> bool {
        self.guards.is_answered(dome, permit, now)
    }

    /// The token of a lease that no guard publishes, by its commander's permits: one step of a count follows another,
    /// and a larger leap, or a step back, counts only once the one before it is silent.
    pub fn token_of_lease(&mut self, telescope: &str, token: u64, arrived: MachineTime) -> Option<u64> {
        if let Some((known, at)) = self.leases.get(telescope) {
            let follows = token >= *known && token - known <= STEP;
            if !follows && arrived.since(*at) <= PERMIT_VALID {
                return None;
            }
        }
        self.leases.insert(telescope.to_owned(), (token, arrived));
        Some(token)
    }

    /// Takes a permit unless it is old, or its token is not the one that was granted.
    pub fn observe(&mut self, telescope: &str, sample: &Stamped<Permit>, arrived: MachineTime, granted: u64) {
        let permit = &sample.body;
        let entry = self.newest.entry(telescope.to_owned()).or_default();
        let repeats = entry.permit.as_ref().is_some_and(|have| {
            let is_older = sample.seq <= have.seq && permit.guard_number <= have.number;
            have.token == permit.token && have.boot_id == sample.boot_id && is_older
        });
        if permit.token != granted || repeats {
            return;
        }
        entry.holding.observe(&permit.commander, &sample.boot_id, permit.token, arrived);
        entry.permit = Some(ReceivedPermit {
            boot_id: sample.boot_id.clone(),
            seq: sample.seq,
            number: permit.guard_number,
            token: permit.token,
            safe: permit.verdict == Verdict::Safe,
            arrived,
        });
    }
}
