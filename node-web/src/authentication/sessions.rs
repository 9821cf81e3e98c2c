//! Sessions of people who logged in, and tickets for their sockets; both in memory only.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::Duration;

use bus::MachineTime;
use contract::Name;
use units::Utc;
use users::{NoRandomness, PasswordHash, Secret, SecretHash, User, Users};

use super::Credential;

/// A session ends so long after its beginning,
pub const LONGEST: Duration = Duration::from_secs(12 * 3600);
/// and so long after its last request.
const IDLE: Duration = Duration::from_secs(2 * 3600);
/// The oldest session of a user, or of all, makes room for a new one.
const MOST: usize = 2000;
const MOST_OF_USER: usize = 20;
/// A ticket can be used once, so long.
pub const TICKET_VALID: Duration = Duration::from_secs(30);
const MOST_TICKETS: usize = 1000;

/// One session.
#[derive(Debug, Clone)]
pub struct Session {
    /// By which it can be ended; it proves nothing.
    pub id: String,
    /// Its user.
    pub user: Name,
    /// From which address the user logged in.
    pub address: IpAddr,
    /// When.
    pub began_utc: Utc,
    password: PasswordHash,
    began: MachineTime,
    seen: MachineTime,
}

impl Session {
    /// Has the user still the password of the login?
    pub fn is_of(&self, users: &Users) -> bool {
        users.users.get(&self.user).is_some_and(|user| user.password == self.password)
    }

    /// Since its last request, and until its end.
    pub fn ages(&self, now: MachineTime) -> (Duration, Duration) {
        let idle = now.since(self.seen);
        (idle, LONGEST.saturating_sub(now.since(self.began)).min(IDLE.saturating_sub(idle)))
    }

    fn is_over(&self, now: MachineTime) -> bool {
        self.ages(now).1.is_zero()
    }
}

/// All sessions, under the hash of what their cookie holds.
#[derive(Debug, Default)]
pub struct Sessions {
    by_hash: HashMap<SecretHash, Session>,
}

impl Sessions {
    /// Begins one for a user who has just proven the password.
    pub fn begin(
        &mut self,
        (user, of): (&Name, &User),
        address: IpAddr,
        now: MachineTime,
        began_utc: Utc,
    ) -> Result<Secret, NoRandomness> {
        let secret = Secret::fresh("")?;
        let id = Secret::fresh("")?.reveal().chars().take(16).collect();
        self.by_hash.retain(|_, session| !session.is_over(now));
        self.make_room(MOST_OF_USER, |session| session.user == *user);
        self.make_room(MOST, |_| true);
        let password = of.password.clone();
        let session = Session { id, user: user.clone(), address, began_utc, password, began: now, seen: now };
        self.by_hash.insert(secret.hash(), session);
        Ok(secret)
    }

    fn make_room(&mut self, most: usize, counts: impl Fn(&Session) -> bool) {
        let counted = || self.by_hash.iter().filter(|(_, session)| counts(session));
        if counted().count() >= most {
            let oldest = counted().min_by_key(|(_, session)| session.seen).map(|(hash, _)| *hash);
            oldest.and_then(|hash| self.by_hash.remove(&hash));
        }
    }

    /// The session of a cookie, if its time is not over.
    pub fn get(&self, hash: &SecretHash, now: MachineTime) -> Option<&Session> {
        self.by_hash.get(hash).filter(|session| !session.is_over(now))
    }

    /// Notes a request.
    pub fn touch(&mut self, hash: &SecretHash, now: MachineTime) {
        if let Some(session) = self.by_hash.get_mut(hash) {
            session.seen = now;
        }
    }

    /// Ends the session of a cookie.
    pub fn end(&mut self, hash: &SecretHash) {
        self.by_hash.remove(hash);
    }

    /// Ends those that are chosen; how many there were.
    pub fn end_all(&mut self, chosen: impl Fn(&SecretHash, &Session) -> bool) -> usize {
        let before = self.by_hash.len();
        self.by_hash.retain(|hash, session| !chosen(hash, session));
        before - self.by_hash.len()
    }

    /// All that are not over.
    pub fn list(&self, now: MachineTime) -> impl Iterator<Item = (&SecretHash, &Session)> {
        self.by_hash.iter().filter(move |(_, session)| !session.is_over(now))
    }
}

/// What opens a socket once, for browsers and libraries that cannot send a header with it.
#[derive(Debug, Default)]
pub struct Tickets {
    by_hash: HashMap<SecretHash, (Credential, MachineTime)>,
}

