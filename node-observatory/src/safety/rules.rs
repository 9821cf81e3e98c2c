//! The configured safety inputs, and what each state of a device says to them.

use std::time::Duration;

use bus::SkyTime;
use config::{Limit, Observatory};
use contract::device::observing_conditions::Fields as Weather;
use contract::device::safety_monitor::Fields as Monitor;
use contract::{Device, DeviceState, Link};

use super::history::{Entry, Now, Record};
use crate::patience::seconds;

/// A safety monitor that is heeded.
#[derive(Debug, Clone, PartialEq)]
pub struct MonitorRule {
    /// As reasons name it: `safetymonitor/monitor`.
    pub input: String,
    /// Which device.
    pub device: Device,
    /// Safe only after so long without any other word, sky time.
    pub dwell: Duration,
    /// Silence longer than this is unsafe, machine time.
    pub max_age: Duration,
}

/// A limit on one parameter of one weather station.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitRule {
    /// As reasons name it: `wx/Humidity`.
    pub input: String,
    /// Which station.
    pub device: Device,
    /// ASCOM property, or a derived parameter.
    pub parameter: String,
    /// Unsafe above.
    pub upper: Option<f64>,
    /// Unsafe below.
    pub lower: Option<f64>,
    /// Safe only after so long without a violation, sky time.
    pub dwell: Duration,
    /// Silence longer than this is a missing value, machine time.
    pub max_age: Duration,
    /// A missing value is unsafe.
    pub required: bool,
}

impl LimitRule {
    /// Is this value allowed?
    pub fn allows(&self, value: f64) -> bool {
        value.is_finite()
            && self.upper.is_none_or(|upper| value <= upper)
            && self.lower.is_none_or(|lower| value >= lower)
    }
}

/// Everything that the verdict rests on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rules {
    /// Safety monitors.
    pub monitors: Vec<MonitorRule>,
    /// Weather limits, several tiers per parameter where configured.
    pub limits: Vec<LimitRule>,
}

/// What a safety monitor said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MonitorReading {
    /// Its word.
    pub is_safe: bool,
    /// Length of the gapless safe record that its device node vouches for, sky time.
    pub gapless_safe: Duration,
}

/// What all inputs said.
#[derive(Debug, Clone)]
pub struct History {
    /// When the listening began.
    pub since: SkyTime,
    /// One record per safety monitor of the rules.
    pub monitors: Vec<Record<MonitorReading>>,
    /// One record per limit of the rules.
    pub limits: Vec<Record<f64>>,
}

impl Rules {
    /// The rules of a configuration: own devices with their own dwell and limits, shared ones with those of `[shared]`.
    pub fn of(config: &Observatory) -> Self {
        let monitors = config.heeded_safety_monitors().into_iter().map(|device| {
            let own = config
                .safetymonitor
                .iter()
                .find(|own| device.address == config.address() && own.common.name == device.name);
            let (dwell_min, max_age_s) = match own {
                // five polls, so that one lost answer is no alarm
                Some(own) => (own.dwell_min, own.max_age_s.unwrap_or((5.0 * own.common.period_s).max(5.0))),
                None => (config.shared.dwell_min, 5.0),
            };
            MonitorRule {
                input: format!("safetymonitor/{}", device.name),
                dwell: dwell(dwell_min),
                max_age: seconds(max_age_s),
                device,
            }
        });
        let limits = config.heeded_weather().into_iter().flat_map(|device| {
            let own = config
                .observingconditions
                .iter()
                .find(|own| device.address == config.address() && own.common.name == device.name);
            let limits: &[Limit] = own.map_or(&config.shared.limit, |own| &own.limit);
            limits.iter().map(move |limit| LimitRule::of(limit, &device)).collect::<Vec<_>>()
        });
        Self { monitors: monitors.collect(), limits: limits.collect() }
    }

    /// The longest dwell.
    pub fn longest_dwell(&self) -> Duration {
        let monitors = self.monitors.iter().map(|rule| rule.dwell);
        monitors.chain(self.limits.iter().map(|rule| rule.dwell)).max().unwrap_or_default()
    }
}

/// A dwell that is no number never ends.
fn dwell(minutes: f64) -> Duration {
    Duration::try_from_secs_f64(minutes * 60.0).unwrap_or(Duration::MAX)
}

impl LimitRule {
    fn of(limit: &Limit, device: &Device) -> Self {
        let swift = matches!(limit.parameter.as_str(), "RainRate" | "WindSpeed" | "WindGust");
        Self {
            input: format!("{}/{}", device.name, limit.parameter),
            device: device.clone(),
            parameter: limit.parameter.clone(),
            upper: limit.upper,
            lower: limit.lower,
            dwell: dwell(limit.dwell_min),
            max_age: seconds(limit.max_age_s.unwrap_or(if swift { 15.0 } else { 60.0 })),
            required: limit.required,
        }
    }
}

impl History {
    /// Nothing heard yet.
    pub fn new(rules: &Rules, since: SkyTime) -> Self {
        Self {
            since,
            monitors: rules.monitors.iter().map(|_| Record::default()).collect(),
            limits: rules.limits.iter().map(|_| Record::default()).collect(),
        }
    }

    /// Takes in a state of a safety monitor.
    pub fn hear_monitor(&mut self, rules: &Rules, device: &Device, state: &DeviceState<Monitor>, at: Now) {
        for (rule, record) in rules.monitors.iter().zip(&mut self.monitors) {
            if rule.device == *device {
                record.push(Entry { at, outcome: monitor_reading(state) });
                record.forget(at, rule.dwell);
            }
        }
    }

