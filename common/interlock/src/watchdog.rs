//! When the dome's own watchdog is fed: while the permit lives, and never when it does not.

use std::time::Duration;

use units::MachineTime;

/// Feedings within the watchdog's time limit, so that a few may be lost.
const PER_LIMIT: f64 = 4.0;

/// The feedings of one watchdog.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Watchdog {
    /// None where the dome has no watchdog.
    period: Option<Duration>,
    last: Option<MachineTime>,
}

impl Watchdog {
    /// Of a watchdog that closes the dome when it was not fed for this time; none where the dome has none.
    pub fn new(limit_s: Option<f64>) -> Self {
        let period = limit_s.map(|limit_s| Duration::from_secs_f64((limit_s / PER_LIMIT).clamp(0.5, 900.0)));
        Self { period, last: None }
    }

    /// Is a feeding due? `is_alive` says that the permit is valid and safe in this very beat.
    pub fn is_due(&mut self, is_alive: bool, now: MachineTime) -> bool {
        let Some(period) = self.period.filter(|_| is_alive) else { return false };
        let is_due = self.last.is_none_or(|last| now.since(last) >= period);
        if is_due {
            self.last = Some(now);
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_fed_four_times_in_its_limit_and_only_while_the_permit_is_valid() {
        let at = |s| MachineTime::from_boot(Duration::from_secs(s));
        let mut dog = Watchdog::new(Some(120.0));
        let fed: Vec<u64> = (0..=120).filter(|second| dog.is_due(true, at(*second))).collect();
        assert_eq!(fed, [0, 30, 60, 90, 120]);
        assert!((121..400).all(|second| !dog.is_due(false, at(second))), "starved");
        assert!(dog.is_due(true, at(400)));
        assert!(!Watchdog::new(None).is_due(true, at(0)), "there is none");
    }
}
