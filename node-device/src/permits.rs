//! Who commands each telescope of the site, as the permits and leases on the bus tell.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, BusError, Catch, Heard, MachineTime};
use contract::device::dome::{GrantedToken, Guard};
use contract::observatory::{Lease, Permit, Verdict};
use contract::{BootId, Chunk, Device, Key, Kind, Part};

use crate::guard_words::{GuardWords, Roofs};
use crate::holder::{Claimant, Holding};
use crate::token::Tokens;

/// How long a permit counts for devices that have no guard of their own.
pub const PERMIT_VALID: Duration = Duration::from_secs(10);

/// The arbiter counts one by one; a commander's permit that leaps farther does not count at once.
const STEP: u64 = 1000;

/// What was heard last, by telescope.
#[derive(Default)]
pub struct Permits {
    newest: Mutex<BTreeMap<String, Newest>>,
    guards: Mutex<GuardWords>,
    /// By telescope, where no guard publishes its lease: the newest token that its commander published.
    leases: Mutex<BTreeMap<String, (u64, MachineTime)>>,
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
    number: u64,
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

    /// What the guards of a telescope's enclosures publish now.
    pub fn roofs(&self, enclosures: &[Device], now: MachineTime) -> Roofs {
        self.guards.lock().unwrap_or_else(PoisonError::into_inner).roofs(enclosures, now)
    }

    /// A dome's guard has spoken.
    fn guard(&self, dome: Device, life: &BootId, said: &Guard, arrived: MachineTime) {
        self.guards.lock().unwrap_or_else(PoisonError::into_inner).hear(dome, life, said, arrived);
    }

    /// The token that the guards of the site publish for a telescope, if any does.
    fn told_by_guards(&self, telescope: &str, now: MachineTime) -> Option<u64> {
        self.guards.lock().unwrap_or_else(PoisonError::into_inner).token(telescope, now)
    }

    /// Does a permit answer a number that its dome's guard has said lately? The guard itself would drop it otherwise.
    fn is_answer(&self, dome: &str, permit: &Permit, now: MachineTime) -> bool {
        self.guards.lock().unwrap_or_else(PoisonError::into_inner).is_answered(dome, permit, now)
    }

    /// The token of a lease that no guard publishes, by its commander's permits: one step of a count follows another, and a
    /// larger leap, or a step back, counts only once the one before it is silent.
    fn told_by_lease(&self, telescope: &str, token: u64, arrived: MachineTime) -> Option<u64> {
        let mut leases = self.leases.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, at)) = leases.get(telescope) {
            let follows = token >= *known && token - known <= STEP;
            if !follows && arrived.since(*at) <= PERMIT_VALID {
                return None;
            }
        }
        leases.insert(telescope.to_owned(), (token, arrived));
        Some(token)
    }

    /// Takes a permit unless it is old, or its token is not the one that was granted.
    fn hear(&self, telescope: &str, heard: &Heard<Permit>, granted: u64) {
        let permit = &heard.said.body;
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = newest.entry(telescope.to_owned()).or_default();
        let repeats = entry.permit.as_ref().is_some_and(|have| {
            let is_older = heard.said.seq <= have.seq && permit.guard_number <= have.number;
            have.token == permit.token && have.boot_id == heard.said.boot_id && is_older
        });
        if permit.token != granted || repeats {
            return;
        }
        entry.holding.hear(&permit.commander, &heard.said.boot_id, permit.token, heard.arrived);
        entry.permit = Some(HeardPermit {
            boot_id: heard.said.boot_id.clone(),
            seq: heard.said.seq,
            number: permit.guard_number,
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
    let heard_permits = bus.subscribe::<Permit>(&permit_keys, Catch::Newest, 64).await?;
    let heard_leases = bus.subscribe::<Lease>(&lease_keys, Catch::Newest, 64).await?;
    loop {
        tokio::select! {
            heard = heard_guards.hear() => {
                let Key::Guard(dome) = &heard.key else { continue };
                permits.guard(dome.clone(), &heard.said.boot_id, &heard.said.body, heard.arrived);
                for GrantedToken { telescope, .. } in &heard.said.body.granted {
                    if let Some(token) = permits.told_by_guards(telescope, heard.arrived) {
                        follow(&tokens, telescope, token).await;
                    }
                }
            }
            heard = heard_permits.hear() => {
                let Key::Permit(address, dome) = &heard.key else { continue };
                if permits.is_answer(dome.as_str(), &heard.said.body, heard.arrived) {
                    let telescope = address.telescope.as_str();
                    permits.hear(telescope, &heard, tokens.highest(telescope));
                }
            }
            heard = heard_leases.hear() => {
                let Key::Observatory(address, _) = &heard.key else { continue };
                let telescope = address.telescope.as_str();
                let token = heard.said.body.token;
                let is_told = tokens.is_arbiter(telescope) || permits.told_by_guards(telescope, heard.arrived).is_some();
                if !is_told && let Some(token) = permits.told_by_lease(telescope, token, heard.arrived) {
                    follow(&tokens, telescope, token).await;
                }
                if token == tokens.highest(telescope) {
                    permits.lease(telescope, &heard);
                }
            }
        }
    }
}

/// Takes over what the arbiter, or where it publishes nothing the commander, publishes of a lease.
async fn follow(tokens: &Arc<Tokens>, telescope: &str, token: u64) {
    if token == tokens.highest(telescope) || tokens.is_arbiter(telescope) {
        return;
    }
    let (tokens, name) = (tokens.clone(), telescope.to_owned());
    let written = tokio::task::spawn_blocking(move || tokens.follow(&name, token)).await;
    if let Ok(Err(error)) = written {
        tracing::error!(telescope, token, %error, "a fencing token could not be written; it holds until this node ends");
    }
}
