//! Which of a key's payloads is the newest: by number within one incarnation of its sender, by arrival between
//! incarnations.
//!
//! Boot ids sort by the wall clock of their hosts, and a clock may be set back between two incarnations, so they decide
//! nothing here. A payload of an earlier incarnation may still arrive: the answer to a first query crosses the first
//! sample.

use std::collections::VecDeque;
use std::time::Duration;

use contract::BootId;
use units::MachineTime;

/// Earlier incarnations that are remembered.
const REMEMBERED: usize = 8;
/// An incarnation that another one followed counts again once the other is silent for so long: that one was a twin, and
/// left.
const SILENT: Duration = Duration::from_secs(2);

/// An incarnation that publishes on its own on a key does so at least each 15 s.
const GONE: Duration = Duration::from_secs(16);
/// Numbers of one incarnation that are so far apart are not of one count.
const LEAP: u64 = 1000;
/// A payload of one incarnation may arrive so much later than the first payloads of the next one.
const CROSSING: Duration = Duration::from_millis(500);

/// The newest payload on one key, and its incarnation.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Succession {
    newest: Option<(BootId, u64, MachineTime)>,
    /// The newest incarnation counts lower than it did, while its earlier count is silent.
    lower: Option<u64>,
    before: VecDeque<BootId>,
    incarnations: VecDeque<Incarnation>,
    rivals: Option<(BootId, BootId)>,
}

/// One incarnation, by its payloads on this key.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Incarnation {
    boot_id: BootId,
    high: Count,
    /// The count before its number leapt ahead; another process may have published the greater one in its name.
    low: Option<Count>,
}

/// Numbers that follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Count {
    seq: u64,
    first: MachineTime,
    last: MachineTime,
}

impl Count {
    fn follow(&mut self, seq: u64, arrived: MachineTime) {
        (self.seq, self.last) = (seq, self.last.max(arrived));
    }
}

impl Incarnation {
    fn new(boot_id: &BootId, seq: u64, arrived: MachineTime) -> Self {
        Self { boot_id: boot_id.clone(), high: Count { seq, first: arrived, last: arrived }, low: None }
    }

    /// Takes in a number; false if it is an old one.
    fn observe(&mut self, seq: u64, arrived: MachineTime) -> bool {
        if seq > self.high.seq {
            if seq - self.high.seq > 1 && self.low.is_none() {
                self.low = Some(self.high);
                self.high = Count { seq, first: arrived, last: arrived };
            } else {
                self.high.follow(seq, arrived);
            }
            return true;
        }
        let Some(low) = self.low.as_mut().filter(|low| seq > low.seq) else { return false };
        low.follow(seq, arrived);
        if arrived.since(self.high.last) >= SILENT {
            // The greater number was one alone.
            (self.high, self.low) = (*low, None);
        }
        true
    }

    /// It counts at two heights at once, far from each other: two publish in its name.
    fn is_two(&self) -> bool {
        self.low.is_some_and(|low| {
            let leapt = self.high.first.plus(CROSSING);
            self.high.seq - low.seq > LEAP && self.high.last > leapt && low.last > leapt
        })
    }

    fn first(&self) -> MachineTime {
        self.low.map_or(self.high.first, |low| low.first)
    }

    fn last(&self) -> MachineTime {
        self.low.map_or(self.high.last, |low| low.last.max(self.high.last))
    }
}

impl Succession {
    /// Takes in a payload; true if it is newer than all before.
    pub fn is_newer(&mut self, boot_id: &BootId, seq: u64, arrived: MachineTime) -> bool {
        self.note(boot_id, seq, arrived);
        if let Some((incarnation, last, at)) = &mut self.newest {
            if incarnation == boot_id {
                // A number far ahead, which another process may have published in its name, does not silence it for
                // good: two that follow each other count again. One alone may be an old one that came late.
                let goes_on = self.lower.is_some_and(|lower| seq > lower) && arrived.since(*at) >= SILENT;
                if seq <= *last && !goes_on {
                    let is_late = seq == *last || arrived.since(*at) < SILENT;
                    self.lower = if is_late { self.lower } else { Some(seq) };
                    return false;
                }
                self.lower = None;
                (*last, *at) = (seq, arrived);
                return true;
            }
            if self.before.contains(boot_id) && arrived.since(*at) < SILENT {
                return false;
            }
            let incarnation = incarnation.clone();
            self.before.retain(|known| known != boot_id);
            self.before.push_back(incarnation);
            if self.before.len() > REMEMBERED {
                self.before.pop_front();
            }
        }
        self.newest = Some((boot_id.clone(), seq, arrived));
        self.lower = None;
        true
    }

    /// The incarnation of the newest payload; `None` before the first.
    pub fn incarnation(&self) -> Option<&BootId> {
        self.newest.as_ref().map(|(boot_id, ..)| boot_id)
    }

    /// Two incarnations that publish at the same time: each has published something new after the other began, and both
    /// within the last 16 s. A restart is not such a case: an earlier incarnation publishes nothing new after the next
    /// one has begun. Twice the same incarnation means one that counts at two heights.
    pub fn rivals(&self, now: MachineTime) -> Option<(&BootId, &BootId)> {
        let (one, other) = self.rivals.as_ref()?;
        let publishes = |boot_id: &BootId| {
            self.incarnations
                .iter()
                .any(|incarnation| incarnation.boot_id == *boot_id && now.since(incarnation.last()) <= GONE)
        };
        (publishes(one) && publishes(other)).then_some((one, other))
    }

