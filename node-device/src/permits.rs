//! Receives what guards and commanders publish of the permits and leases of a site.

use std::sync::Arc;

use bus::{Bus, BusError, Catch};
use contract::device::dome::Guard;
use contract::observatory::{Lease, Permit};
use contract::{Chunk, Key, Part, Topic};
use interlock::Followed;

use crate::token::Tokens;

/// Receives the permits and leases of all telescopes of a site, for as long as it is polled.
pub async fn listen(bus: Bus, site: Chunk, tokens: Arc<Tokens>) -> Result<(), BusError> {
    let guards = bus.subscribe::<Guard>(Topic::Guard.on_site(&site), Catch::Newest, 64).await?;
    let permits = bus.subscribe::<Permit>(Topic::Permit.on_site(&site), Catch::Newest, 64).await?;
    let lease_keys = Topic::Observatory(Part::Lease).on_site(&site);
    let leases = bus.subscribe::<Lease>(lease_keys, Catch::Newest, 64).await?;
    loop {
        let followed = tokio::select! {
            received = guards.recv() => {
                let Key::Guard(dome) = &received.key else { continue };
                tokens.leases().receive_guard(dome, &received.sample, received.arrived)
            }
            received = permits.recv() => {
                let Key::Permit(address, dome) = &received.key else { continue };
                tokens.leases().receive_permit(address.telescope.as_str(), dome.as_str(), &received.sample, received.arrived);
                continue;
            }
            received = leases.recv() => {
                let Key::Observatory(address, _) = &received.key else { continue };
                let followed = tokens.leases().receive_lease(address.telescope.as_str(), &received.sample, received.arrived);
                followed.into_iter().collect()
            }
        };
        if !followed.is_empty() {
            persist(&tokens, &followed).await;
        }
    }
}

/// Writes what was followed; the tokens count already.
async fn persist(tokens: &Arc<Tokens>, followed: &[Followed]) {
    let tokens = tokens.clone();
    if let Ok(Err(error)) = tokio::task::spawn_blocking(move || tokens.persist()).await {
        for Followed { telescope, token } in followed {
            tracing::error!(
                telescope, token, %error, "a fencing token could not be written; it holds until this node ends"
            );
        }
    }
}
