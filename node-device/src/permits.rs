//! Who commands each telescope of the site, as the permits and leases on the bus tell.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, BusError, Catch, Heard, MachineTime, Succession};
use contract::device::dome::Guard;
use contract::observatory::{Lease, Permit, Verdict};
use contract::{BootId, Chunk, Key, Kind, Part};

use crate::holder::{Claimant, Holding};
use crate::token::Tokens;

/// How long a permit counts for devices that have no guard of their own.
const PERMIT_VALID: Duration = Duration::from_secs(10);

/// What was heard last, by telescope.
#[derive(Default)]
pub struct Permits {
    newest: Mutex<BTreeMap<String, Newest>>,
    /// By dome: life of its guard, and the newest number that it has said.
    guards: Mutex<BTreeMap<String, (BootId, u64, MachineTime)>>,
}

#[derive(Debug, Clone, Default)]
struct Newest {
    holding: Holding,
    permit: Option<HeardPermit>,
}

#[derive(Debug, Clone)]
struct HeardPermit {
    boot_id: BootId,
    seq: u64,
    token: u64,
    safe: bool,
    arrived: MachineTime,
}

impl Permits {
    /// Does a permit say safe, and is it young?
    pub fn is_safe(&self, telescope: &str, now: MachineTime) -> bool {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let permit = newest.get(telescope).and_then(|newest| newest.permit.as_ref());
        permit.is_some_and(|permit| permit.safe && now.since(permit.arrived) <= PERMIT_VALID)
    }

    /// Another process that holds the lease and was heard within the last 5 s, by its name.
    pub fn rival(&self, telescope: &str, claimant: Claimant, now: MachineTime) -> Option<String> {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.get(telescope)?.holding.rival(claimant, now).map(str::to_owned)
    }

    /// Somebody holds the lease now.
    pub fn granted(&self, telescope: &str, claimant: Claimant, now: MachineTime) {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.entry(telescope.to_owned()).or_default().holding.grant(claimant, now);
    }

    /// A lease was spoken of: an empty holder has released it. Where permits are spoken, they alone keep it alive.
    fn lease(&self, telescope: &str, heard: &Heard<Lease>) {
        let (lease, life) = (&heard.said.body, &heard.said.boot_id);
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = newest.entry(telescope.to_owned()).or_default();
        if lease.holder.is_empty() {
            entry.holding.release(life, lease.token);
        } else if entry.permit.is_none() {
            entry.holding.hear(&lease.holder, life, lease.token, heard.arrived);
        }
    }

    /// A dome's guard has said its number.
    fn guard(&self, dome: &str, boot_id: &BootId, number: u64, arrived: MachineTime) {
        let mut guards = self.guards.lock().unwrap_or_else(PoisonError::into_inner);
        guards.insert(dome.to_owned(), (boot_id.clone(), number, arrived));
    }

    /// Does a permit answer a number that its dome's guard has said lately? The guard itself would drop it otherwise.
    fn is_answer(&self, dome: &str, permit: &Permit, now: MachineTime) -> bool {
        let guards = self.guards.lock().unwrap_or_else(PoisonError::into_inner);
        guards.get(dome).is_some_and(|(boot_id, newest, arrived)| {
            let age_s = newest.saturating_sub(permit.guard_number);
            let is_young = age_s <= PERMIT_VALID.as_secs() && now.since(*arrived) <= PERMIT_VALID;
            // on its way here the permit may have overtaken the number that it answers
            permit.guard_boot_id == *boot_id && permit.guard_number <= newest + 1 && is_young
        })
    }

    /// Takes a permit unless it is old or of an old token.
    fn hear(&self, telescope: &str, heard: &Heard<Permit>, highest_token: u64) {
        let permit = &heard.said.body;
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = newest.entry(telescope.to_owned()).or_default();
        let repeats = entry.permit.as_ref().is_some_and(|have| {
            have.token == permit.token && have.boot_id == heard.said.boot_id && heard.said.seq <= have.seq
        });
        if permit.token < highest_token || repeats {
            return;
        }
        entry.holding.hear(&permit.commander, &heard.said.boot_id, permit.token, heard.arrived);
        entry.permit = Some(HeardPermit {
            boot_id: heard.said.boot_id.clone(),
            seq: heard.said.seq,
            token: permit.token,
            safe: permit.verdict == Verdict::Safe,
            arrived: heard.arrived,
        });
    }
}

/// Hears the permits and leases of all telescopes of a site, for as long as it is polled.
pub async fn listen(bus: Bus, site: Chunk, tokens: Arc<Tokens>, permits: Arc<Permits>) -> Result<(), BusError> {
    let root = contract::key::ROOT;
    let word = Part::Lease.word();
    let permit_keys = format!("{root}/{site}/*/observatory/permit/*");
    let lease_keys = format!("{root}/{site}/*/observatory/{word}/state");
    let guard_keys = format!("{root}/{site}/*/device/{}/*/guard", Kind::Dome);
    let heard_guards = bus.subscribe::<Guard>(&guard_keys, Catch::Newest, 64).await?;
    let mut successions: BTreeMap<String, Succession> = BTreeMap::new();
    let heard_permits = bus.subscribe::<Permit>(&permit_keys, Catch::Newest, 64).await?;
    let heard_leases = bus.subscribe::<Lease>(&lease_keys, Catch::Newest, 64).await?;
    loop {
        tokio::select! {
            heard = heard_guards.hear() => {
                let Key::Guard(dome) = &heard.key else { continue };
                let (name, said) = (dome.name.as_str(), &heard.said);
                if successions.entry(name.to_owned()).or_default().is_newer(&said.boot_id, said.seq, heard.arrived) {
                    permits.guard(name, &said.boot_id, said.body.number, heard.arrived);
                }
            }
            heard = heard_permits.hear() => {
                let Key::Permit(address, dome) = &heard.key else { continue };
                if !permits.is_answer(dome.as_str(), &heard.said.body, heard.arrived) {
                    continue;
                }
                let telescope = address.telescope.as_str();
                learn(&tokens, telescope, heard.said.body.token).await;
                permits.hear(telescope, &heard, tokens.highest(telescope));
            }
            heard = heard_leases.hear() => {
                let Key::Observatory(address, _) = &heard.key else { continue };
                let telescope = address.telescope.as_str();
                let token = heard.said.body.token;
                learn(&tokens, telescope, token).await;
                if token == tokens.highest(telescope) {
                    permits.lease(telescope, &heard);
                }
            }
        }
    }
}

async fn learn(tokens: &Arc<Tokens>, telescope: &str, token: u64) {
    if token <= tokens.highest(telescope) {
        return;
    }
    let (tokens, name) = (tokens.clone(), telescope.to_owned());
    let written = tokio::task::spawn_blocking(move || tokens.heard(&name, token)).await;
    if let Ok(Err(error)) = written {
        tracing::error!(telescope, token, %error, "a fencing token could not be written; it holds until this node ends");
    }
}
