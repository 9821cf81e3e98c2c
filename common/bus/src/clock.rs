//! Sky time and machine time; the only place that reads either.

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Deserialize;
use units::Utc;

use crate::{MachineTime, SkyTime, machine};

/// Reads both times. Cheap to clone; all clones agree.
#[derive(Debug, Clone)]
pub struct Clock {
    source: Arc<Source>,
}

#[derive(Debug)]
enum Source {
    /// The machine's own clocks, at speed 1.
    Machine,
    /// A simulator's clock, as it was at one machine time.
    Simulated { origin: MachineTime, origin_utc: Utc, speed: f64 },
}

/// Why a simulator's clock could not be followed.
#[derive(Debug, thiserror::Error)]
pub enum ClockError {
    /// The simulator did not answer.
    #[error("the simulator's clock at {url} does not answer; is the simulator running?")]
    NoAnswer {
        /// What was asked.
        url: String,
        /// Why.
        #[source]
        source: reqwest::Error,
    },
    /// The answer is no clock.
    #[error("{url} answered no simulator clock: expected {{\"utc\", \"speed\", \"simulated\": true}}, got {got:?}")]
    NoClock {
        /// What was asked.
        url: String,
        /// What came.
        got: String,
    },
}

#[derive(Deserialize)]
struct Served {
    utc: Utc,
    speed: f64,
    simulated: bool,
}

impl Clock {
    /// The machine's own clock, at speed 1.
    pub fn machine_clock() -> Self {
        Self { source: Arc::new(Source::Machine) }
    }

    /// A clock that shows `utc` now and runs `speed` times as fast as the machine's.
    pub fn simulated(utc: Utc, speed: f64) -> Self {
        Self { source: Arc::new(Source::Simulated { origin: machine::now(), origin_utc: utc, speed }) }
    }

    /// Follows the clock that a Starmesh simulator serves at `base` (`http://host:port`).
    pub async fn of_simulator(base: &str) -> Result<Self, ClockError> {
        let url = format!("{base}/simulator/v1/clock");
        let asked = machine::now();
        let answer = async {
            let client = local_http::client_builder().timeout(Duration::from_secs(5)).build()?;
            client.get(&url).send().await?.error_for_status()?.text().await
        };
        let text = answer.await.map_err(|source| ClockError::NoAnswer { url: url.clone(), source })?;
        let half_way = machine::now().since(asked) / 2;
        match serde_json::from_str::<Served>(&text) {
            Ok(Served { utc, speed, simulated: true }) if speed.is_finite() && speed > 0.0 => Ok(Self {
                source: Arc::new(Source::Simulated { origin: asked.plus(half_way), origin_utc: utc, speed }),
            }),
            _ => Err(ClockError::NoClock { url, got: text.chars().take(200).collect() }),
        }
    }

    /// Machine time now.
    pub fn machine(&self) -> MachineTime {
        machine::now()
    }

    /// The monotonic side of sky time now.
    pub fn sky(&self) -> SkyTime {
        let machine = machine::now().since(MachineTime::from_boot(Duration::ZERO));
        SkyTime::from_start(machine.mul_f64(self.speed()))
    }

    /// Civil sky time now, for stamps, schedules and ephemerides.
    pub fn utc(&self) -> Utc {
        match *self.source {
            Source::Machine => {
                let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                Utc::EPOCH.plus(since_epoch)
            }
            Source::Simulated { origin, origin_utc, speed } => {
                origin_utc.plus(machine::now().since(origin).mul_f64(speed))
            }
        }
    }

    /// How many sky seconds pass in a machine second; 1 except in a simulation.
    pub fn speed(&self) -> f64 {
        match *self.source {
            Source::Machine => 1.0,
            Source::Simulated { speed, .. } => speed,
        }
    }

    /// True when sky time comes from a simulator.
    pub fn is_simulated(&self) -> bool {
        matches!(*self.source, Source::Simulated { .. })
    }

    /// Machine time that a sky duration takes.
    pub fn machine_duration(&self, sky: Duration) -> Duration {
        sky.div_f64(self.speed())
    }

    /// Waits for the next tick of a period, machine time.
    pub async fn tick(&self, period: Duration) {
        tokio::time::sleep(self.machine().to_tick(period)).await;
    }

    /// Waits for a duration of sky time.
    pub async fn sleep_sky(&self, sky: Duration) {
        tokio::time::sleep(self.machine_duration(sky)).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_clock_runs_fast_on_both_sides() {
        let start: Utc = "2026-11-21T03:00:00Z".parse().unwrap();
        let clock = Clock::simulated(start, 1000.0);
        let pause = || std::thread::sleep(Duration::from_millis(20));
        let (sky, utc) = (clock.sky(), clock.utc());
        pause();
        let (inner, outer) = (clock.utc().seconds_since(utc), clock.sky().since(sky).as_secs_f64());
        // However long it takes to look at both: what is looked at first and last passes more time.
        assert!((20.0..=outer + 1e-3).contains(&inner), "{inner} {outer}");
        let (utc, sky) = (clock.utc(), clock.sky());
        pause();
        let (inner, outer) = (clock.sky().since(sky).as_secs_f64(), clock.utc().seconds_since(utc));
        assert!((20.0..=outer + 1e-3).contains(&inner), "{inner} {outer}");
    }
}
