//! Sky time: a start in UTC, and machine time since then, multiplied.

use std::time::{Duration, Instant, SystemTime};

use units::Utc;

/// The world's clock: `start + elapsed machine time x speed`.
#[derive(Debug, Clone, Copy)]
pub struct SkyClock {
    start: Utc,
    origin: Instant,
    speed: f64,
    stands: bool,
}

impl SkyClock {
    /// A clock that shows `start` now and runs at `speed` (1 is real time).
    pub fn at(start: Utc, speed: f64) -> Self {
        Self { start, origin: Instant::now(), speed, stands: false }
    }

    /// A clock that stands at `start` until it is started.
    pub fn stopped(start: Utc, speed: f64) -> Self {
        Self { stands: true, ..Self::at(start, speed) }
    }

    /// Starts a clock that stands.
    pub fn run(&mut self) {
        if std::mem::take(&mut self.stands) {
            self.origin = Instant::now();
        }
    }

    /// Stands from now on until it is started.
    pub fn stop(&mut self) {
        (self.start, self.stands) = (self.now(), true);
    }

    /// Moves a clock that stands on by so many sky seconds.
    pub fn pass(&mut self, sky_s: f64) {
        if self.stands {
            self.start = self.start.plus_seconds(sky_s);
        }
    }

    /// Sky time now.
    pub fn now(&self) -> Utc {
        if self.stands {
            return self.start;
        }
        self.start.plus_seconds(self.origin.elapsed().as_secs_f64() * self.speed)
    }

    /// Sky seconds per machine second.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Machine time since the clock began.
    pub fn machine(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Machine time that an interval of sky time takes.
    pub fn machine_for(&self, sky_s: f64) -> Duration {
        Duration::try_from_secs_f64(sky_s / self.speed).unwrap_or_default()
    }
}

/// The host's wall clock.
pub fn wall_clock() -> Utc {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    Utc::from_micros(i64::try_from(since.as_micros()).unwrap_or(0))
}
