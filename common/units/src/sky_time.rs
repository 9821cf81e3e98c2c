//! The monotonic time of the sky, which a simulator may accelerate.

use std::time::Duration;

/// The monotonic side of sky time: machine time x speed. Dwell, exposure and slew durations are judged by it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SkyTime(Duration);

impl SkyTime {
    /// From a duration since an arbitrary start; for pure code under test.
    pub const fn from_start(since_start: Duration) -> Self {
        Self(since_start)
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
}
