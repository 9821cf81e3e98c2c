//! The received states of the safety inputs, as the rules see them.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use contract::device::observing_conditions::{Fields as Weather, made_of};
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::{Fields as Switches, number_of};
use contract::{Datum, Device, DeviceState, Link, NoData};
use serde::{Deserialize, Serialize};
use units::seconds;
use units::{MachineTime, SkyTime};

use super::contradiction::{Contradiction, contradiction};
use super::frozen::Freeze;
use super::history::{Entry, Now, Record};
use super::measure::Window;
use super::nodes::Nodes;
use super::recall::{self, PlacedState};
use super::rules::{LimitRule, MonitorRule, Rules};
use super::sun::SunNow;
use super::wind::Winds;

/// Readings of a safety monitor may be so old, where the configuration has no other limit and its node asks often.
const LEAST_ALLOWED: Duration = Duration::from_secs(5);
/// However seldom a node asks, by its own figure.
const MOST_ALLOWED: Duration = Duration::from_secs(60);
/// What answers may take.
const ANSWERS: Duration = Duration::from_secs(2);

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

/// The received states of all inputs.
#[derive(Debug, Clone)]
pub struct History {
    /// When the listening began.
    pub since: SkyTime,
    /// One record per safety monitor of the rules.
    pub monitors: Vec<Record<MonitorReading>>,
    /// One record per limit of the rules.
    pub limits: Vec<Record<Measured>>,
    /// What the limits' measures are made of.
    pub(crate) windows: Vec<Window>,
    /// The limits as another incarnation of this node wrote them, until the time since then is known.
    pub(crate) restored: Vec<Option<(Record<Measured>, Window)>>,
    /// The same of stations that may stand still.
    pub(crate) restored_freeze: Freeze,
    /// Devices whose record of the time before was not received to its end.
    awaited: BTreeSet<Device>,
    /// Since when the stations' values stand still.
    pub freeze: Freeze,
    /// What wind blows.
    pub winds: Winds,
    /// The state of the machines.
    pub nodes: Nodes,
    /// How often each device is asked, as its node publishes, machine time.
    pub(crate) polls: BTreeMap<Device, Duration>,
    /// Sky seconds in a machine second.
    pub speed: f64,
    /// Where the Sun is.
    pub sun: SunNow,
}

impl History {
    /// Nothing received yet.
    pub fn new(rules: &Rules, since: SkyTime) -> Self {
        Self {
            since,
            monitors: rules.monitors.iter().map(|_| Record::default()).collect(),
            limits: rules.limits.iter().map(|_| Record::default()).collect(),
            // If each value is needed, silence before the first one counts as a hole.
            windows: rules
                .limits
                .iter()
                .map(|rule| if rule.needs_each() { Window::default() } else { Window::since(since) })
                .collect(),
            restored: rules.limits.iter().map(|_| None).collect(),
            restored_freeze: Freeze::default(),
            awaited: rules.limits.iter().map(|rule| rule.device.clone()).collect(),
            freeze: Freeze::default(),
            winds: Winds::default(),
            nodes: Nodes::default(),
            polls: BTreeMap::new(),
            speed: 1.0,
            sun: SunNow::default(),
        }
    }

    /// The age at which a monitor's reading is worth nothing any more, machine time.
    pub fn allowed_of_monitor(&self, rule: &MonitorRule) -> Duration {
        match self.polls.get(&rule.device).filter(|_| rule.by_period) {
            // Five polls, so that one lost answer raises no alarm; whatever a node publishes, no monitor is silent for
            // minutes.
            Some(poll) => (*poll * 5).clamp(LEAST_ALLOWED, MOST_ALLOWED).max(rule.max_age),
            None => rule.max_age,
        }
    }

    /// The same of a value with a limit.
    pub fn allowed(&self, rule: &LimitRule) -> Duration {
        match self.polls.get(&rule.device).filter(|_| rule.by_period) {
            // One lost answer, and the time that answers take.
            Some(poll) => (*poll * 2 + ANSWERS).min(MOST_ALLOWED).max(rule.max_age),
            None => rule.max_age,
        }
    }

    fn note_poll<F>(&mut self, device: &Device, state: &DeviceState<F>) {
        let poll = Duration::try_from_secs_f64(state.poll_s.unwrap_or(state.period_s));
        // A state from a record does not contain it.
        if let Ok(poll) = poll
            && !poll.is_zero()
        {
            self.polls.insert(device.clone(), poll);
        }
    }

