//! Which process commands each telescope of the site, as the permits and leases on the bus show.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bus::{Bus, BusError, Catch, MachineTime};
use contract::device::dome::{GrantedToken, Guard};
use contract::observatory::{Lease, Permit};
use contract::{Chunk, Device, Key, Kind, Part};
use interlock::{Claimant, Roofs, SitePermits};

use crate::token::Tokens;

/// The newest permits and leases, shared by the devices of a node.
#[derive(Default)]
pub struct Permits {
    site: Mutex<SitePermits>,
}

impl Permits {
    fn site(&self) -> MutexGuard<'_, SitePermits> {
        self.site.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Is there a permit that is safe and young?
    pub fn is_safe(&self, telescope: &str, now: MachineTime) -> bool {
        self.site().is_safe(telescope, now)
    }

    /// Another process that holds the lease and was received from within the last 5 s, by its name.
    pub fn rival(&self, telescope: &str, claimant: Claimant, now: MachineTime) -> Option<String> {
        self.site().rival(telescope, claimant, now).map(str::to_owned)
    }

    /// Somebody holds the lease now.
    pub fn granted(&self, telescope: &str, claimant: Claimant, now: MachineTime) {
        self.site().granted(telescope, claimant, now);
    }

    /// What the guards of a telescope's enclosures publish now.
    pub fn roofs(&self, enclosures: &[Device], now: MachineTime) -> Roofs {
        self.site().roofs(enclosures, now)
    }
}

/// Receives the permits and leases of all telescopes of a site, for as long as it is polled.
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
                permits.site().guard(dome.clone(), &heard.said.boot_id, &heard.said.body, heard.arrived);
                for GrantedToken { telescope, .. } in &heard.said.body.granted {
                    let told = permits.site().told_by_guards(telescope, heard.arrived);
                    if let Some(token) = told {
                        follow(&tokens, telescope, token).await;
                    }
                }
            }
            heard = heard_permits.hear() => {
                let Key::Permit(address, dome) = &heard.key else { continue };
                if permits.site().is_answer(dome.as_str(), &heard.said.body, heard.arrived) {
                    let telescope = address.telescope.as_str();
                    let granted = tokens.highest(telescope);
                    permits.site().hear(telescope, &heard.said, heard.arrived, granted);
                }
            }
            heard = heard_leases.hear() => {
                let Key::Observatory(address, _) = &heard.key else { continue };
                let telescope = address.telescope.as_str();
                let token = heard.said.body.token;
                let by_guards = || permits.site().told_by_guards(telescope, heard.arrived);
                let is_told = tokens.is_arbiter(telescope) || by_guards().is_some();
                let told = if is_told { None } else { permits.site().told_by_lease(telescope, token, heard.arrived) };
                if let Some(token) = told {
                    follow(&tokens, telescope, token).await;
                }
                if token == tokens.highest(telescope) {
                    permits.site().lease(telescope, &heard.said, heard.arrived);
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
