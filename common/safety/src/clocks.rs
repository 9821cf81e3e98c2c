//! The times that it may be: this node's wall clock compared with its boot-time clock, the other nodes' stamps and the
//! mounts' clocks.
//!
//! The Sun, and the end of what a person ordered, follow the wall clock, and a step of an hour as the Sun rises leaves
//! a dome open. Nobody here decides which clock is right: while they disagree, each of them may be, and what is the
//! worst of them counts.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use units::{MachineTime, Utc};

use super::nodes::Witness;

/// Clocks that differ by no more agree: the Sun moves an eighth of a degree meanwhile.
pub const AGREE_S: f64 = 30.0;
/// A mount whose clock is farther off has no clock; an alert reports that, and the Sun is not computed for it.
const NO_CLOCK_S: f64 = 12.0 * 3600.0;
/// When clocks of other machines have agreed with the wall clock for so long, it was set right.
const SET_RIGHT: Duration = Duration::from_secs(60);

/// A possible time other than the wall clock's.
#[derive(Debug, Clone, PartialEq)]
pub struct Doubt {
    /// Whose time.
    pub clock: String,
    /// Its time minus the wall clock's, s.
    pub offset_s: f64,
    /// It counts for the Sun and for expiries; else it is only reported.
    pub counts: bool,
}

impl std::fmt::Display for Doubt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} is {:+.0} s off this node's wall clock", self.clock, self.offset_s)
    }
}

/// The wall clock at one moment of the boot-time clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Which boot of the machine, as its kernel names it.
    boot: String,
    utc: Utc,
    /// Boot-time clock, s.
    machine_s: f64,
}

/// The clocks, watched.
#[derive(Debug)]
pub struct Clocks {
    speed: f64,
    anchor: Anchor,
    right_since: Option<MachineTime>,
    /// The anchor is a new one, which was not persisted yet.
    is_new: bool,
}

impl Clocks {
    /// Begins to watch. `boot` is which boot of the machine this is, empty where nobody knows; `stored` is the anchor
    /// that was persisted before, so that a restart of the node does not forget a step.
    pub fn new(stored: Option<Anchor>, boot: String, speed: f64, utc: Utc, now: MachineTime) -> Self {
        let fresh = Anchor { boot, utc, machine_s: seconds(now) };
        // It means nothing for another boot of the machine.
        let stored = stored.filter(|stored| {
            !stored.boot.is_empty() && stored.boot == fresh.boot && stored.machine_s <= fresh.machine_s
        });
        let is_new = stored.is_none();
        Self { speed, anchor: stored.unwrap_or(fresh), right_since: None, is_new }
    }

    /// The anchor, where it is to be persisted now: it is new, and was not taken by this before.
    pub fn to_persist(&mut self) -> Option<Anchor> {
        std::mem::take(&mut self.is_new).then(|| self.anchor.clone())
    }

    /// By how much the wall clock would be ahead, had it only run since it was first seen, s.
    fn own_s(&self, utc: Utc, now: MachineTime) -> f64 {
        let ran_s = (seconds(now) - self.anchor.machine_s) * self.speed;
        self.anchor.utc.plus_seconds(ran_s).seconds_since(utc)
    }

    /// The clocks that disagree with the wall clock now.
    pub fn doubts(&mut self, utc: Utc, now: MachineTime, witnesses: &[Witness]) -> Vec<Doubt> {
        let own_s = self.own_s(utc, now);
        let agrees = |witness: &Witness| witness.offset_s.abs() <= AGREE_S;
        let others: Vec<&Witness> = witnesses.iter().filter(|witness| witness.of_other_machine).collect();
        // A wall clock that others confirm was set right, and the time before was wrong.
        if own_s.abs() > AGREE_S && !others.is_empty() && others.iter().all(|witness| agrees(witness)) {
            let since = *self.right_since.get_or_insert(now);
            if now.since(since) >= SET_RIGHT {
                tracing::info!(step_s = -own_s, "the wall clock was set right, as the other clocks confirm");
                (self.anchor.utc, self.anchor.machine_s, self.right_since) = (utc, seconds(now), None);
                self.is_new = true;
            }
        } else {
            self.right_since = None;
        }
        let own_s = self.own_s(utc, now);
        let own = Doubt { clock: "this machine's boot-time clock".to_owned(), offset_s: own_s, counts: true };
        let doubts = witnesses.iter().filter(|witness| !agrees(witness)).map(|witness| Doubt {
            clock: witness.clock.clone(),
            offset_s: witness.offset_s,
            counts: witness.offset_s.abs() <= NO_CLOCK_S || !witness.is_mount,
        });
        (own_s.abs() > AGREE_S).then_some(own).into_iter().chain(doubts).collect()
    }
}

fn seconds(at: MachineTime) -> f64 {
    at.since(MachineTime::from_boot(Duration::ZERO)).as_secs_f64()
}

