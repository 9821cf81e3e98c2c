//! The order in which frames are fetched: each spool has its own turns, so that a slow spool delays no other.
//!
//! A spool is known by host and port of its frames' addresses. One that has not brought a whole frame yet has one turn,
//! and all of these share a number: a program that announces frames of a thousand addresses opens no thousand
//! connections.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Frames of one spool that are on their way at the same time: one on the wire while another goes to the disk. One that
/// has not brought a whole frame yet has one less.
const OF_ONE_SPOOL: usize = 2;
/// Frames of all spools together that have not brought a whole frame yet.
const OF_NEW_SPOOLS: usize = 32;
/// Spools that are remembered; a program that announces more names than a network has spools gets the turns of new
/// ones.
const MOST_SPOOLS: usize = 256;

/// The turns of all spools.
#[derive(Debug)]
pub struct Turns {
    spools: Mutex<HashMap<String, Spool>>,
    new: Arc<Semaphore>,
}

#[derive(Debug, Clone)]
struct Spool {
    turns: Arc<Semaphore>,
    /// It has brought a whole frame.
    is_proven: bool,
}

/// The right to fetch one frame; given back when it is dropped.
#[derive(Debug)]
pub struct Turn {
    _of_spool: Option<OwnedSemaphorePermit>,
    _of_new: Option<OwnedSemaphorePermit>,
}

impl Default for Turns {
    fn default() -> Self {
        Self { spools: Mutex::default(), new: Arc::new(Semaphore::new(OF_NEW_SPOOLS)) }
    }
}

impl Turns {
    /// Waits for a turn of the spool that this address belongs to.
    pub async fn wait(&self, url: &str) -> Turn {
        let Spool { turns, is_proven } = self.spool(url);
        // The semaphores are never closed, so waiting cannot fail.
        let of_spool = turns.acquire_owned().await.ok();
        let of_new = if is_proven { None } else { self.new.clone().acquire_owned().await.ok() };
        Turn { _of_spool: of_spool, _of_new: of_new }
    }

    /// The spool of this address has brought a whole frame.
    pub fn proven(&self, url: &str) {
        if let Some(spool) = self.spools().get_mut(authority(url))
            && !std::mem::replace(&mut spool.is_proven, true)
        {
            spool.turns.add_permits(1);
        }
    }

    fn spool(&self, url: &str) -> Spool {
        let mut spools = self.spools();
        if spools.len() >= MOST_SPOOLS && !spools.contains_key(authority(url)) {
            // Nothing waits for a turn of a spool whose turns are all free.
            spools.retain(|_, spool| spool.is_proven || spool.turns.available_permits() == 0);
        }
        let fresh = || Spool { turns: Arc::new(Semaphore::new(OF_ONE_SPOOL - 1)), is_proven: false };
        spools.entry(authority(url).to_owned()).or_insert_with(fresh).clone()
    }

    fn spools(&self) -> std::sync::MutexGuard<'_, HashMap<String, Spool>> {
        self.spools.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Host and port of an address; the whole of what is no address.
fn authority(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest);
    rest.split(['/', '?', '#']).next().unwrap_or(rest)
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;

    /// The turn, if it need not be waited for.
    fn at_once(turns: &Turns, url: &str) -> Option<Turn> {
        turns.wait(url).now_or_never()
    }

    #[test]
    fn a_spool_is_known_by_host_and_port() {
        assert_eq!(authority("http://dome.local:7450/frame/x?token=t"), "dome.local:7450");
        assert_eq!(authority("http://[::1]:7450?x"), "[::1]:7450");
        assert_eq!(authority("nonsense"), "nonsense");
    }

    #[test]
    fn a_spool_that_holds_all_its_turns_holds_up_no_other() {
        let turns = Turns::default();
        let slow = "http://slow:1/a";
        let held = at_once(&turns, slow).unwrap();
        assert!(at_once(&turns, "http://slow:1/b").is_none(), "its own second frame waits");
        assert!(at_once(&turns, "http://good:1/a").is_some());
        drop(held);
        assert!(at_once(&turns, slow).is_some());
    }

    #[test]
    fn strangers_share_a_few_turns_and_a_proven_spool_has_its_own() {
        let turns = Turns::default();
        drop(at_once(&turns, "http://good:1/a").unwrap());
        turns.proven("http://good:1/a");
        let strangers = (0..OF_NEW_SPOOLS).map(|number| at_once(&turns, &format!("http://stranger-{number}:1/a")));
        let held: Vec<Turn> = strangers.map(Option::unwrap).collect();
        assert!(at_once(&turns, "http://another:1/a").is_none());
        let both = [at_once(&turns, "http://good:1/b"), at_once(&turns, "http://good:1/c")].map(Option::unwrap);
        assert!(at_once(&turns, "http://good:1/d").is_none());
        drop((held, both));
    }

    #[test]
    fn a_thousand_names_are_not_remembered_for_ever() {
        let turns = Turns::default();
        for number in 0..1000 {
            drop(at_once(&turns, &format!("http://stranger-{number}:1/a")).unwrap());
        }
        assert!(turns.spools().len() <= MOST_SPOOLS);
    }
}
