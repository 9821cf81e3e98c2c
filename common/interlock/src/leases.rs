//! The leases of a site as one device node knows them: it grants those of its own enclosures and follows all others.

use contract::device::dome::Guard;
use contract::observatory::{Lease, Permit};
use contract::{Device, Reason, Stamped};
use units::MachineTime;

use crate::guard_words::Roofs;
use crate::holder::Claimant;
use crate::known_tokens::KnownTokens;
use crate::site_permits::SitePermits;
use crate::turned::Turned;

/// Tokens, and who commands with them.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Leases {
    tokens: KnownTokens,
    site: SitePermits,
}

/// A token of another node's count, which counts here from now on and has to be written to disk.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Followed {
    /// The telescope.
    pub telescope: String,
    /// Its newest token.
    pub token: u64,
}

impl Leases {
    /// Nothing was received yet; these tokens are known from the disk.
    pub fn new(tokens: KnownTokens) -> Self {
        Self { tokens, site: SitePermits::default() }
    }

    /// The tokens that count.
    pub fn tokens(&self) -> &KnownTokens {
        &self.tokens
    }

    /// The tokens that count, to be changed by what the disk has, or has taken.
    pub fn tokens_mut(&mut self) -> &mut KnownTokens {
        &mut self.tokens
    }

    /// Is there a permit that is safe and young?
    pub fn is_safe(&self, telescope: &str, now: MachineTime) -> bool {
        self.site.is_safe(telescope, now)
    }

    /// What the guards of a telescope's enclosures publish now.
    pub fn roofs(&self, enclosures: &[Device], now: MachineTime) -> Roofs {
        self.site.roofs(enclosures, now)
    }

    /// A guard has published: what it granted counts here, except for telescopes whose leases this node grants.
    pub fn receive_guard(&mut self, dome: &Device, sample: &Stamped<Guard>, arrived: MachineTime) -> Vec<Followed> {
        self.site.guard(dome.clone(), &sample.boot_id, &sample.body, arrived);
        for granted in &sample.body.granted {
            self.tokens.show(&granted.telescope, granted.token);
        }
        let granted = sample.body.granted.iter().map(|granted| granted.telescope.as_str());
        let followed = granted.filter_map(|telescope| {
            let token = self.site.token_of_guards(telescope, arrived)?;
            self.follow(telescope, token)
        });
        followed.collect()
    }

    /// A permit was published; one that no guard would take counts for nothing.
    pub fn receive_permit(&mut self, telescope: &str, dome: &str, sample: &Stamped<Permit>, arrived: MachineTime) {
        self.tokens.show(telescope, sample.body.token);
        if self.site.is_answer(dome, &sample.body, arrived) {
            let granted = self.tokens.highest(telescope);
            self.site.observe(telescope, sample, arrived, granted);
        }
    }

    /// A commander has published its lease: where neither this node nor a guard counts, the token in it counts.
    pub fn receive_lease(
        &mut self,
        telescope: &str,
        sample: &Stamped<Lease>,
        arrived: MachineTime,
    ) -> Option<Followed> {
        let token = sample.body.token;
        self.tokens.show(telescope, token);
        let is_counted = self.tokens.is_arbiter(telescope) || self.site.token_of_guards(telescope, arrived).is_some();
        let newest = if is_counted { None } else { self.site.token_of_lease(telescope, token, arrived) };
        let followed = newest.and_then(|token| self.follow(telescope, token));
        if token == self.tokens.highest(telescope) {
            self.site.lease(telescope, sample, arrived);
        }
        followed
    }

    /// Follows the count of another node; the arbiter itself follows nobody.
    pub fn follow(&mut self, telescope: &str, token: u64) -> Option<Followed> {
        self.tokens.follows(telescope, token).then(|| {
            self.tokens.learn(telescope, token);
            Followed { telescope: telescope.to_owned(), token }
        })
    }

    /// May this process be granted the lease? Not while another one that holds it has published lately.
    pub fn claim(&self, telescope: &str, who: Claimant, now: MachineTime) -> Result<(), Turned> {
        let Some(holder) = self.site.rival(telescope, who, now) else { return Ok(()) };
        let whose = if holder == who.name { "another process, or another incarnation, of " } else { "" };
        Err((Reason::LeaseHeld, format!("{whose}{holder} holds the lease and has published within 5 s")))
    }

    /// The lease was granted, and its token is on disk; after a newer one it has no effect.
    pub fn granted(&mut self, telescope: &str, token: u64, who: Claimant, now: MachineTime) {
        if token >= self.tokens.highest(telescope) {
            self.tokens.learn(telescope, token);
            self.site.granted(telescope, who, now);
        }
    }
}

#[cfg(test)]
#[path = "leases_tests.rs"]
mod tests;
