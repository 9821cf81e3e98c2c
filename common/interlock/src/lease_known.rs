//! What the guards of a dome publish of a lease.

use std::cmp::Ordering;

use contract::BootId;
use contract::device::dome::Guard;

/// The state of a lease, by what the guards publish.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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

impl LeaseKnown {
    /// Of the lease with this token; `living` are the guards that published lately, by incarnation.
    pub fn of(living: &[(BootId, Guard)], telescope: &str, token: u64) -> Self {
        let granted = living.iter().map(|(_, guard)| {
            let own = guard.granted.iter().find(|granted| granted.telescope == telescope);
            own.map_or(guard.token, |own| own.token)
        });
        let (mut ours, mut newer, mut older) = (false, false, false);
        for known in granted {
            match known.cmp(&token) {
                Ordering::Equal => ours = true,
                Ordering::Greater => newer = true,
                Ordering::Less => older = true,
            }
        }
        match (ours, newer, older) {
            (true, true, _) => Self::Disputed,
            (false, true, _) => Self::Lost,
            (false, false, true) => Self::Unknown,
            (true, false, _) | (false, false, false) => Self::Ours,
        }
    }
}

#[cfg(test)]
mod tests {
    use contract::device::dome::{GrantedToken, GuardAction};

    use super::*;

    fn publishes(token: u64) -> (BootId, Guard) {
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
            watchdog_s: None,
            granted: vec![GrantedToken { telescope: "alpha".to_owned(), token }],
        };
        (BootId::fresh(), guard)
    }

    #[test]
    fn a_lease_is_lost_only_where_no_guard_knows_it_any_more() {
        for (samples, expected) in [
            (vec![], LeaseKnown::Ours),
            (vec![publishes(7)], LeaseKnown::Ours),
            (vec![publishes(8)], LeaseKnown::Lost),
            (vec![publishes(6)], LeaseKnown::Unknown),
            (vec![publishes(7), publishes(u64::MAX)], LeaseKnown::Disputed),
            (vec![publishes(7), publishes(0)], LeaseKnown::Ours),
        ] {
            assert_eq!(LeaseKnown::of(&samples, "alpha", 7), expected, "{samples:?}");
        }
    }
}
