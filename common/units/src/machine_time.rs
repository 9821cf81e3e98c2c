//! The monotonic time of a machine; [`crate::SkyTime`] is another type, so that the two cannot be mixed.

use std::time::Duration;

/// Machine time: time since the machine booted, suspend included, never accelerated.
///
/// Permits, leases, ages, poll periods and deadlines are judged by it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MachineTime(Duration);

impl MachineTime {
    /// From the time since boot; for pure code and for whoever reads the clock.
    pub const fn from_boot(since_boot: Duration) -> Self {
        Self(since_boot)
    }

    /// Time from `earlier` to this; zero when `earlier` is later.
    pub fn since(self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }

    /// This moved forward.
    pub fn plus(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(duration))
    }

    /// This moved back, to the zero of the clock at most: what is older is as old as the clock.
    pub fn minus(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(duration))
    }

    /// Time left to the next whole multiple of a period since boot; what recurs shares these ticks, so that an idle
    /// machine wakes once for all of it.
    pub fn to_tick(self, period: Duration) -> Duration {
        let period = period.max(Duration::from_millis(1));
        let passed = self.0.as_nanos() % period.as_nanos();
        period.saturating_sub(Duration::from_nanos(u64::try_from(passed).unwrap_or(0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_recurs_shares_its_ticks() {
        let at = |ms| MachineTime::from_boot(Duration::from_millis(ms));
        let second = Duration::from_secs(1);
        assert_eq!(at(41_250).to_tick(second), Duration::from_millis(750));
        assert_eq!(at(41_000).to_tick(second), second, "on the tick, the next one");
        assert_eq!(at(41_250).to_tick(second * 5), Duration::from_millis(3_750));
        assert_eq!(at(5).to_tick(Duration::ZERO), Duration::from_millis(1), "never zero");
    }
}
