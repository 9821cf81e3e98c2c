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

/// What was said last on one key, and by which life.
#[derive(Debug, Clone, Default)]
pub struct Succession {
    newest: Option<(BootId, u64, MachineTime)>,
    before: VecDeque<BootId>,
}

impl Succession {
    /// Takes in a payload; true if it is newer than all before.
    pub fn is_newer(&mut self, boot_id: &BootId, seq: u64, arrived: MachineTime) -> bool {
        if let Some((life, last, at)) = &mut self.newest {
            if life == boot_id {
                if seq <= *last {
                    return false;
                }
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
        true
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
    fn a_twin_that_left_is_not_waited_for() {
        let (own, twin) = (BootId::fresh(), BootId::fresh());
        let mut succession = Succession::default();
        assert!(succession.is_newer(&own, 5, at(0)) && succession.is_newer(&twin, 0, at(100)));
        assert!(!succession.is_newer(&own, 6, at(1000)));
        assert!(succession.is_newer(&own, 8, at(2200)));
        assert!(!succession.is_newer(&twin, 1, at(2300)), "and the other way round");
    }
}
