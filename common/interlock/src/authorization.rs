//! May a command pass? By its token, the permits, the lease, and what a closing that is due needs.

use contract::Reason;
use units::MachineTime;

use crate::fence::{commanded, fence};
use crate::guard::Guard;
use crate::hinders::{DueClosing, Hinders};
use crate::holder::Claimant;
use crate::leases::Leases;
use crate::mount_watch::Calls;
use crate::need::Need;
use crate::turned::Turned;

/// The demand of the roof over a mount: to be parked, because the roof must close and waits for that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct RoofCall {
    /// The roof must close and waits.
    pub must_park: bool,
    /// The telescope's own permit is valid and safe: its commander does not know that the roof must close.
    pub unknown_to_commander: bool,
}

impl RoofCall {
    /// By what a mount is known to be allowed.
    pub fn of(calls: Calls) -> Self {
        let must_park = calls.must_park();
        Self { must_park, unknown_to_commander: must_park && calls.permitted }
    }
}

/// A command, as far as its authorization depends on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandNeeds<'a> {
    /// What it needs.
    pub need: Need,
    /// What it may hinder.
    pub hinders: Hinders,
    /// Its sender.
    pub who: Claimant<'a>,
    /// The token in it.
    pub token: Option<u64>,
}

/// What becomes of a command that is not refused.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Admitted {
    /// It passes.
    Passes,
    /// Its sender is to be granted the lease of this telescope: the next token is written to disk, and then
    /// [`Leases::granted`] and [`Guard::grant`] are called.
    IsGranted {
        /// The telescope.
        telescope: String,
    },
}

/// What is known where a command to one device is authorized.
#[derive(Debug)]
pub struct Authorization<'a> {
    /// The telescope that the device belongs to, `shared` for a site's own.
    pub telescope: &'a str,
    /// This device grants the lease.
    pub is_arbiter: bool,
    /// The demand of the roof over a mount.
    pub roof: RoofCall,
    /// Tokens, and who commands.
    pub leases: &'a Leases,
    /// The guard, for a dome.
    pub guard: Option<&'a mut Guard>,
}

impl Authorization<'_> {
    /// May this command pass? The guard of a dome notes that it was commanded to open, to close or to resume.
    pub fn admit(&mut self, asked: CommandNeeds, now: MachineTime) -> Result<Admitted, Turned> {
        let CommandNeeds { need, hinders, who, token } = asked;
        let (from, roof) = (who.name, self.roof);
        let due = DueClosing {
            dome_closes: self.guard.as_ref().is_some_and(|guard| guard.needs_closing(now)),
            must_park: roof.must_park,
            unknown_to_commander: roof.unknown_to_commander,
        };
        hinders.keep_out_of_the_way(due, || self.fence(from, token).is_ok())?;
        match need {
            Need::Nothing => {}
            Need::Close => {
                if let Some(guard) = &mut self.guard {
                    guard.close_commanded(now);
                }
            }
            Need::Token => self.fence(from, token)?,
            Need::TokenWhileSafe => {
                if self.leases.is_safe(&self.commanded(from)?, now) {
                    self.fence(from, token)?;
                }
            }
            Need::Open => {
                self.fence(from, token)?;
                self.guard.as_mut().map_or(Ok(()), |guard| guard.open_commanded(now))?;
            }
            Need::TokenAndPermit => {
                self.fence(from, token)?;
                if self.guard.as_ref().is_some_and(|guard| !guard.may_be_open(now)) {
                    let detail = "no valid safe permit from every telescope under this dome";
                    return Err((Reason::NoPermit, detail.to_owned()));
                }
            }
            Need::Resume => {
                self.fence(from, token)?;
                self.guard.as_mut().map_or(Ok(()), |guard| guard.resume(now))?;
            }
            Need::Claim => return self.claim(who, now),
        }
        Ok(Admitted::Passes)
    }

    fn claim(&self, who: Claimant, now: MachineTime) -> Result<Admitted, Turned> {
        if !self.is_arbiter {
            let detail = "the enclosure grants the lease, or the mount where there is none";
            return Err((Reason::NotImplemented, detail.to_owned()));
        }
        let telescope = self.commanded(who.name)?;
        self.leases.claim(&telescope, who, now)?;
        Ok(Admitted::IsGranted { telescope })
    }

    fn fence(&self, from: &str, token: Option<u64>) -> Result<(), Turned> {
        let (telescope, tokens) = (self.commanded(from)?, self.leases.tokens());
        fence(token, tokens.highest(&telescope), tokens.is_arbiter(&telescope))
    }

    fn commanded(&self, from: &str) -> Result<String, Turned> {
        let served = self.guard.as_ref().map_or(&[][..], |guard| guard.telescopes());
        commanded(from, served, self.telescope)
    }
}

#[cfg(test)]
#[path = "authorization_tests.rs"]
mod tests;
