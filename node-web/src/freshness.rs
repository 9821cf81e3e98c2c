//! How old is too old: one rule for every payload that is published again regularly.

use std::time::Duration;

use contract::Key;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// How much a value is worth by its age.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// As expected.
    Fresh,
    /// Twice its period has passed (5 s at least): shown, but not to be relied on. A verdict counts as unknown.
    Stale,
    /// Five times its period has passed (15 s at least): the publisher is silent.
    Lost,
    /// Not received since this node started.
    Never,
}

/// A payload with a period of 1 s may be late on a busy machine; the page must not flicker then.
const STALE_AT_LEAST: Duration = Duration::from_secs(5);
const LOST_AT_LEAST: Duration = Duration::from_secs(15);

impl Quality {
    /// Judges an age against the period that was promised; a payload without a period never grows stale.
    pub fn of(age: Duration, period: Option<Duration>) -> Self {
        match period {
            Some(period) if age > (period * 5).max(LOST_AT_LEAST) => Self::Lost,
            Some(period) if age > (period * 2).max(STALE_AT_LEAST) => Self::Stale,
            Some(_) | None => Self::Fresh,
        }
    }
}

/// How often a key is published again at least; `None` for events.
pub fn period(key: &Key, body: &Value) -> Option<Duration> {
    let Key::State(_) = key else { return key.topic().row().rate.period() };
    let seconds = body["period_s"].as_f64().filter(|s| (0.001..3600.0).contains(s)).unwrap_or(5.0);
    Some(Duration::from_secs_f64(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(age_s: f64, period_s: f64) -> Quality {
        Quality::of(Duration::from_secs_f64(age_s), Some(Duration::from_secs_f64(period_s)))
    }

    #[test]
    fn a_value_grows_stale_after_two_periods_and_is_lost_after_five() {
        assert_eq!([of(19.9, 10.0), of(20.1, 10.0), of(50.1, 10.0)], [Quality::Fresh, Quality::Stale, Quality::Lost]);
    }

    #[test]
    fn a_fast_value_is_given_five_and_fifteen_seconds() {
        assert_eq!([of(4.9, 1.0), of(5.1, 1.0), of(14.9, 1.0)], [Quality::Fresh, Quality::Stale, Quality::Stale]);
        assert_eq!(of(15.1, 1.0), Quality::Lost);
    }

    #[test]
    fn a_device_names_its_own_period_and_an_event_has_none() {
        let key = Key::from_path("a/b/device/dome/d/state").unwrap();
        assert_eq!(period(&key, &serde_json::json!({"period_s": 2.0})), Some(Duration::from_secs(2)));
        assert_eq!(period(&key, &serde_json::json!({"period_s": -1.0})), Some(Duration::from_secs(5)));
        let event = Key::from_path("a/b/device/camera/c/frame").unwrap();
        assert_eq!(period(&event, &Value::Null), None);
        assert_eq!(Quality::of(Duration::from_secs(9999), None), Quality::Fresh);
    }
}
