//! What this node received, as it is written for its next incarnation: a restart of the node, or of all nodes of a
//! telescope, that is over within the allowed age of the readings starts no dwell anew (decision 0150).
//!
//! It is placed by the boot-time clock, which nobody can set and which only a boot of the machine begins anew. Whatever
//! does not fit is passed over with a reason, and the dwell runs. What is restored is the time before: the newest value
//! keeps its age, and live values must join it without a gap, as after any silence.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use contract::Device;
use serde::{Deserialize, Serialize};
use units::{MachineTime, Utc};

use crate::clocks::AGREE_S;
use crate::frozen::StoredStill;
use crate::history::{Now, Record, StoredRecord};
use crate::measure::{StoredWindow, Window};
use crate::missed::{Refusal, StoredRefusal};
use crate::reading::{Measured, MonitorReading};
use crate::received::History;
use crate::rules::Rules;

/// One moment by all clocks of this node.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Which boot of the machine this is, as its kernel names it; empty where nobody knows.
    pub boot: String,
    /// Both monotonic times.
    pub now: Now,
    /// Wall clock, or the simulator's.
    pub utc: Utc,
    /// Sky seconds in a machine second.
    pub speed: f64,
}

/// The received states of all inputs, as far as verdicts need them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredHistory {
    boot: String,
    utc: Utc,
    /// Boot-time clock.
    since_boot: Duration,
    speed: f64,
    /// By the rule in full, so that another configuration finds none.
    monitors: BTreeMap<String, StoredRecord<MonitorReading>>,
    limits: BTreeMap<String, (StoredRecord<Measured>, StoredWindow)>,
    polls: BTreeMap<String, Duration>,
    stations: BTreeMap<String, StoredStill>,
    /// By the device.
    #[serde(default)]
    refused: BTreeMap<String, StoredRefusal>,
}

/// An input whose dwell runs, although something was written, and why.
pub type PassedOver = (String, String);

impl History {
    /// What is to be written now: of a device whose node is being asked for what was missed, what was known before that,
    /// so that the next incarnation asks for it too.
    pub fn store(&self, rules: &Rules, moment: &Moment) -> StoredHistory {
        let now = moment.now;
        let monitors = rules.monitors.iter().zip(&self.monitors).enumerate().map(|(index, (rule, record))| {
            let record = self.kept.get(&rule.device).and_then(|kept| kept.monitors.get(&index)).unwrap_or(record);
            let allowed = self.allowed_of_monitor(rule);
            (format!("{rule:?}"), record.store(now, allowed, self.since, |reading| reading.is_safe))
        });
        let limits = rules.limits.iter().zip(&self.limits).zip(&self.windows).enumerate();
        let limits = limits.map(|(index, ((rule, record), window))| {
            let kept = self.kept.get(&rule.device).and_then(|kept| kept.limits.get(&index));
            let (record, window) = kept.map_or((record, window), |(record, window)| (record, window));
            let record = record.store(now, self.allowed(rule), self.since, |measured| !measured.tripped);
            (format!("{rule:?}"), (record, window.store(now.sky)))
        });
        let still = |device: &&Device| {
            let freeze = self.kept.get(*device).map_or(&self.freeze, |kept| &kept.freeze);
            Some((device.to_string(), freeze.store(device, now.machine)?))
        };
        StoredHistory {
            boot: moment.boot.clone(),
            utc: moment.utc,
            since_boot: now.machine.since(MachineTime::from_boot(Duration::ZERO)),
            speed: moment.speed,
            monitors: monitors.collect(),
            limits: limits.collect(),
            polls: self.polls.iter().map(|(device, poll)| (device.to_string(), *poll)).collect(),
            stations: devices(rules).iter().filter_map(still).collect(),
            refused: self.refused.iter().map(|(device, refusal)| (device.to_string(), refusal.store(now))).collect(),
        }
    }