    /// Takes in a state of a weather station; `speed` turns the station's own age into machine time.
    pub fn hear_weather(&mut self, rules: &Rules, device: &Device, state: &DeviceState<Weather>, speed: f64, at: Now) {
        for (rule, record) in rules.limits.iter().zip(&mut self.limits) {
            if rule.device == *device {
                record.push(Entry { at, outcome: parameter(state, &rule.parameter, rule.max_age, speed) });
                record.forget(at, rule.dwell);
            }
        }
    }

    /// Has every input been heard at least once?
    pub fn all_heard(&self) -> bool {
        !self.monitors.iter().any(Record::is_empty) && !self.limits.iter().any(Record::is_empty)
    }
}

fn connected<F>(state: &DeviceState<F>) -> Result<(), String> {
    match &state.link {
        Link::Connected => Ok(()),
        Link::Connecting => Err("not connected yet".to_owned()),
        Link::Lost { reason } => Err(format!("link lost: {reason}")),
    }
}

fn monitor_reading(state: &DeviceState<Monitor>) -> Result<MonitorReading, String> {
    connected(state)?;
    let is_safe = *state.fields.is_safe.as_result().map_err(ToString::to_string)?;
    Ok(MonitorReading { is_safe, gapless_safe: seconds(state.fields.gapless_safe_s) })
}

/// The value of a parameter in a station's state, or why there is none.
fn parameter(state: &DeviceState<Weather>, name: &str, max_age: Duration, speed: f64) -> Result<f64, String> {
    connected(state)?;
    if let Some(age_s) = state.fields.sensor_age_s.known() {
        let age_s = age_s / speed;
        if age_s.is_nan() || age_s > max_age.as_secs_f64() {
            return Err(format!("stale: the station's own measurement is {age_s:.0} s old"));
        }
    }
    let measured = |name: &str| -> Result<f64, String> {
        let datum = state.fields.by_ascom_name(name).ok_or_else(|| format!("{name} is no parameter"))?;
        let value = *datum.as_result().map_err(|reason| format!("{name}: {reason}"))?;
        plausible(name, value)
    };
    match name {
        "RelativeSkyTemp" => Ok(measured("SkyTemperature")? - measured("Temperature")?),
        "DewPointMargin" => Ok(measured("Temperature")? - measured("DewPoint")?),
        name => measured(name),
    }
}

/// Refuses what no weather on Earth does: a broken sensor is a missing sensor.
fn plausible(name: &str, value: f64) -> Result<f64, String> {
    let (low, high) = match name {
        // fog reads 100 and some sensors a little more
        "Humidity" => (0.0, 105.0),
        "CloudCover" => (0.0, 100.0),
        "Temperature" | "DewPoint" => (-90.0, 65.0),
        "SkyTemperature" => (-273.15, 65.0),
        "Pressure" => (300.0, 1100.0),
        "RainRate" => (0.0, 2000.0),
        "WindSpeed" | "WindGust" => (0.0, 120.0),
        "WindDirection" => (0.0, 360.0),
        _ => (f64::MIN, f64::MAX),
    };
    if (low..=high).contains(&value) { Ok(value) } else { Err(format!("{name}: {value} is not possible")) }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use contract::{Datum, NoData};

    use super::*;

    fn weather(fields: Weather) -> DeviceState<Weather> {
        DeviceState {
            link: Link::Connected,
            busy: false,
            period_s: 5.0,
            last_command: None,
            fields,
            readings: BTreeMap::new(),
        }
    }

    const MAX_AGE: Duration = Duration::from_secs(60);

    #[test]
    fn derived_parameters_need_both_of_their_values() {
        let both = weather(Weather { sky_c: Datum::Known(-20.0), air_c: Datum::Known(5.0), ..Default::default() });
        assert_eq!(parameter(&both, "RelativeSkyTemp", MAX_AGE, 1.0), Ok(-25.0));
        assert_eq!(parameter(&both, "DewPointMargin", MAX_AGE, 1.0).unwrap_err(), "DewPoint: never read");
    }

    #[test]
    fn a_station_whose_own_measurement_is_old_has_no_value() {
        let fields = |age_s| Weather {
            humidity_percent: Datum::Known(50.0),
            sensor_age_s: Datum::Known(age_s),
            ..Default::default()
        };
        assert_eq!(parameter(&weather(fields(59.0)), "Humidity", MAX_AGE, 1.0), Ok(50.0));
        assert!(parameter(&weather(fields(61.0)), "Humidity", MAX_AGE, 1.0).is_err());
        assert!(parameter(&weather(fields(f64::NAN)), "Humidity", MAX_AGE, 1.0).is_err());
        // at 100 x speed a sky minute is 0.6 s of the machine
        assert_eq!(parameter(&weather(fields(5000.0)), "Humidity", MAX_AGE, 100.0), Ok(50.0));
    }

    #[test]
    fn an_impossible_value_or_a_lost_link_is_no_value() {
        let fields =
            Weather { humidity_percent: Datum::Known(-3.0), wind_mps: Datum::Known(f64::NAN), ..Default::default() };
        let mut state = weather(fields);
        assert!(parameter(&state, "Humidity", MAX_AGE, 1.0).is_err());
        assert!(parameter(&state, "WindSpeed", MAX_AGE, 1.0).is_err());
        state.fields.humidity_percent = Datum::Known(30.0);
        state.link = Link::Lost { reason: NoData::new("timeout", "2 s") };
        assert_eq!(parameter(&state, "Humidity", MAX_AGE, 1.0).unwrap_err(), "link lost: timeout: 2 s");
    }
}
