//! What the scenarios of restarts and holes have in common: a safety monitor, a weather station, and their rules.

use std::time::Duration;

use config::Response;
use contract::device::observing_conditions::Fields as Weather;
use contract::{Address, Datum, Device, Kind};
use units::{MachineTime, SkyTime, Utc};

use crate::history::Now;
use crate::measure::Measure;
use crate::rules::{Bounds, LimitRule, MonitorRule, Rules};
use crate::stored_history::Moment;

/// This second on a machine that has run for a day, with so many sky seconds in one of its own.
pub(crate) fn at(second: u64, speed: f64) -> Now {
    let since_boot = Duration::from_secs(86_400 + second);
    Now { sky: SkyTime::from_start(since_boot.mul_f64(speed)), machine: MachineTime::from_boot(since_boot) }
}

/// The same by all clocks.
pub(crate) fn moment(second: u64, speed: f64) -> Moment {
    Moment { boot: "a".to_owned(), now: at(second, speed), utc: utc(second as f64 * speed), speed }
}

/// So many seconds after 8 h UTC.
pub(crate) fn utc(second: f64) -> Utc {
    Utc::from_seconds(1.8e9 + second)
}

fn device(kind: Kind, name: &str) -> Device {
    Address::new("site", "scope").unwrap().device(kind, &name.parse().unwrap())
}

/// The safety monitor.
pub(crate) fn m() -> Device {
    device(Kind::SafetyMonitor, "m")
}

/// The weather station.
pub(crate) fn wx() -> Device {
    device(Kind::ObservingConditions, "wx")
}

/// The monitor with its allowed age, and limits on the wind of all kinds (15 s allowed), one of them on the largest wind
/// of a window; the dwell and the window are sky time.
pub(crate) fn rules(dwell_s: u64, monitor_max_age_s: u64, window_s: u64) -> Rules {
    let dwell = Duration::from_secs(dwell_s);
    let monitor = MonitorRule {
        input: "safetymonitor/m".to_owned(),
        device: m(),
        dwell,
        max_age: Duration::from_secs(monitor_max_age_s),
        by_period: false,
    };
    let limit = |measure: Measure, required: bool, vote: Option<&str>| LimitRule {
        input: format!("wx/WindSpeed {measure:?} {required}"),
        device: wx(),
        parameter: "WindSpeed".to_owned(),
        measure,
        bad: Bounds { upper: Some(12.0), lower: None },
        reopen: Bounds { upper: Some(10.0), lower: None },
        dwell,
        max_age: Duration::from_secs(15),
        by_period: false,
        required,
        response: Response::Close,
        vote: vote.map(str::to_owned),
    };
    let limits = vec![
        limit(Measure::Value, true, None),
        limit(Measure::Max(Duration::from_secs(window_s)), true, None),
        limit(Measure::Value, false, None),
        limit(Measure::Value, true, Some("wind")),
    ];
    Rules { monitors: vec![monitor], limits, frozen_after: Duration::from_secs(600), ..Rules::default() }
}

/// The air at this second: the pressure always moves.
pub(crate) fn air(second: u64, wind_mps: Datum<f64>) -> Weather {
    let pressure_hpa = Datum::Known(700.0 + second as f64 * 1e-3);
    Weather { wind_mps, pressure_hpa, ..Weather::default() }
}