    /// Takes in a state of a safety monitor.
    pub fn observe_monitor(&mut self, rules: &Rules, device: &Device, state: &DeviceState<Monitor>, at: Now) {
        self.note_poll(device, state);
        let read_at = aged(at, state.age_s("IsSafe"), self.speed);
        for (rule, record) in rules.monitors.iter().zip(&mut self.monitors) {
            if rule.device == *device {
                if let Some(why) = no_answer(state).or_else(|| silence(state.fields.is_safe.as_result().err())) {
                    record.is_silent(why);
                    continue;
                }
                let outcome = read_at.clone().and_then(|_| monitor_reading(state));
                let at = after(record, read_at.clone().unwrap_or(at));
                record.push(Entry { at, outcome });
                record.forget(at, rule.dwell);
            }
        }
    }

    /// Takes in a state of a weather station; `speed` turns the station's own age into machine time.
    pub fn observe_weather(
        &mut self,
        rules: &Rules,
        device: &Device,
        state: &DeviceState<Weather>,
        speed: f64,
        at: Now,
    ) {
        self.note_poll(device, state);
        self.weather(rules, device, state, &recall::ages_s(state), speed, at);
    }

    fn weather(
        &mut self,
        rules: &Rules,
        device: &Device,
        state: &DeviceState<Weather>,
        ages_s: &BTreeMap<String, f64>,
        speed: f64,
        at: Now,
    ) {
        if connected(state).is_ok() {
            self.freeze.observe(device, &state.fields, at.machine);
            self.winds.observe(device, &state.fields, at.machine);
        }
        let silent = |rule: &LimitRule| no_answer(state).or_else(|| silent_parameter(&state.fields, &rule.parameter));
        let sent_s = ages_s.get("TimeSinceLastUpdate").copied().unwrap_or(0.0);
        let contradiction = contradiction(&state.fields);
        self.observe_limits(rules, device, at, contradiction, silent, |rule, allowed| {
            let value = parameter(state, &rule.parameter, allowed, speed, sent_s);
            (value, oldest_s(ages_s, made_of(&rule.parameter)))
        });
    }

    /// Takes in a state of a set of switches.
    pub fn observe_switch(&mut self, rules: &Rules, device: &Device, state: &DeviceState<Switches>, at: Now) {
        self.note_poll(device, state);
        self.switch(rules, device, state, &recall::ages_s(state), at);
    }

    fn switch(
        &mut self,
        rules: &Rules,
        device: &Device,
        state: &DeviceState<Switches>,
        ages_s: &BTreeMap<String, f64>,
        at: Now,
    ) {
        let value_of = |rule: &LimitRule| state.fields.values.get(number_of(&rule.parameter)?);
        let silent = |rule: &LimitRule| {
            no_answer(state).or_else(|| silence(value_of(rule).and_then(|value| value.as_result().err())))
        };
        self.observe_limits(rules, device, at, None, silent, |rule, _| {
            let number = number_of(&rule.parameter);
            let value = || {
                connected(state)?;
                let value = number.and_then(|number| state.fields.values.get(number));
                let value = value.ok_or_else(|| format!("there is no {}", rule.parameter))?;
                value.as_result().copied().map_err(ToString::to_string)
            };
            let property = number.map(|number| format!("GetSwitchValue{number}")).unwrap_or_default();
            (value(), oldest_s(ages_s, [property.as_str()]))
        });
    }

    /// Takes in all states of a weather station, from before this node subscribed and since, in place of the received
    /// ones. `states` is empty if there is no record. An error gives the reason why it is not taken; the received
    /// states then remain.
    pub fn recall_weather(
        &mut self,
        rules: &Rules,
        device: &Device,
        states: Vec<PlacedState<Weather>>,
        speed: f64,
    ) -> Result<(), String> {
        self.awaited.remove(device);
        if let Some(until) = self.go_on(rules, device, &states) {
            for placed in states.into_iter().filter(|placed| placed.at.machine > until) {
                self.weather(rules, device, &state(placed.link, placed.fields), &placed.ages_s, speed, placed.at);
            }
            return Ok(());
        }
        let mut freeze = Freeze::default();
        let answers = states.iter().filter(|placed| placed.link == Link::Connected);
        let moves = answers.filter(|placed| freeze.observe(device, &placed.fields, placed.at.machine)).count();
        if (moves == 0 || !freeze.knows(device)) && !states.is_empty() && !rules.frozen_after.is_zero() {
            // Since when it stands still is not known, and it may be too long.
            return Err("its values do not move in all of its record".to_owned());
        }
        self.forget(rules, device, states.first().map(|first| first.at));
        if !states.is_empty() {
            self.freeze.forget(device);
        }
        for placed in states {
            self.weather(rules, device, &state(placed.link, placed.fields), &placed.ages_s, speed, placed.at);
        }
        Ok(())
    }

