//! What a published state says of one input: a value, why there is none, or nothing at all.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::device::observing_conditions::{Fields as Weather, made_of};
use contract::device::safety_monitor::Fields as Monitor;
use contract::{Datum, DeviceState, Link, NoData};
use serde::{Deserialize, Serialize};
use units::{MachineTime, seconds};

use super::contradiction::Contradiction;
use super::history::Now;

/// The received state of a safety monitor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MonitorReading {
    /// Its `IsSafe`.
    pub is_safe: bool,
    /// Length of the gapless safe record that its device node vouches for, sky time.
    pub gapless_safe: Duration,
}

/// What a limit was put on, at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The value of the measure.
    pub value: f64,
    /// It is bad, or it was and is not good enough yet, or nobody knows whether it was.
    pub tripped: bool,
    /// The time after which all of its window is known, sky time.
    pub unknown_for: Duration,
    /// Values of the station excluded each other, so that none of them is good; what was written before a restart only
    /// says that it was not good.
    #[serde(skip)]
    pub contradiction: Option<Contradiction>,
}

/// A state of which no more is known than verdicts need.
pub fn state<F>(link: Link, fields: F) -> DeviceState<F> {
    DeviceState {
        link,
        busy: false,
        period_s: 0.0,
        poll_s: None,
        last_command: None,
        fields,
        readings: BTreeMap::new(),
    }
}

/// Nothing older is a reading; machine time.
const OLDEST: Duration = Duration::from_secs(10 * 86_400);

/// When a reading was made that was so old at that moment: not when it was published. Before this machine was started
/// there is no such time.
pub(crate) fn aged(at: Now, age_s: Option<f64>, speed: f64) -> Result<Now, String> {
    let Some(age_s) = age_s else { return Ok(at) };
    let age = Duration::try_from_secs_f64(age_s).ok().filter(|age| *age <= OLDEST);
    let age = age.ok_or_else(|| format!("its age is given as {age_s} s"))?;
    if age > at.machine.since(MachineTime::from_boot(Duration::ZERO)) {
        return Err(format!("read {age_s:.0} s before, when this machine was not started yet"));
    }
    Ok(Now { machine: at.machine.minus(age), sky: at.sky.minus(age.mul_f64(speed)) })
}

/// The age of the oldest reading that something is made of; one that is none decides for all.
pub(crate) fn oldest_s<'a>(
    ages_s: &BTreeMap<String, f64>,
    properties: impl IntoIterator<Item = &'a str>,
) -> Option<f64> {
    let ages = properties.into_iter().filter_map(|name| ages_s.get(name).copied());
    ages.reduce(|a, b| if a.is_nan() || b.is_nan() || a < 0.0 || b < 0.0 { f64::NAN } else { a.max(b) })
}

pub(crate) fn connected<F>(state: &DeviceState<F>) -> Result<(), String> {
    match &state.link {
        Link::Connected => Ok(()),
        Link::Connecting => Err("not connected yet".to_owned()),
        Link::Lost { reason } => Err(format!("link lost: {reason}")),
    }
}

/// Why the device has answered nothing since the state before, if so. A node that has just been started, and a server
/// that refuses connections while it is restarted, report nothing about the sky.
pub(crate) fn no_answer<F>(state: &DeviceState<F>) -> Option<String> {
    let answered_nothing = match &state.link {
        Link::Connected => false,
        Link::Connecting => true,
        Link::Lost { reason } => reason.is_silence(),
    };
    connected(state).err().filter(|_| answered_nothing)
}

/// The same of a single value.
pub(crate) fn silence(missing: Option<&NoData>) -> Option<String> {
    missing.filter(|reason| reason.is_silence()).map(ToString::to_string)
}

/// The same of a parameter: a part of it is silent, and no other part is bad.
pub(crate) fn silent_parameter(fields: &Weather, parameter: &str) -> Option<String> {
    let mut silent = None;
    for name in made_of(parameter) {
        match silence(fields.by_ascom_name(name).and_then(|datum| datum.as_result().err())) {
            Some(why) if name == parameter => silent = Some(why),
            Some(why) => silent = Some(format!("{name}: {why}")),
            None => drop(fields.measured(name).ok()?),
        }
    }
    silent
}

pub(crate) fn monitor_reading(state: &DeviceState<Monitor>) -> Result<MonitorReading, String> {
    connected(state)?;
    let is_safe = *state.fields.is_safe.as_result().map_err(ToString::to_string)?;
    Ok(MonitorReading { is_safe, gapless_safe: seconds(state.fields.gapless_safe_s) })
}

/// The value of a parameter in a station's state, or why there is none; `sent_s` is how long ago the station published
/// how old its own measurement is.
pub(crate) fn parameter(
    state: &DeviceState<Weather>,
    name: &str,
    max_age: Duration,
    speed: f64,
    sent_s: f64,
) -> Result<f64, String> {
    connected(state)?;
    measured_lately(&state.fields.sensor_age_s, "its own measurement", sent_s, max_age, speed)?;
    for sensor in made_of(name) {
        if let Some(age_s) = state.fields.sensor_ages_s.get(sensor) {
            // The sensor may have measured since it was asked, so that the time since then counts for nothing.
            measured_lately(age_s, &format!("{sensor}'s measurement"), 0.0, max_age, speed)?;
        }
    }
    state.fields.measured(name)
}