    /// Begins with what was written, as far as it fits; nothing was received yet. An error says why nothing of it fits.
    pub fn restore(
        &mut self,
        rules: &Rules,
        stored: &StoredHistory,
        moment: &Moment,
    ) -> Result<Vec<PassedOver>, String> {
        let then = stored.written(moment)?;
        let age = moment.now.machine.since(then.machine);
        let mut whole = devices(rules);
        for device in &whole {
            let name = device.to_string();
            self.polls.extend(stored.polls.get(&name).map(|poll| ((*device).clone(), *poll)));
            let refusal = stored.refused.get(&name).map(|refusal| Refusal::of_stored(refusal, then));
            self.refused.extend(refusal.map(|refusal| ((*device).clone(), refusal)));
        }
        let mut passed_over = Vec::new();
        for (index, rule) in rules.monitors.iter().enumerate() {
            match fitting(&stored.monitors, &format!("{rule:?}"), age, self.allowed_of_monitor(rule)) {
                Ok(record) => {
                    self.monitors.get_mut(index).into_iter().for_each(|own| *own = Record::of_stored(record, then))
                }
                Err(why) => {
                    whole.remove(&rule.device);
                    passed_over.push((rule.input.clone(), why));
                }
            }
        }
        for (index, rule) in rules.limits.iter().enumerate() {
            match fitting(&stored.limits, &format!("{rule:?}"), age, self.allowed(rule)) {
                Ok((record, window)) => {
                    if let (Some(own), Some(own_window)) = (self.limits.get_mut(index), self.windows.get_mut(index)) {
                        (*own, *own_window) = (Record::of_stored(record, then), Window::of_stored(window, then.sky));
                    }
                    if let Some(still) = stored.stations.get(&rule.device.to_string()) {
                        self.freeze.restore(&rule.device, still, then.machine);
                    }
                }
                Err(why) => {
                    whole.remove(&rule.device);
                    passed_over.push((rule.input.clone(), why));
                }
            }
        }
        for device in whole {
            self.keep(rules, device, true);
        }
        Ok(passed_over)
    }
}

impl StoredHistory {
    /// When it was written, on the clocks of this incarnation, or why that cannot be known.
    fn written(&self, moment: &Moment) -> Result<Now, String> {
        if moment.boot.is_empty() || self.boot != moment.boot {
            return Err("it was written before this machine was started".to_owned());
        }
        let machine = MachineTime::from_boot(self.since_boot);
        if machine > moment.now.machine {
            return Err("it is from the future".to_owned());
        }
        // False for NaN too.
        let same_speed = (self.speed - moment.speed).abs() <= 1e-6 * moment.speed;
        if !same_speed {
            return Err(format!("its sky time ran at {} x, here it runs at {} x", self.speed, moment.speed));
        }
        let passed = moment.now.machine.since(machine).mul_f64(moment.speed);
        let step_s = moment.utc.seconds_since(self.utc) - passed.as_secs_f64();
        if step_s.abs() > AGREE_S * moment.speed.max(1.0) {
            return Err(format!("the clock has jumped by {step_s:+.0} s since it was written"));
        }
        Ok(Now { sky: moment.now.sky.minus(passed), machine })
    }
}

fn devices(rules: &Rules) -> BTreeSet<&Device> {
    rules.monitors.iter().map(|rule| &rule.device).chain(rules.limits.iter().map(|rule| &rule.device)).collect()
}

/// What was written of an input, if it can still count.
fn fitting<'a, T>(
    stored: &'a BTreeMap<String, T>,
    rule: &str,
    age: Duration,
    allowed: Duration,
) -> Result<&'a T, String> {
    let found = stored.get(rule).ok_or("nothing was written of this input with these limits")?;
    if age > allowed {
        let (age_s, allowed_s) = (age.as_secs_f64(), allowed.as_secs_f64());
        return Err(format!("it was written {age_s:.1} s ago, allowed are {allowed_s:.1} s"));
    }
    Ok(found)
}

#[cfg(test)]
#[path = "stored_history_tests.rs"]
mod tests;