    /// The same for a set of switches, whose values may stand still for ever.
    pub fn recall_switch(&mut self, rules: &Rules, device: &Device, states: Vec<PlacedState<Switches>>) {
        self.awaited.remove(device);
        let until = self.go_on(rules, device, &states);
        if until.is_none() {
            self.forget(rules, device, states.first().map(|first| first.at));
        }
        for placed in states.into_iter().filter(|placed| until.is_none_or(|until| placed.at.machine > until)) {
            self.switch(rules, device, &state(placed.link, placed.fields), &placed.ages_s, placed.at);
        }
    }

    /// Where the states of a device join what another incarnation of this node wrote, begins with that in place of what
    /// was received since, and gives the time of its newest value: the states after it follow.
    fn go_on<F>(&mut self, rules: &Rules, device: &Device, states: &[PlacedState<F>]) -> Option<MachineTime> {
        let own = rules.limits.iter().enumerate().filter(|(_, rule)| rule.device == *device);
        let (mut taken, mut ends) = (Vec::new(), Vec::new());
        for (index, rule) in own {
            let stored = self.restored.get_mut(index)?.take()?;
            ends.extend(stored.0.newest().map(|newest| (newest.at.machine, self.allowed(rule))));
            taken.push((index, stored));
        }
        let until = ends.iter().map(|(ends, _)| *ends).max()?;
        let next = states.iter().map(|placed| placed.at.machine).find(|at| *at > until)?;
        if ends.iter().any(|(ends, allowed)| next.since(*ends) > *allowed) {
            return None;
        }
        for (index, stored) in taken {
            if let (Some(record), Some(window)) = (self.limits.get_mut(index), self.windows.get_mut(index)) {
                (*record, *window) = stored;
            }
        }
        self.freeze.take_over(device, &self.restored_freeze);
        Some(until)
    }

    /// Forgets the received states of a device, to observe it anew from its record, which begins then.
    fn forget(&mut self, rules: &Rules, device: &Device, begins: Option<Now>) {
        let Some(begins) = begins else { return };
        let limits = self.limits.iter_mut().zip(&mut self.windows).zip(&rules.limits);
        for ((record, window), _) in limits.filter(|(_, rule)| rule.device == *device) {
            (*record, *window) = (Record::default(), Window::since(begins.sky));
        }
    }

    /// `read` makes of a limit, and the age that it allows, the value and the age of its reading, s. Where its reading is
    /// `silent`, nothing was reported: the value before that stays the newest one until it is too old.
    fn observe_limits(
        &mut self,
        rules: &Rules,
        device: &Device,
        at: Now,
        contradiction: Option<Contradiction>,
        silent: impl Fn(&LimitRule) -> Option<String>,
        read: impl Fn(&LimitRule, Duration) -> (Result<f64, String>, Option<f64>),
    ) {
        for (index, rule) in rules.limits.iter().enumerate().filter(|(_, rule)| rule.device == *device) {
            if let (Some(why), Some(record)) = (silent(rule), self.limits.get_mut(index)) {
                record.is_silent(why);
                continue;
            }
            let (value, age_s) = read(rule, self.allowed(rule));
            let read_at = aged(at, age_s, self.speed);
            let value = read_at.clone().and(value);
            self.observe_doubtful(rule, index, value, contradiction, read_at.unwrap_or(at));
        }
    }

    /// Takes in a value for the limit of this index that was read then, or why there is none.
    pub fn observe_value(&mut self, rule: &LimitRule, index: usize, value: Result<f64, String>, at: Now) {
        self.observe_doubtful(rule, index, value, None, at);
    }

