//! What the safety inputs said, as the rules see it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use bus::SkyTime;
use contract::device::observing_conditions::Fields as Weather;
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::{Fields as Switches, number_of};
use contract::{Device, DeviceState, Link};

use super::frozen::Freeze;
use super::history::{Entry, Now, Record};
use super::measure::Window;
use super::nodes::Nodes;
use super::recall::Told;
use super::rules::{LimitRule, Rules};
use super::wind::Winds;
use crate::patience::seconds;

/// What a safety monitor said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MonitorReading {
    /// Its word.
    pub is_safe: bool,
    /// Length of the gapless safe record that its device node vouches for, sky time.
    pub gapless_safe: Duration,
}

/// What a limit was put on, at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value of the measure.
    pub value: f64,
    /// It is bad, or it was and is not good enough yet, or nobody knows whether it was.
    pub tripped: bool,
    /// The time after which all of its window is known, sky time.
    pub unknown_for: Duration,
}

/// What all inputs said.
#[derive(Debug, Clone)]
pub struct History {
    /// When the listening began.
    pub since: SkyTime,
    /// One record per safety monitor of the rules.
    pub monitors: Vec<Record<MonitorReading>>,
    /// One record per limit of the rules.
    pub limits: Vec<Record<Measured>>,
    /// What the limits' measures are made of.
    windows: Vec<Window>,
    /// Devices whose nodes were not heard out on the time before.
    awaited: BTreeSet<Device>,
    /// Since when the stations' values stand still.
    pub freeze: Freeze,
    /// What wind blows.
    pub winds: Winds,
    /// How the machines stand.
    pub nodes: Nodes,
    /// Altitude of the Sun now, degrees, or why it is not known.
    pub sun_altitude_deg: Result<f64, String>,
}

impl History {
    /// Nothing heard yet.
    pub fn new(rules: &Rules, since: SkyTime) -> Self {
        Self {
            since,
            monitors: rules.monitors.iter().map(|_| Record::default()).collect(),
            limits: rules.limits.iter().map(|_| Record::default()).collect(),
            // where each value is needed, silence before the first one is as a hole
            windows: rules
                .limits
                .iter()
                .map(|rule| if rule.needs_each() { Window::default() } else { Window::since(since) })
                .collect(),
            awaited: rules.limits.iter().map(|rule| rule.device.clone()).collect(),
            freeze: Freeze::default(),
            winds: Winds::default(),
            nodes: Nodes::default(),
            sun_altitude_deg: Err("not computed yet".to_owned()),
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
        if connected(state).is_ok() {
            self.freeze.hear(device, &state.fields, at.machine);
            self.winds.hear(device, &state.fields, at.machine);
        }
        self.hear_limits(rules, device, at, |rule| parameter(state, &rule.parameter, rule.max_age, speed));
    }

    /// Takes in a state of a set of switches.
    pub fn hear_switch(&mut self, rules: &Rules, device: &Device, state: &DeviceState<Switches>, at: Now) {
        self.hear_limits(rules, device, at, |rule| {
            connected(state)?;
            let value = number_of(&rule.parameter).and_then(|number| state.fields.values.get(number));
            let value = value.ok_or_else(|| format!("there is no {}", rule.parameter))?;
            value.as_result().copied().map_err(ToString::to_string)
        });
    }

    /// Takes in all that a weather station said before this node listened and since, in place of what was heard; `told`
    /// is empty where there is no record. An error says why it is not taken, and what was heard stands.
    pub fn recall_weather(
        &mut self,
        rules: &Rules,
        device: &Device,
        told: Vec<Told<Weather>>,
        speed: f64,
    ) -> Result<(), String> {
        self.awaited.remove(device);
        let mut freeze = Freeze::default();
        let answers = told.iter().filter(|told| told.link == Link::Connected);
        let moves = answers.filter(|told| freeze.hear(device, &told.fields, told.at.machine)).count();
        if (moves == 0 || !freeze.knows(device)) && !told.is_empty() && !rules.frozen_after.is_zero() {
            // since when it stands still is not known, and it may be too long
            return Err("its values do not move in all of its record".to_owned());
        }
        self.forget(rules, device, told.first().map(|first| first.at));
        if !told.is_empty() {
            self.freeze.forget(device);
        }
        for told in told {
            self.hear_weather(rules, device, &state(told.link, told.fields), speed, told.at);
        }
        Ok(())
    }

    /// The same for a set of switches, whose values may stand still for ever.
    pub fn recall_switch(&mut self, rules: &Rules, device: &Device, told: Vec<Told<Switches>>) {
        self.awaited.remove(device);
        self.forget(rules, device, told.first().map(|first| first.at));
        for told in told {
            self.hear_switch(rules, device, &state(told.link, told.fields), told.at);
        }
    }

    /// Forgets what was heard of a device, to hear it anew from its record, which begins then.
    fn forget(&mut self, rules: &Rules, device: &Device, begins: Option<Now>) {
        let Some(begins) = begins else { return };
        let kept = self.limits.iter_mut().zip(&mut self.windows).zip(&rules.limits);
        for ((record, window), _) in kept.filter(|(_, rule)| rule.device == *device) {
            (*record, *window) = (Record::default(), Window::since(begins.sky));
        }
    }

    fn hear_limits(
        &mut self,
        rules: &Rules,
        device: &Device,
        at: Now,
        value: impl Fn(&LimitRule) -> Result<f64, String>,
    ) {
        for (index, rule) in rules.limits.iter().enumerate().filter(|(_, rule)| rule.device == *device) {
            self.hear_value(rule, index, value(rule), at);
        }
    }

    /// Takes in a value for the limit of this index, or why there is none.
    pub fn hear_value(&mut self, rule: &LimitRule, index: usize, value: Result<f64, String>, at: Now) {
        let (Some(record), Some(window)) = (self.limits.get_mut(index), self.windows.get_mut(index)) else { return };
        let is_gap = record.newest().is_some_and(|newest| at.machine.since(newest.at.machine) > rule.max_age);
        if value.is_err() || is_gap {
            window.miss(rule.measure, rule.needs_each());
        }
        let outcome = value.and_then(|value| window.measure(rule.measure, at.sky, value)).map(|value| {
            // where every value is needed a missing one is as bad as a bad one; else the last one stands
            let before = if rule.needs_each() { record.newest().filter(|_| !is_gap) } else { record.last_known() };
            let was_good = before.is_some_and(|entry| entry.outcome.as_ref().is_ok_and(|before| !before.tripped));
            let good = rule.bad.contain(value) && (was_good || rule.reopen.contain(value));
            let unknown_for = window.unknown_for(rule.measure, at.sky);
            Measured { value, tripped: !good || !unknown_for.is_zero(), unknown_for }
        });
        record.push(Entry { at, outcome });
        record.forget(at, rule.dwell);
    }

    /// Has every input been heard at least once, and what its node knows of the time before?
    pub fn all_heard(&self) -> bool {
        self.awaited.is_empty()
            && !self.monitors.iter().any(Record::is_empty)
            && !self.limits.iter().any(Record::is_empty)
    }
}

/// A state of which no more is known than verdicts need.
fn state<F>(link: Link, fields: F) -> DeviceState<F> {
    DeviceState { link, busy: false, period_s: 0.0, last_command: None, fields, readings: BTreeMap::new() }
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
    use contract::{Datum, NoData};

    use super::*;

    fn weather(fields: Weather) -> DeviceState<Weather> {
        state(Link::Connected, fields)
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