/// The earliest and the latest time that it may be.
pub fn between(utc: Utc, doubts: &[Doubt]) -> (Utc, Utc) {
    let offsets = doubts.iter().filter(|doubt| doubt.counts).map(|doubt| doubt.offset_s);
    let (early_s, late_s) = offsets.fold((0.0_f64, 0.0_f64), |(low, high), s| (low.min(s), high.max(s)));
    (utc.plus_seconds(early_s), utc.plus_seconds(late_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: f64) -> MachineTime {
        MachineTime::from_boot(Duration::from_secs_f64(second))
    }

    fn utc(second: f64) -> Utc {
        Utc::from_seconds(1.8e9 + second)
    }

    fn witness(clock: &str, offset_s: f64, of_other_machine: bool) -> Witness {
        Witness { clock: clock.to_owned(), offset_s, of_other_machine, is_mount: clock.starts_with("mount") }
    }

    fn offsets(doubts: &[Doubt]) -> Vec<i64> {
        doubts.iter().map(|doubt| doubt.offset_s.round() as i64).collect()
    }

    #[test]
    fn a_step_of_the_wall_clock_is_seen_and_both_times_may_be_right() {
        let mut clocks = Clocks::new(None, String::new(), 1.0, utc(0.0), at(100.0));
        assert!(clocks.doubts(utc(3600.0), at(3700.0), &[]).is_empty());
        // An hour back, as the Sun rises.
        let doubts = clocks.doubts(utc(1.0), at(3701.0), &[]);
        assert_eq!(offsets(&doubts), [3600]);
        assert_eq!(between(utc(1.0), &doubts), (utc(1.0), utc(3601.0)));
        assert!(doubts[0].to_string().contains("boot-time clock is +3600 s off"), "{}", doubts[0]);
        // An hour ahead: an override that would have ended has not, and an active one may have ended.
        assert_eq!(between(utc(7202.0), &clocks.doubts(utc(7202.0), at(3702.0), &[])), (utc(3602.0), utc(7202.0)));
    }

    #[test]
    fn a_clock_that_was_set_right_is_believed_when_other_machines_confirm_it() {
        let mut clocks = Clocks::new(None, String::new(), 1.0, utc(0.0), at(0.0));
        let doubts = |clocks: &mut Clocks, second: f64, witnesses: &[Witness]| {
            offsets(&clocks.doubts(utc(second + 500.0), at(second), witnesses))
        };
        let (same_host, other) = (witness("node/a", 0.1, false), witness("mount m", -3.0, true));
        assert_eq!(doubts(&mut clocks, 10.0, std::slice::from_ref(&same_host)), [-500]);
        assert_eq!(doubts(&mut clocks, 100.0, &[same_host]), [-500], "it has the same wall clock");
        assert_eq!(doubts(&mut clocks, 110.0, std::slice::from_ref(&other)), [-500]);
        assert_eq!(doubts(&mut clocks, 171.0, std::slice::from_ref(&other)), [0_i64; 0]);
        assert_eq!(doubts(&mut clocks, 172.0, &[witness("node/b", 40.0, true), other]), [40]);
    }

    #[test]
    fn a_mount_that_has_no_clock_is_reported_and_does_not_count() {
        let mut clocks = Clocks::new(None, String::new(), 1.0, utc(0.0), at(0.0));
        let doubts =
            clocks.doubts(utc(1.0), at(1.0), &[witness("mount m", -9e8, true), witness("mount n", 5000.0, true)]);
        assert_eq!(doubts.iter().map(|doubt| doubt.counts).collect::<Vec<_>>(), [false, true]);
        assert_eq!(between(utc(1.0), &doubts), (utc(1.0), utc(5001.0)));
    }

    #[test]
    fn a_restart_of_the_node_does_not_forget_a_step_and_a_boot_of_the_machine_does() {
        let watched = |boot: &str, stored, second: f64, step_s: f64| {
            Clocks::new(stored, boot.to_owned(), 1.0, utc(second + step_s), at(second))
        };
        let stored = watched("b", None, 0.0, 0.0).to_persist();
        let doubts = |mut clocks: Clocks| {
            let is_new = clocks.to_persist().is_some();
            (offsets(&clocks.doubts(utc(101.0 - 3600.0), at(101.0), &[])), is_new)
        };
        assert!(stored.is_some());
        assert_eq!(doubts(watched("b", stored.clone(), 100.0, -3600.0)), (vec![3600], false));
        assert_eq!(doubts(watched("c", stored.clone(), 100.0, -3600.0)), (vec![], true));
        assert_eq!(doubts(watched("", stored, 100.0, -3600.0)), (vec![], true), "which boot this is is not known");
    }

    #[test]
    fn a_clock_that_was_set_right_is_persisted_once() {
        let mut clocks = Clocks::new(None, "b".to_owned(), 1.0, utc(0.0), at(0.0));
        assert!(clocks.to_persist().is_some() && clocks.to_persist().is_none());
        let other = [witness("mount m", 0.0, true)];
        clocks.doubts(utc(510.0), at(10.0), &other);
        assert_eq!(clocks.to_persist(), None);
        clocks.doubts(utc(571.0), at(71.0), &other);
        assert!(clocks.to_persist().is_some_and(|anchor| anchor.utc == utc(571.0)) && clocks.to_persist().is_none());
    }
}
