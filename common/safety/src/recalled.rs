//! The states that this node did not receive, as the device nodes recorded them, among those that it received.
//!
//! They are observed like live ones, in their order. Those from before this node's first state follow what its last
//! incarnation wrote, where they join it; later ones follow what was received before a hole.

use std::time::Duration;

use contract::device::observing_conditions::Fields as Weather;
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::Fields as Switches;
use contract::{Device, Link};
use units::MachineTime;

use super::frozen::Freeze;
use super::history::{Now, Record};
use super::measure::Window;
use super::missed::{Hole, Refusal};
use super::reading::state;
use super::recall::PlacedState;
use super::received::{History, Kept};
use super::rules::Rules;

impl History {
    /// States of a device were missed before the next one. That one counts at once; what was received before it is kept
    /// until its node was asked for them.
    pub fn miss(&mut self, rules: &Rules, device: &Device, hole: Hole) {
        self.asked.insert(device.clone(), hole);
        // Of the time before the first state, its node is asked anyway.
        if !self.awaited.contains(device) {
            self.keep(rules, device, false);
        }
    }

    /// Keeps what is known of a device now; it counts with what is recalled in place of what comes meanwhile.
    pub(crate) fn keep(&mut self, rules: &Rules, device: &Device, is_written: bool) {
        let monitors = rules.monitors.iter().zip(&self.monitors).enumerate();
        let monitors = monitors.filter(|(_, (rule, _))| rule.device == *device);
        let limits = rules.limits.iter().zip(&self.limits).zip(&self.windows).enumerate();
        let limits = limits.filter(|(_, ((rule, _), _))| rule.device == *device);
        let kept = Kept {
            monitors: monitors.map(|(index, (_, record))| (index, record.clone())).collect(),
            limits: limits.map(|(index, ((_, record), window))| (index, (record.clone(), window.clone()))).collect(),
            freeze: self.freeze.clone(),
            is_written,
        };
        self.kept.insert(device.clone(), kept);
    }

    /// Takes in all states of a safety monitor since those that were missed, or from before this node subscribed, in
    /// place of what was received since. `states` is empty if there is no record.
    pub fn recall_monitor(&mut self, rules: &Rules, device: &Device, states: Vec<PlacedState<Monitor>>) {
        self.note_answer(device);
        let vouched_s = self.vouched_s(rules, device);
        let until = self.go_on(rules, device, &states);
        if until.is_none() {
            self.forget(rules, device, states.first().map(|first| first.at));
        }
        for mut placed in following(states, until) {
            if placed.fields.gapless_safe_s > vouched_s {
                placed.fields.gapless_safe_s = vouched_s;
            }
            self.monitor(rules, device, &state(placed.link, placed.fields), &placed.ages_s, placed.at);
        }
    }

    /// What the newest state that was received vouches for, as far as it is believed, s. Nothing recalled vouches for more:
    /// nobody has looked at who published it, as `writers.rs` of the observatory node does with what is received.
    fn vouched_s(&self, rules: &Rules, device: &Device) -> f64 {
        let records = rules.monitors.iter().zip(&self.monitors).filter(|(rule, _)| rule.device == *device);
        let newest = records.map(|(_, record)| record.newest().and_then(|newest| newest.outcome.as_ref().ok()));
        newest
            .map(|reading| reading.map_or(0.0, |reading| reading.gapless_safe.as_secs_f64()))
            .fold(f64::INFINITY, f64::min)
    }

    /// The same for a set of switches, whose values may stand still for ever.
    pub fn recall_switch(&mut self, rules: &Rules, device: &Device, states: Vec<PlacedState<Switches>>) {
        self.note_answer(device);
        let until = self.go_on(rules, device, &states);
        if until.is_none() {
            self.forget(rules, device, states.first().map(|first| first.at));
        }
        for placed in following(states, until) {
            self.switch(rules, device, &state(placed.link, placed.fields), &placed.ages_s, placed.at);
        }
    }