    fn note(&mut self, boot_id: &BootId, seq: u64, arrived: MachineTime) {
        let incarnation = match self.incarnations.iter_mut().find(|incarnation| incarnation.boot_id == *boot_id) {
            Some(incarnation) => {
                if !incarnation.observe(seq, arrived) {
                    return;
                }
                incarnation.clone()
            }
            None => {
                if self.incarnations.len() >= REMEMBERED {
                    self.incarnations.pop_front();
                }
                let incarnation = Incarnation::new(boot_id, seq, arrived);
                self.incarnations.push_back(incarnation.clone());
                incarnation
            }
        };
        let rival = |other: &&Incarnation| {
            let at_once =
                other.last() > incarnation.first().plus(CROSSING) && incarnation.last() > other.first().plus(CROSSING);
            other.boot_id != *boot_id && at_once && arrived.since(other.last()) <= GONE
        };
        if incarnation.is_two() {
            self.rivals = Some((boot_id.clone(), boot_id.clone()));
        } else if let Some(rival) = self.incarnations.iter().find(rival) {
            self.rivals = Some((rival.boot_id.clone(), boot_id.clone()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> MachineTime {
        MachineTime::from_boot(Duration::from_millis(millis))
    }

    #[test]
    fn a_new_incarnation_follows_the_old_one_whatever_their_clocks_show() {
        let (earlier, later) = (BootId::fresh(), BootId::fresh());
        for (first, second) in [(&earlier, &later), (&later, &earlier)] {
            let mut succession = Succession::default();
            assert!(succession.is_newer(first, 5, at(0)) && !succession.is_newer(first, 5, at(1)));
            assert!(succession.is_newer(second, 0, at(100)));
            assert!(!succession.is_newer(first, 6, at(200)), "crossed on its way");
            assert!(succession.is_newer(second, 1, at(300)));
        }
    }

    #[test]
    fn one_number_far_ahead_silences_nobody_for_good() {
        let boot_id = BootId::fresh();
        let mut succession = Succession::default();
        assert!(succession.is_newer(&boot_id, 5, at(0)));
        assert!(succession.is_newer(&boot_id, u64::MAX, at(100)), "somebody else says this in its name");
        let received: Vec<u64> =
            (6..12).filter(|seq| succession.is_newer(&boot_id, *seq, at(seq * 1000 - 5000))).collect();
        assert_eq!(received, [9, 10, 11], "2 s later it counts again, once it goes on");
        assert!(!succession.is_newer(&boot_id, 10, at(6100)), "and an old one that comes late is none");
        assert!(!succession.is_newer(&boot_id, 3, at(9000)) && succession.is_newer(&boot_id, 12, at(9100)));
    }

    #[test]
    fn a_twin_that_left_is_not_waited_for() {
        let (own, twin) = (BootId::fresh(), BootId::fresh());
        let mut succession = Succession::default();
        assert!(succession.is_newer(&own, 5, at(0)) && succession.is_newer(&twin, 0, at(100)));
        assert!(!succession.is_newer(&own, 6, at(1000)));
        assert!(succession.is_newer(&own, 8, at(2200)));
        assert!(!succession.is_newer(&twin, 1, at(2300)), "and the other way round");
    }

    #[test]
    fn one_forged_number_hides_no_second_writer_and_a_count_at_two_heights_is_one() {
        let (own, other) = (BootId::fresh(), BootId::fresh());
        for leap in [2, 500, u64::MAX - 20] {
            let mut succession = Succession::default();
            for second in 0..4 {
                succession.is_newer(&own, second, at(second * 1000));
            }
            succession.is_newer(&own, 3 + leap, at(3100));
            let mut rivals = Vec::new();
            for second in 4..12 {
                succession.is_newer(&own, second, at(second * 1000));
                if second >= 7 {
                    succession.is_newer(&other, second, at(second * 1000 + 300));
                }
                rivals.push(succession.rivals(at(second * 1000 + 300)).is_some());
            }
            assert_eq!(rivals, [false, false, false, false, true, true, true, true], "{leap}");
        }
        let mut succession = Succession::default();
        for second in 0..6 {
            succession.is_newer(&own, second, at(second * 1000));
            if second >= 2 {
                succession.is_newer(&own, 1 << (40 + second), at(second * 1000 + 100));
            }
        }
        assert!(succession.rivals(at(5200)).is_some(), "somebody speaks on in its name");
    }

    #[test]
    fn what_was_lost_and_comes_late_is_no_second_publisher() {
        let (own, mut succession) = (BootId::fresh(), Succession::default());
        succession.is_newer(&own, 5, at(0));
        for second in 3..9 {
            succession.is_newer(&own, 20 + second, at(second * 1000));
            succession.is_newer(&own, 3 + second, at(second * 1000 + 700));
        }
        assert!(succession.rivals(at(9000)).is_none());
    }

    #[test]
    fn a_restart_is_no_rival_and_who_goes_on_speaking_is_one() {
        let (one, other) = (BootId::fresh(), BootId::fresh());
        let mut succession = Succession::default();
        let mut observe = |boot_id: &BootId, seq, millis| {
            succession.is_newer(boot_id, seq, at(millis));
            succession.rivals(at(millis)).is_some()
        };
        assert!(!observe(&one, 1, 0) && !observe(&one, 2, 1000));
        assert!(!observe(&other, 0, 1800) && !observe(&one, 3, 2000), "crossed on its way");
        assert!(!observe(&other, 1, 2800) && !observe(&other, 2, 30_000), "restarted");
        assert!(!observe(&one, 3, 31_000), "an old payload that comes again is no new incarnation");
        assert!(observe(&one, 4, 31_000) && observe(&other, 3, 32_000), "it goes on speaking");
        assert!(observe(&other, 4, 47_000) && !observe(&other, 5, 47_500), "until it is gone");
    }
}