impl Tickets {
    /// Makes one for somebody who has proven who they are; absent while there are too many.
    pub fn make(&mut self, credential: Credential, now: MachineTime) -> Result<Option<Secret>, NoRandomness> {
        self.by_hash.retain(|_, (_, made)| now.since(*made) < TICKET_VALID);
        if self.by_hash.len() >= MOST_TICKETS {
            return Ok(None);
        }
        let secret = Secret::fresh("")?;
        self.by_hash.insert(secret.hash(), (credential, now));
        Ok(Some(secret))
    }

    /// Uses one up.
    pub fn redeem(&mut self, ticket: &str, now: MachineTime) -> Option<Credential> {
        let (credential, made) = self.by_hash.remove(&SecretHash::of(ticket))?;
        (now.since(made) < TICKET_VALID).then_some(credential)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(s: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(s))
    }

    fn user(name: &str) -> (Name, User) {
        let password = PasswordHash::of_new("four plain words here", name).unwrap();
        (name.parse().unwrap(), User { password, grants: Vec::new() })
    }

    fn begin(sessions: &mut Sessions, (name, user): &(Name, User), now: u64) -> Secret {
        sessions.begin((name, user), IpAddr::from([10, 0, 0, 1]), at(now), Utc::EPOCH).unwrap()
    }

    #[test]
    fn a_session_ends_after_two_idle_hours_and_after_twelve_in_any_case() {
        let (mut sessions, ana) = (Sessions::default(), user("ana"));
        let hash = begin(&mut sessions, &ana, 0).hash();
        assert!(sessions.get(&hash, at(7199)).is_some() && sessions.get(&hash, at(7200)).is_none());
        for hour in 1..12 {
            assert!(sessions.get(&hash, at(hour * 3600)).is_some(), "{hour}");
            sessions.touch(&hash, at(hour * 3600));
        }
        assert!(sessions.get(&hash, at(12 * 3600 - 1)).is_some() && sessions.get(&hash, at(12 * 3600)).is_none());
        assert_eq!(sessions.list(at(12 * 3600)).count(), 0);
    }

    #[test]
    fn a_session_is_over_with_the_password_it_began_with_and_with_its_user() {
        let (mut sessions, ana) = (Sessions::default(), user("ana"));
        let hash = begin(&mut sessions, &ana, 0).hash();
        let with = |users: &[(Name, User)]| Users { users: users.iter().cloned().collect(), ..Users::default() };
        let session = sessions.get(&hash, at(1)).unwrap();
        assert!(session.is_of(&with(std::slice::from_ref(&ana))));
        assert!(!session.is_of(&with(&[])) && !session.is_of(&with(&[user("ana")])), "the same words with a new salt");
    }

    #[test]
    fn the_number_of_sessions_is_bounded_and_the_oldest_makes_room() {
        let (mut sessions, ana, bob) = (Sessions::default(), user("ana"), user("bob"));
        let bobs = begin(&mut sessions, &bob, 0).hash();
        let first = begin(&mut sessions, &ana, 1).hash();
        for s in 2..100 {
            begin(&mut sessions, &ana, s);
        }
        assert_eq!(sessions.list(at(100)).count(), MOST_OF_USER + 1);
        assert!(sessions.get(&bobs, at(100)).is_some() && sessions.get(&first, at(100)).is_none());
        for number in 0..MOST + 10 {
            begin(&mut sessions, &(format!("u{number}").parse().unwrap(), ana.1.clone()), 100);
        }
        assert_eq!(sessions.list(at(100)).count(), MOST);
    }

    #[test]
    fn a_ticket_serves_once_and_for_thirty_seconds() {
        let mut tickets = Tickets::default();
        let mut make = |s| tickets.make(Credential::Open, at(s)).unwrap().unwrap();
        let (one, two) = (make(0), make(0));
        assert_eq!(tickets.redeem("x", at(1)), None);
        assert_eq!(tickets.redeem(one.reveal(), at(29)), Some(Credential::Open));
        assert_eq!((tickets.redeem(one.reveal(), at(29)), tickets.redeem(two.reveal(), at(30))), (None, None));
        for _ in 0..2000 {
            let _ = tickets.make(Credential::Open, at(40)).unwrap();
        }
        assert_eq!(tickets.by_hash.len(), MOST_TICKETS);
        assert!(tickets.make(Credential::Open, at(71)).unwrap().is_some());
    }
}
