//! The holder of a telescope's lease, as its arbiter knows it: one incarnation of one process, and not each process of
//! that name.

use std::time::Duration;

use contract::BootId;
use units::MachineTime;

/// A holder that was silent for so long has lost its claim to the lease.
pub const SILENT: Duration = Duration::from_secs(5);

/// The holder of one lease.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Holding {
    holder: Option<Holder>,
    /// Messages with this token, or an older one, hold nothing any more: the incarnation that held it has released the
    /// lease.
    released_token: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Holder {
    name: String,
    /// Its incarnation, as it claimed or as its permits show.
    life: Option<BootId>,
    /// It claimed with its boot id, so that a claim in its name without one is another process's.
    claims_with_life: bool,
    heard: MachineTime,
}

/// A process that claims, or publishes as the holder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claimant<'a> {
    /// Such as `observatory/callisto/main`.
    pub name: &'a str,
    /// Its incarnation; nodes of versions in which a lease had no boot id do not send it when they claim.
    pub life: Option<&'a BootId>,
}

impl Holding {
    /// The name of another process that was received from, or was granted the lease, within the last 5 s.
    pub fn rival(&self, claimant: Claimant, now: MachineTime) -> Option<&str> {
        let holder = self.holder.as_ref()?;
        let is_alive = now.since(holder.heard) < SILENT;
        (is_alive && !holder.is(claimant)).then_some(holder.name.as_str())
    }

    /// The lease was granted.
    pub fn grant(&mut self, claimant: Claimant, now: MachineTime) {
        self.holder = Some(Holder {
            name: claimant.name.to_owned(),
            life: claimant.life.cloned(),
            claims_with_life: claimant.life.is_some(),
            heard: now,
        });
    }

    /// A process published with the newest token: it holds the lease, unless it has released it.
    pub fn hear(&mut self, name: &str, life: &BootId, token: u64, arrived: MachineTime) {
        if token <= self.released_token {
            return;
        }
        let speaker = Claimant { name, life: Some(life) };
        let known = self.holder.as_ref().filter(|holder| holder.is(speaker));
        let claims_with_life = known.is_some_and(|holder| holder.claims_with_life);
        self.holder =
            Some(Holder { name: name.to_owned(), life: Some(life.clone()), claims_with_life, heard: arrived });
    }

    /// The incarnation that holds the lease gives it up; from any other this has no effect.
    pub fn release(&mut self, life: &BootId, token: u64) {
        let is_other = |holder: &Holder| holder.life.as_ref().is_some_and(|held_by| held_by != life);
        if !self.holder.as_ref().is_some_and(is_other) {
            self.holder = None;
            self.released_token = self.released_token.max(token);
        }
    }
}

impl Holder {
    fn is(&self, claimant: Claimant) -> bool {
        self.name == claimant.name
            && match (&self.life, claimant.life) {
                (Some(held_by), Some(life)) => held_by == life,
                // An old node is known by its name, unless the holder is a newer one.
                (_, None) => !self.claims_with_life,
                // The holder claimed without a boot id, so this one is not it.
                (None, Some(_)) => false,
            }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(seconds))
    }

    const MAIN: &str = "observatory/alpha/main";

    fn of(life: &BootId) -> Claimant<'_> {
        Claimant { name: MAIN, life: Some(life) }
    }

    const OLD: Claimant<'static> = Claimant { name: MAIN, life: None };

    #[test]
    fn of_two_processes_of_one_name_the_second_waits_until_the_first_was_silent_for_five_seconds() {
        let (first, twin) = (BootId::fresh(), BootId::fresh());
        let mut lease = Holding::default();
        lease.grant(of(&first), at(100.0));
        assert_eq!(lease.rival(of(&twin), at(100.1)), Some(MAIN));
        assert_eq!(lease.rival(of(&first), at(100.1)), None, "the holder itself may claim again");
        lease.hear(MAIN, &first, 1, at(104.0));
        assert_eq!(lease.rival(of(&twin), at(108.9)), Some(MAIN), "each word of the first keeps it");
        assert_eq!(lease.rival(of(&twin), at(109.0)), None);
        lease.grant(of(&twin), at(109.0));
        assert_eq!(lease.rival(of(&first), at(109.1)), Some(MAIN), "and now it is the other way round");
    }

    #[test]
    fn a_released_lease_is_free_at_once_and_no_late_word_takes_it_back() {
        let (first, next) = (BootId::fresh(), BootId::fresh());
        let mut lease = Holding::default();
        lease.grant(of(&first), at(0.0));
        lease.hear(MAIN, &first, 7, at(1.0));
        lease.release(&next, 7);
        assert_eq!(lease.rival(of(&next), at(1.1)), Some(MAIN), "only the holder can release it");
        lease.release(&first, 7);
        assert_eq!(lease.rival(of(&next), at(1.1)), None);
        lease.hear(MAIN, &first, 7, at(1.2));
        assert_eq!(lease.rival(of(&next), at(1.3)), None, "a permit that was under way");
        lease.grant(of(&next), at(1.3));
        lease.hear(MAIN, &next, 8, at(2.0));
        lease.release(&first, 7);
        assert_eq!(lease.rival(of(&first), at(2.1)), Some(MAIN), "nor does a late release");
    }

    #[test]
    fn a_node_that_tells_no_life_is_known_by_its_name() {
        let life = BootId::fresh();
        let mut lease = Holding::default();
        lease.grant(OLD, at(0.0));
        assert_eq!(lease.rival(OLD, at(0.1)), None, "before its first word");
        lease.hear(MAIN, &life, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(1.1)), None, "and after it");
        let other = Claimant { name: "observatory/alpha/second", life: None };
        assert_eq!(lease.rival(other, at(1.1)), Some(MAIN));
        // The arbiter was restarted and knows the holder by its permits alone.
        let mut lease = Holding::default();
        lease.hear(MAIN, &life, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(1.1)), None);
        assert_eq!(lease.rival(of(&life), at(1.1)), None);
        assert_eq!(lease.rival(of(&BootId::fresh()), at(1.1)), Some(MAIN));
    }

    #[test]
    fn old_and_new_nodes_of_one_name_are_two() {
        let life = BootId::fresh();
        let mut lease = Holding::default();
        lease.grant(OLD, at(0.0));
        assert_eq!(lease.rival(of(&life), at(0.1)), Some(MAIN), "the holder would have told no life");
        let mut lease = Holding::default();
        lease.grant(of(&life), at(0.0));
        assert_eq!(lease.rival(OLD, at(0.1)), Some(MAIN), "the holder would have told its life");
        lease.hear(MAIN, &life, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(5.9)), Some(MAIN), "which its permits do not make forgotten");
        assert_eq!(lease.rival(OLD, at(6.0)), None);
    }
}