    /// The same of a value that is not good where the station contradicts itself.
    fn observe_doubtful(
        &mut self,
        rule: &LimitRule,
        index: usize,
        value: Result<f64, String>,
        contradiction: Option<Contradiction>,
        at: Now,
    ) {
        let allowed = self.allowed(rule);
        let (Some(record), Some(window)) = (self.limits.get_mut(index), self.windows.get_mut(index)) else { return };
        let at = after(record, at);
        let is_gap = record.newest().is_some_and(|newest| at.machine.since(newest.at.machine) > allowed);
        if value.is_err() || is_gap {
            window.miss(rule.measure, rule.needs_each());
        }
        let outcome = value.and_then(|value| window.measure(rule.measure, at.sky, value)).map(|value| {
            // If every value is needed, a missing one is as bad as a bad one; else the last one remains valid.
            let before = if rule.needs_each() { record.newest().filter(|_| !is_gap) } else { record.last_known() };
            let was_good = before.is_some_and(|entry| entry.outcome.as_ref().is_ok_and(|before| !before.tripped));
            let is_within = rule.bad.contain(value) && (was_good || rule.reopen.contain(value));
            let good = is_within && contradiction.is_none();
            let unknown_for = window.unknown_for(rule.measure, at.sky);
            Measured { value, tripped: !good || !unknown_for.is_zero(), unknown_for, contradiction }
        });
        record.push(Entry { at, outcome });
        record.forget(at, rule.dwell);
    }

    /// Has every input been received at least once, and its node's record of the time before?
    pub fn all_received(&self) -> bool {
        self.awaited.is_empty() && self.monitors.iter().all(Record::is_live) && self.limits.iter().all(Record::is_live)
    }
}

/// A state of which no more is known than verdicts need.
fn state<F>(link: Link, fields: F) -> DeviceState<F> {
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

/// When a reading was made that was so old at that moment: not when it was published.
fn aged(at: Now, age_s: Option<f64>, speed: f64) -> Result<Now, String> {
    let Some(age_s) = age_s else { return Ok(at) };
    let age = Duration::try_from_secs_f64(age_s).map_err(|_| format!("its age is given as {age_s} s"))?;
    Ok(Now { machine: at.machine.minus(age), sky: at.sky.minus(age.mul_f64(speed)) })
}

/// A reading that is published again never comes before the newest one: both ways here took a little time.
fn after<T: Clone>(record: &Record<T>, at: Now) -> Now {
    record.newest().map(|newest| newest.at).filter(|newest| newest.machine > at.machine).unwrap_or(at)
}

/// The age of the oldest reading that something is made of; one that is none decides for all.
fn oldest_s<'a>(ages_s: &BTreeMap<String, f64>, properties: impl IntoIterator<Item = &'a str>) -> Option<f64> {
    let ages = properties.into_iter().filter_map(|name| ages_s.get(name).copied());
    ages.reduce(|a, b| if a.is_nan() || b.is_nan() || a < 0.0 || b < 0.0 { f64::NAN } else { a.max(b) })
}

fn connected<F>(state: &DeviceState<F>) -> Result<(), String> {
    match &state.link {
        Link::Connected => Ok(()),
        Link::Connecting => Err("not connected yet".to_owned()),
        Link::Lost { reason } => Err(format!("link lost: {reason}")),
    }
}

/// Why the device has answered nothing since the state before, if so. A node that has just been started, and a server
/// that refuses connections while it is restarted, report nothing about the sky.
fn no_answer<F>(state: &DeviceState<F>) -> Option<String> {
    let answered_nothing = match &state.link {
        Link::Connected => false,
        Link::Connecting => true,
        Link::Lost { reason } => reason.is_silence(),
    };
    connected(state).err().filter(|_| answered_nothing)
}

/// The same of a single value.
fn silence(missing: Option<&NoData>) -> Option<String> {
    missing.filter(|reason| reason.is_silence()).map(ToString::to_string)
}

/// The same of a parameter: a part of it is silent, and no other part is bad.
fn silent_parameter(fields: &Weather, parameter: &str) -> Option<String> {
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

fn monitor_reading(state: &DeviceState<Monitor>) -> Result<MonitorReading, String> {
    connected(state)?;
    let is_safe = *state.fields.is_safe.as_result().map_err(ToString::to_string)?;
    Ok(MonitorReading { is_safe, gapless_safe: seconds(state.fields.gapless_safe_s) })
}

/// The value of a parameter in a station's state, or why there is none; `sent_s` is how long ago the station published
/// how old its own measurement is.
fn parameter(
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
}
