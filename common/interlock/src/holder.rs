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
    boot_id: Option<BootId>,
    /// It claimed with its boot id, so that a claim in its name without one is another process's.
    claims_with_boot_id: bool,
    received: MachineTime,
}

/// A process that claims, or publishes as the holder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claimant<'a> {
    /// Such as `observatory/callisto/main`.
    pub name: &'a str,
    /// Its incarnation; nodes of versions in which a lease had no boot id do not send it when they claim.
    pub boot_id: Option<&'a BootId>,
}

impl Holding {
    /// The name of another process that published, or was granted the lease, within the last 5 s.
    pub fn rival(&self, claimant: Claimant, now: MachineTime) -> Option<&str> {
        let holder = self.holder.as_ref()?;
        let is_alive = now.since(holder.received) < SILENT;
        (is_alive && !holder.is(claimant)).then_some(holder.name.as_str())
    }

    /// The lease was granted.
    pub fn grant(&mut self, claimant: Claimant, now: MachineTime) {
        self.holder = Some(Holder {
            name: claimant.name.to_owned(),
            boot_id: claimant.boot_id.cloned(),
            claims_with_boot_id: claimant.boot_id.is_some(),
            received: now,
        });
    }

    /// A process published with the newest token: it holds the lease, unless it has released it.
    pub fn observe(&mut self, name: &str, boot_id: &BootId, token: u64, arrived: MachineTime) {
        if token <= self.released_token {
            return;
        }
        let speaker = Claimant { name, boot_id: Some(boot_id) };
        let known = self.holder.as_ref().filter(|holder| holder.is(speaker));
        let claims_with_boot_id = known.is_some_and(|holder| holder.claims_with_boot_id);
        self.holder = Some(Holder {
            name: name.to_owned(),
            boot_id: Some(boot_id.clone()),
            claims_with_boot_id,
            received: arrived,
        });
    }

    /// The incarnation that holds the lease gives it up; from any other this has no effect.
    pub fn release(&mut self, boot_id: &BootId, token: u64) {
        let is_other = |holder: &Holder| holder.boot_id.as_ref().is_some_and(|held_by| held_by != boot_id);
        if !self.holder.as_ref().is_some_and(is_other) {
            self.holder = None;
            self.released_token = self.released_token.max(token);
        }
    }
}

impl Holder {
    fn is(&self, claimant: Claimant) -> bool {
        self.name == claimant.name
            && match (&self.boot_id, claimant.boot_id) {
                (Some(held_by), Some(boot_id)) => held_by == boot_id,
                // An old node is known by its name, unless the holder is a newer one.
                (_, None) => !self.claims_with_boot_id,
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

    fn of(boot_id: &BootId) -> Claimant<'_> {
        Claimant { name: MAIN, boot_id: Some(boot_id) }
    }

    const OLD: Claimant<'static> = Claimant { name: MAIN, boot_id: None };

    #[test]
    fn of_two_processes_of_one_name_the_second_waits_until_the_first_was_silent_for_five_seconds() {
        let (first, twin) = (BootId::fresh(), BootId::fresh());
        let mut lease = Holding::default();
        lease.grant(of(&first), at(100.0));
        assert_eq!(lease.rival(of(&twin), at(100.1)), Some(MAIN));
        assert_eq!(lease.rival(of(&first), at(100.1)), None, "the holder itself may claim again");
        lease.observe(MAIN, &first, 1, at(104.0));
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
        lease.observe(MAIN, &first, 7, at(1.0));
        lease.release(&next, 7);
        assert_eq!(lease.rival(of(&next), at(1.1)), Some(MAIN), "only the holder can release it");
        lease.release(&first, 7);
        assert_eq!(lease.rival(of(&next), at(1.1)), None);
        lease.observe(MAIN, &first, 7, at(1.2));
        assert_eq!(lease.rival(of(&next), at(1.3)), None, "a permit that was under way");
        lease.grant(of(&next), at(1.3));
        lease.observe(MAIN, &next, 8, at(2.0));
        lease.release(&first, 7);
        assert_eq!(lease.rival(of(&first), at(2.1)), Some(MAIN), "nor does a late release");
    }

    #[test]
    fn a_node_that_sends_no_boot_id_is_known_by_its_name() {
        let boot_id = BootId::fresh();
        let mut lease = Holding::default();
        lease.grant(OLD, at(0.0));
        assert_eq!(lease.rival(OLD, at(0.1)), None, "before its first word");
        lease.observe(MAIN, &boot_id, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(1.1)), None, "and after it");
        let other = Claimant { name: "observatory/alpha/second", boot_id: None };
        assert_eq!(lease.rival(other, at(1.1)), Some(MAIN));
        // The arbiter was restarted and knows the holder by its permits alone.
        let mut lease = Holding::default();
        lease.observe(MAIN, &boot_id, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(1.1)), None);
        assert_eq!(lease.rival(of(&boot_id), at(1.1)), None);
        assert_eq!(lease.rival(of(&BootId::fresh()), at(1.1)), Some(MAIN));
    }

    #[test]
    fn old_and_new_nodes_of_one_name_are_two() {
        let boot_id = BootId::fresh();
        let mut lease = Holding::default();
        lease.grant(OLD, at(0.0));
        assert_eq!(lease.rival(of(&boot_id), at(0.1)), Some(MAIN), "the holder would have sent no boot id");
        let mut lease = Holding::default();
        lease.grant(of(&boot_id), at(0.0));
        assert_eq!(lease.rival(OLD, at(0.1)), Some(MAIN), "the holder would have sent its boot id");
        lease.observe(MAIN, &boot_id, 1, at(1.0));
        assert_eq!(lease.rival(OLD, at(5.9)), Some(MAIN), "which its permits do not make forgotten");
        assert_eq!(lease.rival(OLD, at(6.0)), None);
    }
}
