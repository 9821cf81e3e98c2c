//! The newest payloads of the guards of a site, each incarnation for itself: numbers, granted tokens, and whether a
//! roof must close; pure.
//!
//! A peer that publishes in a guard's name takes nothing away from the real one: a permit that answers either is an
//! answer, and the smaller of two tokens fences. A roof counts as closing, and as not closed, when one of them
//! publishes that.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::device::dome::{Guard, GuardAction};
use contract::observatory::Permit;
use contract::{BootId, Device};
use units::MachineTime;

use crate::incarnations::Incarnations;

/// How long a permit counts for devices that have no guard of their own.
pub const PERMIT_VALID: Duration = Duration::from_secs(10);

/// A guard publishes each second; one that was silent for so long is not there.
const LIVING: Duration = Duration::from_secs(5);

/// What one incarnation of a guard published last.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Word {
    number: u64,
    granted: BTreeMap<String, u64>,
    is_closing: bool,
    waits_for_mounts: bool,
    is_closed: bool,
}

/// What the roofs over a mount ask of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Roofs {
    /// One of them closes, and moves only once the mount is parked.
    pub waits: bool,
    /// One that waits for the mount is being closed by its guard.
    pub closing: bool,
    /// All that wait for the mount are proven closed.
    pub closed: bool,
}

/// What was received from all guards.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct GuardWords {
    by_dome: BTreeMap<Device, Incarnations<Word>>,
    /// Whether a roof waits for its mounts does not change while its guard is silent.
    waits: BTreeMap<Device, bool>,
}

impl GuardWords {
    /// A guard has published.
    pub fn observe(&mut self, dome: Device, boot_id: &BootId, payload: &Guard, arrived: MachineTime) {
        if let Some(waits) = payload.waits_for_mounts {
            self.waits.insert(dome.clone(), waits);
        }
        let incarnations = self.by_dome.entry(dome).or_insert_with(|| Incarnations::new(PERMIT_VALID));
        let word = Word {
            number: payload.number,
            granted: payload.granted.iter().map(|granted| (granted.telescope.clone(), granted.token)).collect(),
            is_closing: payload.action == GuardAction::Closing,
            waits_for_mounts: payload.waits_for_mounts == Some(true),
            is_closed: payload.verified_closed == Some(true),
        };
        incarnations.observe(boot_id, word, arrived);
    }

    /// Does a permit answer a number that a guard of this dome has published lately?
    pub fn is_answered(&self, dome: &str, permit: &Permit, now: MachineTime) -> bool {
        let of_name = self.by_dome.iter().filter(|(device, _)| device.name.as_str() == dome);
        of_name.filter_map(|(_, incarnations)| incarnations.get(&permit.guard_boot_id)).any(|(word, arrived)| {
            let age_s = word.number.saturating_sub(permit.guard_number);
            let is_young = age_s <= PERMIT_VALID.as_secs() && now.since(*arrived) <= PERMIT_VALID;
            // On its way here the permit may have overtaken the number that it answers.
            permit.guard_number <= word.number.saturating_add(1) && is_young
        })
    }

    /// The newest token of a telescope, as running guards publish it: the smallest, where they contradict each other.
    pub fn token(&self, telescope: &str, now: MachineTime) -> Option<u64> {
        let living = self.by_dome.values().flat_map(|incarnations| incarnations.within(LIVING, now));
        living.filter_map(|(_, word)| word.granted.get(telescope).copied()).min()
    }

    /// What these roofs ask of the mount under them.
    pub fn roofs(&self, enclosures: &[Device], now: MachineTime) -> Roofs {
        let mut roofs = Roofs { closed: true, ..Roofs::default() };
        for dome in enclosures.iter().filter(|dome| self.waits.get(dome) == Some(&true)) {
            let living = self.by_dome.get(dome).into_iter().flat_map(|incarnations| incarnations.within(LIVING, now));
            let living: Vec<&Word> = living.map(|(_, word)| word).collect();
            roofs.waits = true;
            roofs.closing |= living.iter().any(|word| word.is_closing && word.waits_for_mounts);
            roofs.closed &= !living.is_empty() && living.iter().all(|word| word.is_closed);
        }
        roofs
    }
}

