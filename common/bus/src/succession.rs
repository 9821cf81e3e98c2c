//! Which of a key's payloads is the newest: by number within one life of its sender, by arrival from life to life.
//!
//! Boot ids sort by the wall clock of their hosts, and a clock may be put back between two lives, so they decide nothing
//! here. What an earlier life said may still arrive: the answer to a first question crosses the first sample.

use std::collections::VecDeque;
use std::time::Duration;

use contract::BootId;

use crate::MachineTime;

/// Earlier lives that are remembered.
const REMEMBERED: usize = 8;
/// A life that was followed by another speaks again once that one is silent for so long: it was a twin, and left.
const SILENT: Duration = Duration::from_secs(2);

/// A life that speaks on its own of a key does so at least each 15 s.
const GONE: Duration = Duration::from_secs(16);
/// What one life said may arrive so much later than the first words of the next one.
const CROSSING: Duration = Duration::from_millis(500);

/// What was said last on one key, and by which life.
#[derive(Debug, Clone, Default)]
pub struct Succession {
    newest: Option<(BootId, u64, MachineTime)>,
    /// The newest life counts lower than it did, while what it counted before is silent.
    lower: Option<u64>,
    before: VecDeque<BootId>,
    lives: VecDeque<Life>,
    rivals: Option<(BootId, BootId)>,
}

/// One life, by what it said on this key.
#[derive(Debug, Clone)]
struct Life {
    boot_id: BootId,
    seq: u64,
    first: MachineTime,
    last: MachineTime,
}

impl Succession {
    /// Takes in a payload; true if it is newer than all before.
    pub fn is_newer(&mut self, boot_id: &BootId, seq: u64, arrived: MachineTime) -> bool {
        self.note(boot_id, seq, arrived);
        if let Some((life, last, at)) = &mut self.newest {
            if life == boot_id {
                // a number far ahead, which somebody else may have said in its name, does not silence it for good: two that
                // follow each other count again. One alone may be an old one that came late.
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
            let life = life.clone();
            self.before.retain(|known| known != boot_id);
            self.before.push_back(life);
            if self.before.len() > REMEMBERED {
                self.before.pop_front();
            }
        }
        self.newest = Some((boot_id.clone(), seq, arrived));
        self.lower = None;
        true
    }

    /// Two lives that speak at the same time: each has said something new after the other began, and both within the
    /// last 16 s. A restart is none: an earlier life says nothing new after the next one has begun.
    pub fn rivals(&self, now: MachineTime) -> Option<(&BootId, &BootId)> {
        let (one, other) = self.rivals.as_ref()?;
        let lives =
            |boot_id: &BootId| self.lives.iter().any(|life| life.boot_id == *boot_id && now.since(life.last) <= GONE);
        (lives(one) && lives(other)).then_some((one, other))
    }

    fn note(&mut self, boot_id: &BootId, seq: u64, arrived: MachineTime) {
        let (first, last) = match self.lives.iter_mut().find(|life| life.boot_id == *boot_id) {
            Some(life) if seq <= life.seq => return,
            Some(life) => {
                (life.seq, life.last) = (seq, life.last.max(arrived));
                (life.first, life.last)
            }
            None => {
                if self.lives.len() >= REMEMBERED {
                    self.lives.pop_front();
                }
                self.lives.push_back(Life { boot_id: boot_id.clone(), seq, first: arrived, last: arrived });
                (arrived, arrived)
            }
        };
        let rival = |other: &&Life| {
            let at_once = other.last > first.plus(CROSSING) && last > other.first.plus(CROSSING);
            other.boot_id != *boot_id && at_once && arrived.since(other.last) <= GONE
        };
        if let Some(rival) = self.lives.iter().find(rival) {
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
    fn a_new_life_follows_the_old_one_whatever_their_clocks_say() {
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
        let life = BootId::fresh();
        let mut succession = Succession::default();
        assert!(succession.is_newer(&life, 5, at(0)));
        assert!(succession.is_newer(&life, u64::MAX, at(100)), "somebody else says this in its name");
        let heard: Vec<u64> = (6..12).filter(|seq| succession.is_newer(&life, *seq, at(seq * 1000 - 5000))).collect();
        assert_eq!(heard, [9, 10, 11], "2 s later it is heard again, once it goes on");
        assert!(!succession.is_newer(&life, 10, at(6100)), "and an old one that comes late is none");
        assert!(!succession.is_newer(&life, 3, at(9000)) && succession.is_newer(&life, 12, at(9100)));
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
    fn a_restart_is_no_rival_and_who_goes_on_speaking_is_one() {
        let (one, other) = (BootId::fresh(), BootId::fresh());
        let mut succession = Succession::default();
        let mut hear = |boot_id: &BootId, seq, millis| {
            succession.is_newer(boot_id, seq, at(millis));
            succession.rivals(at(millis)).is_some()
        };
        assert!(!hear(&one, 1, 0) && !hear(&one, 2, 1000));
        assert!(!hear(&other, 0, 1800) && !hear(&one, 3, 2000), "crossed on its way");
        assert!(!hear(&other, 1, 2800) && !hear(&other, 2, 30_000), "restarted");
        assert!(!hear(&one, 3, 31_000), "an old payload that comes again is no life");
        assert!(hear(&one, 4, 31_000) && hear(&other, 3, 32_000), "it goes on speaking");
        assert!(hear(&other, 4, 47_000) && !hear(&other, 5, 47_500), "until it is gone");
    }
}
