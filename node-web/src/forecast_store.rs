//! The newest forecast of each telescope's schedule, for all who look at it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::MachineTime;
use bytes::Bytes;
use contract::Address;

use crate::problem::Problem;

/// A forecast of the same schedule is made again after this sky time ...
const AGAIN: Duration = Duration::from_secs(180);
/// ... and not sooner than this, however fast the sky goes.
const SOONEST_AGAIN: Duration = Duration::from_secs(15);
/// What could not be made is tried again after this, for whoever asks then.
const FAILED_AGAIN: Duration = Duration::from_secs(10);

/// The newest forecast of each telescope; each is made by one who asks while the others wait.
#[derive(Debug, Default)]
pub struct Forecasts(Mutex<BTreeMap<Address, Slot>>);

/// The place of one telescope's forecast; whoever makes it holds the place meanwhile.
pub type Slot = Arc<tokio::sync::Mutex<Option<MadeForecast>>>;

/// A forecast, or why there is none.
#[derive(Debug)]
pub struct MadeForecast {
    /// When the work was done.
    pub at: MachineTime,
    /// Hash of the schedule that was in force, as its state said; absent where it said none.
    pub of: Option<String>,
    /// Its tag, and the answer.
    pub outcome: Result<(String, Bytes), Problem>,
}

impl MadeForecast {
    /// May it be answered now, under a sky of this speed and with this schedule in force?
    pub fn is_good(&self, now: MachineTime, speed: f64, in_force: Option<&str>) -> bool {
        let good = AGAIN.div_f64(speed.clamp(1.0, AGAIN.as_secs_f64() / SOONEST_AGAIN.as_secs_f64()));
        let again = if self.outcome.is_ok() { good } else { FAILED_AGAIN };
        self.of.as_deref() == in_force && now.since(self.at) < again
    }
}

impl Forecasts {
    /// The place of a telescope's forecast.
    pub fn slot(&self, address: &Address) -> Slot {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(address.clone()).or_default().clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_forecast_is_good_for_three_minutes_of_the_sky_and_a_failure_for_ten_seconds() {
        let at = MachineTime::from_boot(Duration::from_secs(1000));
        let made = |outcome| MadeForecast { at, of: Some("a".to_owned()), outcome };
        let after = |seconds| at.plus(Duration::from_secs(seconds));
        let whole = made(Ok(("tag".to_owned(), Bytes::new())));
        assert!(whole.is_good(after(179), 1.0, Some("a")) && !whole.is_good(after(181), 1.0, Some("a")));
        assert!(whole.is_good(after(14), 300.0, Some("a")) && !whole.is_good(after(16), 300.0, Some("a")));
        assert!(!whole.is_good(at, 1.0, Some("b")) && !whole.is_good(at, 1.0, None));
        let failed = made(Err(Problem::not_found("none")));
        assert!(failed.is_good(after(9), 1.0, Some("a")) && !failed.is_good(after(11), 1.0, Some("a")));
    }
}
