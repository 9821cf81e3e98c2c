//! The received states of the safety inputs, as the rules see them.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use contract::device::observing_conditions::{Fields as Weather, made_of};
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::{Fields as Switches, number_of};
use contract::{Device, DeviceState};
use units::{SkyTime, seconds};

use super::contradiction::{Contradiction, contradiction};
use super::frozen::Freeze;
use super::history::{Entry, Now, Record};
use super::measure::Window;
use super::missed::{Hole, Refusal};
use super::nodes::Nodes;
use super::reading::{
    Measured, MonitorReading, aged, connected, monitor_reading, no_answer, oldest_s, parameter, silence,
    silent_parameter,
};
use super::recall::ages_s;
use super::rules::{LimitRule, MonitorRule, Rules};
use super::sun::SunNow;
use super::wind::Winds;

/// Readings of a safety monitor may be so old, where the configuration has no other limit and its node asks often.
const LEAST_ALLOWED: Duration = Duration::from_secs(5);
/// However seldom a node asks, by its own figure.
const MOST_ALLOWED: Duration = Duration::from_secs(60);
/// What answers may take.
const ANSWERS: Duration = Duration::from_secs(2);

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
    /// What is to come before the states that a device's node is asked for.
    pub(crate) kept: BTreeMap<Device, Kept>,
    /// Devices whose record of the time before was not received to its end.
    pub(crate) awaited: BTreeSet<Device>,
    /// What the devices' nodes are being asked for.
    pub(crate) asked: BTreeMap<Device, Hole>,
    /// What they answered last that was not taken.
    pub(crate) refused: BTreeMap<Device, Refusal>,
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

/// What was known of a device, by the index of each of its rules, before some of its states were missed.
#[derive(Debug, Clone)]
pub(crate) struct Kept {
    pub(crate) monitors: BTreeMap<usize, Record<MonitorReading>>,
    pub(crate) limits: BTreeMap<usize, (Record<Measured>, Window)>,
    pub(crate) freeze: Freeze,
    /// Another incarnation of this node wrote it.
    pub(crate) is_written: bool,
}

impl History {
    /// Nothing received yet.
    pub fn new(rules: &Rules, since: SkyTime) -> Self {
        let monitors = rules.monitors.iter().map(|rule| &rule.device);
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
            kept: BTreeMap::new(),
            awaited: monitors.chain(rules.limits.iter().map(|rule| &rule.device)).cloned().collect(),
            asked: BTreeMap::new(),
            refused: BTreeMap::new(),
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
            Some(poll) => ((*poll).min(MOST_ALLOWED) * 5).clamp(LEAST_ALLOWED, MOST_ALLOWED).max(rule.max_age),
            None => rule.max_age,
        }
    }

    /// The same of a value with a limit.
    pub fn allowed(&self, rule: &LimitRule) -> Duration {
        match self.polls.get(&rule.device).filter(|_| rule.by_period) {
            // One lost answer, and the time that answers take.
            Some(poll) => ((*poll).min(MOST_ALLOWED) * 2 + ANSWERS).min(MOST_ALLOWED).max(rule.max_age),
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
        // Its own word for the time before is enough where it is as long as the dwell.
        let vouched = seconds(state.fields.gapless_safe_s);
        if rules.monitors.iter().filter(|rule| rule.device == *device).all(|rule| rule.dwell <= vouched) {
            self.awaited.remove(device);
        }
        self.monitor(rules, device, state, &ages_s(state), at);
    }

    pub(crate) fn monitor(
        &mut self,
        rules: &Rules,
        device: &Device,
        state: &DeviceState<Monitor>,
        ages_s: &BTreeMap<String, f64>,
        at: Now,
    ) {
        let read_at = aged(at, ages_s.get("IsSafe").copied(), self.speed);
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
        self.weather(rules, device, state, &ages_s(state), speed, at);
    }

    pub(crate) fn weather(
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
        self.switch(rules, device, state, &ages_s(state), at);
    }

    pub(crate) fn switch(
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

/// A reading that is published again never comes before the newest one: both ways here took a little time.
fn after<T: Clone>(record: &Record<T>, at: Now) -> Now {
    record.newest().map(|newest| newest.at).filter(|newest| newest.machine > at.machine).unwrap_or(at)
}
