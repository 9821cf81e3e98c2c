//! The authorization of commands to a device: checks token, permit and lease before a command is accepted.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use bus::Clock;
use contract::Reason;
use interlock::{Claimant, DueClosing, Guard, Hinders, Need, Turned, commanded, fence};

use crate::permits::Permits;
use crate::token::Tokens;

/// The authorization of commands to one device.
pub struct Gate {
    /// The telescope that the device belongs to, `shared` for a site's own.
    pub telescope: String,
    /// Highest tokens known.
    pub tokens: Arc<Tokens>,
    /// Which process commands.
    pub permits: Arc<Permits>,
    /// The clock.
    pub clock: Clock,
    /// The guard, for a dome.
    pub guard: Option<Arc<Mutex<Guard>>>,
    /// This device grants the lease.
    pub is_arbiter: bool,
    /// What the roof over a mount asks of it.
    pub roof: Arc<RoofCall>,
}

/// The demand of the roof over a mount: to be parked, because the roof must close and waits for that.
#[derive(Debug, Default)]
pub struct RoofCall {
    must_park: AtomicBool,
    /// The telescope's own permit is valid and safe: its commander does not know that the roof must close.
    unknown_to_commander: AtomicBool,
}

impl RoofCall {
    /// What holds from now on.
    pub fn set(&self, must_park: bool, is_permitted: bool) {
        self.must_park.store(must_park, Ordering::Relaxed);
        self.unknown_to_commander.store(must_park && is_permitted, Ordering::Relaxed);
    }
}

impl Gate {
    /// May this command pass? A claim comes back with its token.
    pub async fn admit(
        &self,
        (need, hinders): (Need, Hinders),
        who: Claimant<'_>,
        token: Option<u64>,
    ) -> Result<Option<u64>, Turned> {
        let from = who.name;
        self.keep_out_of_the_way(hinders, from, token)?;
        match need {
            Need::Nothing => {}
            Need::Close => {
                let now = self.clock.machine();
                self.with_guard(|guard| guard.close_commanded(now));
            }
            Need::Token => self.fence(from, token)?,
            Need::TokenWhileSafe => {
                if self.permits.is_safe(&self.commanded(from)?, self.clock.machine()) {
                    self.fence(from, token)?;
                }
            }
            Need::Open => {
                self.fence(from, token)?;
                let now = self.clock.machine();
                self.with_guard(|guard| guard.open_commanded(now)).unwrap_or(Ok(()))?;
            }
            Need::TokenAndPermit => {
                self.fence(from, token)?;
                let now = self.clock.machine();
                if self.with_guard(|guard| guard.may_be_open(now)) == Some(false) {
                    let detail = "no valid safe permit from every telescope under this dome";
                    return Err((Reason::NoPermit, detail.to_owned()));
                }
            }
            Need::Resume => {
                self.fence(from, token)?;
                let now = self.clock.machine();
                self.with_guard(|guard| guard.resume(now)).unwrap_or(Ok(()))?;
            }
            Need::Claim => return self.claim(who).await.map(Some),
        }
        Ok(None)
    }

    fn keep_out_of_the_way(&self, hinders: Hinders, from: &str, token: Option<u64>) -> Result<(), Turned> {
        let now = self.clock.machine();
        let due = DueClosing {
            dome_closes: self.with_guard(|guard| guard.needs_closing(now)) == Some(true),
            must_park: self.roof.must_park.load(Ordering::Relaxed),
            unknown_to_commander: self.roof.unknown_to_commander.load(Ordering::Relaxed),
        };
        hinders.keep_out_of_the_way(due, || self.fence(from, token).is_ok())
    }

    fn fence(&self, from: &str, token: Option<u64>) -> Result<(), Turned> {
        let telescope = self.commanded(from)?;
        fence(token, self.tokens.highest(&telescope), self.tokens.is_arbiter(&telescope))
    }

    async fn claim(&self, who: Claimant<'_>) -> Result<u64, Turned> {
        if !self.is_arbiter {
            let detail = "the enclosure grants the lease, or the mount where there is none";
            return Err((Reason::NotImplemented, detail.to_owned()));
        }
        let (telescope, from) = (self.commanded(who.name)?, who.name);
        if let Some(holder) = self.permits.rival(&telescope, who, self.clock.machine()) {
            let whose = if holder == from { "another process, or another life, of " } else { "" };
            return Err((Reason::LeaseHeld, format!("{whose}{holder} holds the lease and was heard within 5 s")));
        }
        let (tokens, name, life) = (self.tokens.clone(), telescope.clone(), who.life.cloned());
        let granted = tokio::task::spawn_blocking(move || tokens.grant(&name, life.as_ref())).await;
        let granted = granted.map_err(std::io::Error::other).and_then(|granted| granted);
        let token = granted.map_err(|error| (Reason::DeviceError, format!("the token cannot be written: {error}")))?;
        self.permits.granted(&telescope, who, self.clock.machine());
        self.with_guard(|guard| guard.grant(&telescope, token, who.life));
        tracing::info!(telescope, from, token, "lease granted");
        Ok(token)
    }

    fn commanded(&self, from: &str) -> Result<String, Turned> {
        let served = self.with_guard(|guard| guard.telescopes().to_vec()).unwrap_or_default();
        commanded(from, &served, &self.telescope)
    }

    fn with_guard<T>(&self, use_it: impl FnOnce(&mut Guard) -> T) -> Option<T> {
        let guard = self.guard.as_ref()?;
        Some(use_it(&mut guard.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}
