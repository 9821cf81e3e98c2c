//! The authorization of commands to a device; `interlock::Authorization` decides it.

use std::sync::{Arc, Mutex, PoisonError};

use bus::Clock;
use contract::observatory::AlertKind;
use contract::{CommandId, Reason};
use interlock::{Admitted, Authorization, Claimant, CommandNeeds, Guard, NextToken, RoofCall, Turned};
use node::NodeAlerts;

use crate::token::Tokens;

/// The authorization of commands to one device.
pub struct CommandCheck {
    /// The telescope that the device belongs to, `shared` for a site's own.
    pub telescope: String,
    /// Highest tokens known, and which process commands.
    pub tokens: Arc<Tokens>,
    /// The clock.
    pub clock: Clock,
    /// The alerts of this node.
    pub alerts: NodeAlerts,
    /// The guard, for a dome.
    pub guard: Option<Arc<Mutex<Guard>>>,
    /// This device grants the lease.
    pub is_arbiter: bool,
    /// What the roof over a mount asks of it.
    pub roof: Mutex<RoofCall>,
}

impl CommandCheck {
    /// May the command with this id pass? A claim comes back with its token.
    pub async fn admit(&self, id: &CommandId, asked: CommandNeeds<'_>) -> Result<Option<u64>, Turned> {
        match self.decide(asked)? {
            Admitted::Passes => Ok(None),
            Admitted::IsGranted { telescope } => {
                self.grant(telescope, (asked.who, asked.token), id.clone()).await.map(Some)
            }
        }
    }

    fn decide(&self, asked: CommandNeeds) -> Result<Admitted, Turned> {
        let roof = *self.roof.lock().unwrap_or_else(PoisonError::into_inner);
        let mut guard = self.guard();
        let leases = self.tokens.leases();
        let mut authorization = Authorization {
            telescope: &self.telescope,
            is_arbiter: self.is_arbiter,
            roof,
            leases: &leases,
            guard: guard.as_deref_mut(),
        };
        authorization.admit(asked, self.clock.machine())
    }

    /// Grants the lease: its token is on disk before it counts. `shows`: the token that the claimant remembers.
    async fn grant(
        &self,
        telescope: String,
        (who, shows): (Claimant<'_>, Option<u64>),
        claim: CommandId,
    ) -> Result<u64, Turned> {
        let (tokens, name, boot_id) = (self.tokens.clone(), telescope.clone(), who.boot_id.cloned());
        let granted = tokio::task::spawn_blocking(move || tokens.grant(&name, (boot_id.as_ref(), shows), &claim)).await;
        let granted = granted.map_err(std::io::Error::other).and_then(|granted| granted);
        let NextToken { token, left_behind } = granted.map_err(|error| (Reason::DeviceError, not_written(&error)))?;
        match left_behind {
            Some(own) => {
                let before = token.saturating_sub(1);
                let cause = format!(
                    "{telescope}: the file with the newest lease of this node has {own}; {}, another node or the guard process has \
                     shown {before}, so that the count goes on with {token}",
                    who.name
                );
                tracing::warn!("{cause}");
                self.alerts.raise(AlertKind::LeaseCountLost, &telescope, &cause);
            }
            None => self.alerts.clear(AlertKind::LeaseCountLost, &telescope),
        }
        self.tokens.leases().granted(&telescope, token, who, self.clock.machine());
        if let Some(mut guard) = self.guard() {
            guard.grant(&telescope, token, who.boot_id);
        }
        tracing::info!(telescope, from = who.name, token, "lease granted");
        Ok(token)
    }

    fn guard(&self) -> Option<std::sync::MutexGuard<'_, Guard>> {
        Some(self.guard.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Why no lease is granted, for people.
fn not_written(error: &std::io::Error) -> String {
    format!(
        "its disk does not take the next token ({error}): make room there, or let the device node's account write there; it is \
         tried again each second"
    )
}
