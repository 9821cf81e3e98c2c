//! The nodes that publish in the name of a dome's guard: each incarnation for itself, since a stranger may use that
//! name too.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, Catch, Lives, MachineTime};
use contract::device::dome::Guard;
use contract::{BootId, Device, Key};
use tokio::sync::watch;

/// A guard publishes each second; one that was silent for so long is not there.
const LIVING: Duration = Duration::from_secs(5);

/// The guards of one dome: one, unless something is wrong. Cheap to clone.
#[derive(Clone)]
pub struct Guards {
    words: Arc<Mutex<Lives<Guard>>>,
    heard: watch::Receiver<u64>,
    _listening: Arc<Listening>,
}

struct Listening(tokio::task::JoinHandle<()>);

impl Drop for Listening {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Guards {
    /// Subscribes to the guards of a dome.
    pub async fn listen(bus: &Bus, dome: &Device) -> anyhow::Result<Self> {
        let subscriber = bus.subscribe::<Guard>(&Key::Guard(dome.clone()).to_string(), Catch::Newest, 32).await?;
        let words = Arc::new(Mutex::new(Lives::new(LIVING)));
        let (stir, heard) = watch::channel(0_u64);
        let into = words.clone();
        let listening = tokio::spawn(async move {
            loop {
                let heard = subscriber.hear().await;
                let mut words = into.lock().unwrap_or_else(PoisonError::into_inner);
                words.hear(&heard.said.boot_id, heard.said.body, heard.arrived);
                stir.send_modify(|count| *count = count.wrapping_add(1));
            }
        });
        Ok(Self { words, heard, _listening: Arc::new(Listening(listening)) })
    }

    /// What was published within the last 5 s, by incarnation.
    pub fn living(&self, now: MachineTime) -> Vec<(BootId, Guard)> {
        let words = self.words.lock().unwrap_or_else(PoisonError::into_inner);
        words.within(LIVING, now).map(|(life, said)| (life.clone(), said.clone())).collect()
    }

    /// Waits for the next sample.
    pub async fn changed(&mut self) {
        if self.heard.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

/// What the guards of a dome publish of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LeaseKnown {
    /// One of them names ours, or none publishes.
    Ours,
    /// One names ours and another one a newer: a stranger publishes in the guard's name.
    Disputed,
    /// It was granted anew, to somebody else.
    Lost,
    /// The arbiter knows of no lease as new as ours.
    Unknown,
}

/// The state of a lease with this token, by what the guards publish. Pure.
pub fn standing(living: &[(BootId, Guard)], telescope: &str, token: u64) -> LeaseKnown {
    let granted = living.iter().map(|(_, said)| {
        let own = said.granted.iter().find(|granted| granted.telescope == telescope);
        own.map_or(said.token, |own| own.token)
    });
    let (mut ours, mut newer, mut older) = (false, false, false);
    for known in granted {
        match known.cmp(&token) {
            std::cmp::Ordering::Equal => ours = true,
            std::cmp::Ordering::Greater => newer = true,
            std::cmp::Ordering::Less => older = true,
        }
    }
    match (ours, newer, older) {
        (true, true, _) => LeaseKnown::Disputed,
        (false, true, _) => LeaseKnown::Lost,
        (false, false, true) => LeaseKnown::Unknown,
        (true, false, _) | (false, false, false) => LeaseKnown::Ours,
    }
}

#[cfg(test)]
mod tests {
    use contract::device::dome::{GrantedToken, GuardAction};

    use super::*;

    fn says(token: u64) -> (BootId, Guard) {
        let guard = Guard {
            number: 1,
            token: 99,
            permit_valid_s: 10.0,
            permits: Vec::new(),
            may_be_open: false,
            action: GuardAction::Watching,
            hold: false,
            dropped: 0,
            verified_closed: None,
            waits_for_mounts: None,
            granted: vec![GrantedToken { telescope: "alpha".to_owned(), token }],
        };
        (BootId::fresh(), guard)
    }

    #[test]
    fn a_lease_is_lost_only_where_no_guard_knows_it_any_more() {
        for (words, expected) in [
            (vec![], LeaseKnown::Ours),
            (vec![says(7)], LeaseKnown::Ours),
            (vec![says(8)], LeaseKnown::Lost),
            (vec![says(6)], LeaseKnown::Unknown),
            (vec![says(7), says(u64::MAX)], LeaseKnown::Disputed),
            (vec![says(7), says(0)], LeaseKnown::Ours),
        ] {
            assert_eq!(standing(&words, "alpha", 7), expected, "{words:?}");
        }
    }
}