#[cfg(test)]
mod tests {
    use contract::Address;
    use contract::device::dome::GrantedToken;
    use contract::observatory::Verdict;

    use super::*;

    fn at(seconds: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs(1000 + seconds))
    }

    fn roof() -> Device {
        Address::new("site", "shared").unwrap().device(contract::Kind::Dome, &"roof".parse().unwrap())
    }

    fn guard_payload(number: u64, token: u64) -> Guard {
        Guard {
            number,
            token,
            permit_valid_s: 10.0,
            permits: Vec::new(),
            may_be_open: true,
            action: GuardAction::Watching,
            hold: false,
            dropped: 0,
            verified_closed: Some(false),
            waits_for_mounts: Some(true),
            watchdog_s: None,
            granted: vec![GrantedToken { telescope: "alpha".to_owned(), token }],
        }
    }

    fn answer(boot_id: &BootId, guard_number: u64) -> Permit {
        let (verdict, commander) = (Verdict::Safe, "observatory/alpha/main".to_owned());
        Permit { verdict, commander, token: 1, guard_number, guard_boot_id: boot_id.clone() }
    }

    #[test]
    fn a_stranger_in_a_guards_name_takes_no_answer_and_no_token_away() {
        let (real, stranger, mut words) = (BootId::fresh(), BootId::fresh(), GuardWords::default());
        words.observe(roof(), &real, &guard_payload(40, 3), at(0));
        words.observe(roof(), &stranger, &guard_payload(u64::MAX, u64::MAX), at(0));
        // Also with the real one's boot id.
        words.observe(roof(), &real, &guard_payload(u64::MAX, u64::MAX), at(0));
        words.observe(roof(), &real, &guard_payload(41, 3), at(1));
        assert!(words.is_answered("roof", &answer(&real, 41), at(1)));
        assert!(words.is_answered("roof", &answer(&real, 40), at(1)));
        assert!(!words.is_answered("roof", &answer(&real, 20), at(1)), "too old");
        assert!(!words.is_answered("roof", &answer(&BootId::fresh(), 41), at(1)));
        assert_eq!(words.token("alpha", at(1)), Some(3));
        assert_eq!(words.token("beta", at(1)), None);
        assert_eq!(words.token("alpha", at(7)), None, "silent");
        for _ in 0..20 {
            words.observe(roof(), &BootId::fresh(), &guard_payload(7, 0), at(1));
        }
        assert!(words.is_answered("roof", &answer(&real, 41), at(1)), "many strangers push nobody out");
    }

    #[test]
    fn a_roof_that_waits_informs_its_mounts_that_it_closes_and_when_it_has() {
        let (boot_id, mut words) = (BootId::fresh(), GuardWords::default());
        assert_eq!(words.roofs(&[roof()], at(0)), Roofs { waits: false, closing: false, closed: true });
        words.observe(roof(), &boot_id, &guard_payload(1, 1), at(0));
        assert_eq!(words.roofs(&[roof()], at(0)), Roofs { waits: true, closing: false, closed: false });
        let closing = Guard { action: GuardAction::Closing, ..guard_payload(2, 1) };
        words.observe(roof(), &boot_id, &closing, at(1));
        assert!(words.roofs(&[roof()], at(1)).closing);
        let closed = Guard { verified_closed: Some(true), ..guard_payload(3, 1) };
        words.observe(roof(), &boot_id, &closed, at(2));
        assert_eq!(words.roofs(&[roof()], at(2)), Roofs { waits: true, closing: false, closed: true });
        assert!(!words.roofs(&[roof()], at(60)).closed, "a guard that is silent proves nothing");
        assert!(words.roofs(&[roof()], at(60)).waits, "and its roof is still one that waits");
        let alongside = Guard { waits_for_mounts: Some(false), ..guard_payload(4, 1) };
        words.observe(roof(), &boot_id, &alongside, at(61));
        assert!(!words.roofs(&[roof()], at(61)).waits);
    }
}