/// Refuses a measurement that the station calls old; `sent_s` is the age of that statement, s of machine time.
fn measured_lately(age_s: &Datum<f64>, what: &str, sent_s: f64, max_age: Duration, speed: f64) -> Result<(), String> {
    let age_s = match age_s {
        Datum::Known(age_s) => *age_s,
        // An answer, and no age; without an answer there is nothing to check.
        Datum::Missing { no_data } if no_data.is_no_number() => {
            return Err(format!("the station's word for the age of {what} is no age: {no_data}"));
        }
        Datum::Missing { .. } => return Ok(()),
    };
    // ASCOM's value for "nothing was ever measured"; its other values are then no measurements.
    if age_s < 0.0 {
        return Err(format!("never measured: the station says that {what} is {age_s} s old"));
    }
    let age_s = age_s / speed + sent_s;
    if age_s.is_nan() || age_s > max_age.as_secs_f64() {
        return Err(format!("stale: the station says that {what} is {age_s:.0} s old"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use units::SkyTime;

    use super::*;

    fn weather(fields: Weather) -> DeviceState<Weather> {
        state(Link::Connected, fields)
    }

    const MAX_AGE: Duration = Duration::from_secs(60);

    #[test]
    fn derived_parameters_need_both_of_their_values() {
        let both = weather(Weather { sky_c: Datum::Known(-20.0), air_c: Datum::Known(5.0), ..Default::default() });
        assert_eq!(parameter(&both, "RelativeSkyTemp", MAX_AGE, 1.0, 0.0), Ok(-25.0));
        assert_eq!(parameter(&both, "DewPointMargin", MAX_AGE, 1.0, 0.0).unwrap_err(), "DewPoint: never read");
    }

    #[test]
    fn a_station_whose_own_measurement_is_old_has_no_value() {
        let fields = |age_s| Weather {
            humidity_percent: Datum::Known(50.0),
            sensor_age_s: Datum::Known(age_s),
            ..Default::default()
        };
        assert_eq!(parameter(&weather(fields(59.0)), "Humidity", MAX_AGE, 1.0, 0.0), Ok(50.0));
        assert!(parameter(&weather(fields(61.0)), "Humidity", MAX_AGE, 1.0, 0.0).is_err());
        assert!(parameter(&weather(fields(f64::NAN)), "Humidity", MAX_AGE, 1.0, 0.0).is_err());
        let never = parameter(&weather(fields(-1.0)), "Humidity", MAX_AGE, 1.0, 0.0);
        assert_eq!(never.unwrap_err(), "never measured: the station says that its own measurement is -1 s old");
        // At 100 x speed a sky minute is 0.6 s of the machine.
        assert_eq!(parameter(&weather(fields(5000.0)), "Humidity", MAX_AGE, 100.0, 0.0), Ok(50.0));
    }

    #[test]
    fn a_dead_sensor_next_to_working_ones_has_no_value() {
        let mut fields = Weather {
            rain_mm_per_h: Datum::Known(0.0),
            humidity_percent: Datum::Known(50.0),
            sensor_age_s: Datum::Known(1.0),
            ..Default::default()
        };
        let mut rain = |age_s: Datum<f64>| {
            fields.sensor_ages_s.insert("RainRate".to_owned(), age_s);
            assert_eq!(parameter(&weather(fields.clone()), "Humidity", MAX_AGE, 1.0, 0.0), Ok(50.0));
            parameter(&weather(fields.clone()), "RainRate", MAX_AGE, 1.0, 50.0)
        };
        assert_eq!(rain(Datum::Known(20.0)), Ok(0.0));
        let stale = rain(Datum::Known(1500.0)).unwrap_err();
        assert_eq!(stale, "stale: the station says that RainRate's measurement is 1500 s old");
        assert!(rain(Datum::Known(-1.0)).unwrap_err().starts_with("never measured"));
        assert!(rain(Datum::missing(NoData::new("not a number", ""))).unwrap_err().contains("no age"));
        assert_eq!(rain(Datum::missing(NoData::new("timeout", "2 s"))), Ok(0.0));
    }

    #[test]
    fn an_impossible_value_or_a_lost_link_is_no_value() {
        let fields =
            Weather { humidity_percent: Datum::Known(-3.0), wind_mps: Datum::Known(f64::NAN), ..Default::default() };
        let mut state = weather(fields);
        assert!(parameter(&state, "Humidity", MAX_AGE, 1.0, 0.0).is_err());
        assert!(parameter(&state, "WindSpeed", MAX_AGE, 1.0, 0.0).is_err());
        state.fields.humidity_percent = Datum::Known(30.0);
        state.link = Link::Lost { reason: NoData::new("timeout", "2 s") };
        assert_eq!(parameter(&state, "Humidity", MAX_AGE, 1.0, 0.0).unwrap_err(), "link lost: timeout: 2 s");
    }

    #[test]
    fn a_reading_from_before_the_boot_of_this_host_has_no_time() {
        let since_boot = Duration::from_secs(10);
        let at = Now { machine: MachineTime::from_boot(since_boot), sky: SkyTime::from_start(since_boot) };
        let zero = Now { machine: MachineTime::from_boot(Duration::ZERO), sky: SkyTime::from_start(Duration::ZERO) };
        assert_eq!(aged(at, Some(10.0), 1.0), Ok(zero));
        let refused = aged(at, Some(11.0), 1.0).unwrap_err();
        assert_eq!(refused, "read 11 s before, when this machine was not started yet");
    }
}
