//! Verifies passwords without letting a flood of wrong ones stop the host or the people who know theirs.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bus::MachineTime;
use contract::Name;
use local_http::{Places, Room};
use tokio::sync::Semaphore;
use users::{SecretHash, Users};

use super::buckets::Buckets;

/// Wrong passwords of one address: so many at once, and then one each 10 s.
const OF_ADDRESS: (f64, f64) = (0.1, 5.0);
/// Wrong passwords for one name, of all addresses: more than one address may try.
const OF_NAME: (f64, f64) = (1.0, 60.0);
/// Logins that wait for a processor; one address has its share of them.
const WAITING: Room = Room { total: 64, per_address: 4, trusted: 8 };
const FULL: Duration = Duration::from_secs(2);
/// Addresses with the user who logged in from there.
const MOST_KNOWN: usize = 500;

/// The way of all passwords.
pub struct Logins {
    by_address: Mutex<Buckets<IpAddr>>,
    by_name: Mutex<Buckets<SecretHash>>,
    known: Mutex<VecDeque<(IpAddr, Name)>>,
    waiting: Arc<Places>,
    /// One password at a time of users at addresses where they logged in before, and one of all others.
    of_known: Arc<Semaphore>,
    of_others: Arc<Semaphore>,
}

impl Default for Logins {
    fn default() -> Self {
        Self {
            by_address: Mutex::new(Buckets::new(OF_ADDRESS.0, OF_ADDRESS.1)),
            by_name: Mutex::new(Buckets::new(OF_NAME.0, OF_NAME.1)),
            known: Mutex::default(),
            waiting: Places::new(WAITING),
            of_known: Arc::new(Semaphore::new(1)),
            of_others: Arc::new(Semaphore::new(1)),
        }
    }
}

impl Logins {
    /// The user whose password this is; absent if it is none.
    ///
    /// # Errors
    /// How long to wait before the next try.
    pub async fn verify(
        &self,
        users: Arc<Users>,
        name: &str,
        password: String,
        address: IpAddr,
        now: MachineTime,
    ) -> Result<Option<Name>, Duration> {
        let network = local_http::network(address);
        let known = users.user(name).map(|(name, _)| (network, name.clone()));
        let is_known = known.as_ref().is_some_and(|known| lock(&self.known).contains(known));
        // The address first: what is refused to it does not use up the tries of the name.
        lock(&self.by_address).take(network, now)?;
        if !is_known {
            lock(&self.by_name).take(SecretHash::of(name), now)?;
        }
        let place = self.waiting.take(address).ok_or(FULL)?;
        let semaphore = if is_known { &self.of_known } else { &self.of_others };
        let turn = semaphore.clone().acquire_owned().await.map_err(|_| FULL)?;
        let asked = name.to_owned();
        // Held by the work itself, which goes on though its client has gone.
        let work = move || {
            let found = users.log_in(&asked, &password).map(|(name, _)| name.clone());
            drop((turn, place));
            found
        };
        let found = tokio::task::spawn_blocking(work).await.map_err(|_| FULL)?;
        if let Some(name) = &found {
            lock(&self.by_address).give_back(network, now);
            if !is_known {
                lock(&self.by_name).give_back(SecretHash::of(name.as_str()), now);
            }
            self.remember((network, name.clone()));
        }
        Ok(found)
    }

    fn remember(&self, pair: (IpAddr, Name)) {
        let mut known = lock(&self.known);
        known.retain(|other| *other != pair);
        known.push_back(pair);
        if known.len() > MOST_KNOWN {
            known.pop_front();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use users::{PasswordHash, User};

    use super::*;

    const RIGHT: &str = "four plain words here";

    fn ana() -> Arc<Users> {
        let mut users = Users::default();
        let password = PasswordHash::of_new(RIGHT, "ana").unwrap();
        users.users.insert("ana".parse().unwrap(), User { password, grants: Vec::new() });
        Arc::new(users)
    }

    async fn log_in(
        logins: &Logins,
        users: &Arc<Users>,
        password: &str,
        address: [u8; 4],
        s: u64,
    ) -> Result<bool, Duration> {
        let now = MachineTime::from_boot(Duration::from_secs(s));
        let found = logins.verify(users.clone(), "ana", password.to_owned(), address.into(), now).await;
        found.map(|found| found.is_some())
    }

    #[tokio::test]
    async fn an_address_has_five_wrong_tries_and_then_one_each_ten_seconds_while_others_log_in() {
        let (logins, users) = (Logins::default(), ana());
        for _ in 0..5 {
            assert_eq!(log_in(&logins, &users, "wrong", [10, 0, 0, 1], 0).await, Ok(false));
        }
        for _ in 0..1000 {
            assert_eq!(log_in(&logins, &users, "wrong", [10, 0, 0, 1], 0).await, Err(Duration::from_secs(10)));
        }
        assert_eq!(log_in(&logins, &users, RIGHT, [10, 0, 0, 1], 0).await, Err(Duration::from_secs(10)));
        for _ in 0..20 {
            assert_eq!(log_in(&logins, &users, RIGHT, [10, 0, 0, 2], 0).await, Ok(true), "right ones are not counted");
        }
        assert_eq!(log_in(&logins, &users, RIGHT, [10, 0, 0, 1], 10).await, Ok(true));
    }

    #[tokio::test]
    async fn a_flood_of_many_addresses_is_limited_by_name_but_not_where_the_user_logged_in_before() {
        let (logins, users) = (Logins::default(), ana());
        assert_eq!(log_in(&logins, &users, RIGHT, [10, 9, 9, 9], 0).await, Ok(true));
        let mut tried = 0;
        for number in 0..100 {
            tried += usize::from(log_in(&logins, &users, "wrong", [10, 0, 1, number], 0).await.is_ok());
        }
        assert_eq!(tried, 60);
        assert!(log_in(&logins, &users, RIGHT, [10, 9, 9, 8], 0).await.is_err(), "a new address waits a second");
        assert_eq!(log_in(&logins, &users, RIGHT, [10, 9, 9, 9], 0).await, Ok(true));
        assert_eq!(log_in(&logins, &users, RIGHT, [10, 9, 9, 8], 1).await, Ok(true));
    }
}