    /// The same for a weather station. An error gives the reason why its record is not taken; the received states then
    /// remain.
    pub fn recall_weather(
        &mut self,
        rules: &Rules,
        device: &Device,
        states: Vec<PlacedState<Weather>>,
        speed: f64,
    ) -> Result<(), String> {
        self.note_answer(device);
        let until = self.go_on(rules, device, &states);
        if until.is_none() && !states.is_empty() {
            let mut freeze = Freeze::default();
            let answers = states.iter().filter(|placed| placed.link == Link::Connected);
            let moves = answers.filter(|placed| freeze.observe(device, &placed.fields, placed.at.machine)).count();
            if (moves == 0 || !freeze.knows(device)) && !rules.frozen_after.is_zero() {
                // Since when it stands still is not known, and it may be too long.
                return Err("its values do not move in all of its record".to_owned());
            }
            self.forget(rules, device, states.first().map(|first| first.at));
            self.freeze.forget(device);
        }
        for placed in following(states, until) {
            self.weather(rules, device, &state(placed.link, placed.fields), &placed.ages_s, speed, placed.at);
        }
        Ok(())
    }

    /// There is no record of what was missed of a device: what was received remains. Its node may have `refused` it, with
    /// an answer that cannot be taken for this reason; everything until then may have been missed.
    pub fn go_without(&mut self, device: &Device, refused: Option<(String, Now)>) {
        self.awaited.remove(device);
        self.kept.remove(device);
        let hole = self.asked.remove(device);
        if let (Some(hole), Some((why, at))) = (hole, refused) {
            self.refused.insert(device.clone(), Refusal { hole, why, at });
        }
    }

    fn note_answer(&mut self, device: &Device) {
        self.awaited.remove(device);
        self.asked.remove(device);
    }

    /// Goes back to what was kept of a device, in place of what was received since, and gives the time after which the
    /// recalled states follow it. `None` where nothing was kept, or where it was written by another incarnation of this
    /// node and the states do not join it.
    fn go_on<F>(&mut self, rules: &Rules, device: &Device, states: &[PlacedState<F>]) -> Option<MachineTime> {
        let kept = self.kept.remove(device)?;
        // Without a record, what was received remains.
        states.first()?;
        // They begin after what was received.
        let mut until = MachineTime::from_boot(Duration::ZERO);
        if kept.is_written {
            let monitors = kept.monitors.iter().filter_map(|(index, record)| {
                Some((record.newest()?.at.machine, self.allowed_of_monitor(rules.monitors.get(*index)?)))
            });
            let limits = kept.limits.iter().filter_map(|(index, (record, _))| {
                Some((record.newest()?.at.machine, self.allowed(rules.limits.get(*index)?)))
            });
            let ends: Vec<(MachineTime, Duration)> = monitors.chain(limits).collect();
            until = ends.iter().map(|(ends, _)| *ends).max()?;
            let next = states.iter().map(|placed| placed.at.machine).find(|at| *at > until)?;
            if ends.iter().any(|(ends, allowed)| next.since(*ends) > *allowed) {
                return None;
            }
        }
        for (index, record) in kept.monitors {
            if let Some(own) = self.monitors.get_mut(index) {
                *own = record;
            }
        }
        for (index, before) in kept.limits {
            if let (Some(own), Some(own_window)) = (self.limits.get_mut(index), self.windows.get_mut(index)) {
                (*own, *own_window) = before;
            }
        }
        self.freeze.take_over(device, &kept.freeze);
        Some(until)
    }

    /// Forgets the received states of a device, to observe it anew from its record, which begins then.
    fn forget(&mut self, rules: &Rules, device: &Device, begins: Option<Now>) {
        let Some(begins) = begins else { return };
        let monitors = self.monitors.iter_mut().zip(&rules.monitors);
        for (record, _) in monitors.filter(|(_, rule)| rule.device == *device) {
            *record = Record::default();
        }
        let limits = self.limits.iter_mut().zip(&mut self.windows).zip(&rules.limits);
        for ((record, window), _) in limits.filter(|(_, rule)| rule.device == *device) {
            (*record, *window) = (Record::default(), Window::since(begins.sky));
        }
    }
}

/// The states that are later than this.
fn following<F>(states: Vec<PlacedState<F>>, until: Option<MachineTime>) -> impl Iterator<Item = PlacedState<F>> {
    states.into_iter().filter(move |placed| until.is_none_or(|until| placed.at.machine > until))
}

#[cfg(test)]
#[path = "recalled_tests.rs"]
mod tests;
