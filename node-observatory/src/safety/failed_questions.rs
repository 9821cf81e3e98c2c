//! Questions to a device node that fail again and again: they are asked ever more seldom, and reported once.
//!
//! One count for a device, whoever publishes for it: of two nodes in a dispute each state ends a hole, as does each one
//! that is lost of a node without a record.

use std::time::Duration;

use bus::MachineTime;

/// The pause after the first failure of a run; after each further one it is twice as long.
const LEAST_PAUSE: Duration = Duration::from_secs(1);
/// No pause is longer.
const MOST_PAUSE: Duration = Duration::from_secs(60);

/// The failures since the last answer that was taken.
#[derive(Debug, Default)]
pub struct FailedQuestions {
    in_a_row: u32,
    asks_from: Option<MachineTime>,
}

impl FailedQuestions {
    /// The pause before the next question, seen from `now`.
    pub fn pause(&self, now: MachineTime) -> Duration {
        self.asks_from.map_or(Duration::ZERO, |from| from.since(now))
    }

    /// One has failed; true for the first of a run.
    pub fn fail(&mut self, now: MachineTime) -> bool {
        let factor = 2_u32.saturating_pow(self.in_a_row);
        self.asks_from = Some(now.plus(LEAST_PAUSE.saturating_mul(factor).min(MOST_PAUSE)));
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.in_a_row == 1
    }

    /// One was answered; gives how many had failed before.
    pub fn end(&mut self) -> u32 {
        std::mem::take(self).in_a_row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pauses_grow_to_a_minute_and_each_run_is_reported_once() {
        let at = |second| MachineTime::from_boot(Duration::from_secs(second));
        let mut failed = FailedQuestions::default();
        assert_eq!(failed.pause(at(100)), Duration::ZERO);
        let mut fail = |second| (failed.fail(at(second)), failed.pause(at(second)).as_secs());
        let run: Vec<_> = (0..8).map(|number| fail(100 + number)).collect();
        assert_eq!(run.iter().map(|(_, pause_s)| *pause_s).collect::<Vec<_>>(), [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(run.iter().filter(|(is_reported, _)| *is_reported).count(), 1);
        assert_eq!(failed.pause(at(147)), Duration::from_secs(20), "the pause runs since the last failure");
        assert_eq!(failed.pause(at(1000)), Duration::ZERO);
        assert_eq!((failed.end(), failed.end()), (8, 0));
        assert_eq!(failed.pause(at(108)), Duration::ZERO);
        assert!(failed.fail(at(200)), "another run");
    }
}
