//! The record of a device node of the time before this observatory node listened, placed on this node's own clocks.
//!
//! A record is evidence for the past only. It is taken if it joins the live states: same incarnation of the device
//! node, numbers without a gap, and the first live state among them, with the same content. Live states alone decide
//! what is now; states in the record after the newest live one that nobody received are left out. A record that does
//! not fit is refused as a whole, and the dwell runs as without one.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::device::record::{StateEntry, StateRecord};
use contract::{BootId, DeviceState, Link, Payload, Stamped};
use units::MachineTime;

use super::history::Now;

/// The moment of the answer must be known this well: by so much may the silence before the next live state look
/// shorter than it was, machine time. It is far less than any allowed age.
const DOUBT: Duration = Duration::from_secs(1);
/// Two reckonings of one moment may differ by the drift of two machines' clocks.
const DRIFT: Duration = Duration::from_millis(100);
/// Older states are no evidence; machine time.
const OLDEST: Duration = Duration::from_secs(10 * 86_400);
/// More states than any device node keeps.
const MOST_ENTRIES: usize = 20_000;

/// One state at the time when it was published.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedState<F> {
    /// When, on this node's clocks.
    pub at: Now,
    /// Did the device answer?
    pub link: Link,
    /// What nodes decide with.
    pub fields: F,
    /// How old its readings were when it was published, s of machine time; those that are not listed were fresh.
    pub ages_s: BTreeMap<String, f64>,
}

/// The ages of a state's readings.
pub fn ages_s<F>(state: &DeviceState<F>) -> BTreeMap<String, f64> {
    state.readings.iter().filter_map(|(name, reading)| Some((name.clone(), reading.age_s?))).collect()
}

/// The live states of one device while its node is asked for the time before.
#[derive(Debug)]
pub struct Recall<F> {
    boot_id: BootId,
    live: Vec<(u64, PlacedState<F>)>,
}

/// When a record was asked for and when it came.
#[derive(Debug, Clone, Copy)]
pub struct Asked {
    /// Before the question left.
    pub at: MachineTime,
    /// When the answer was here.
    pub answered: Now,
    /// Sky seconds in a machine second, here.
    pub speed: f64,
}

impl<F: Payload + PartialEq> Recall<F> {
    /// Begins with the first state that was received.
    pub fn new(first: &Stamped<DeviceState<F>>, at: Now) -> Self {
        let mut recall = Self { boot_id: first.boot_id.clone(), live: Vec::new() };
        recall.observe(first, at);
        recall
    }

    /// Takes in a live state, newer than those before; false if it is of another incarnation, which knows nothing of
    /// the first.
    pub fn observe(&mut self, sample: &Stamped<DeviceState<F>>, at: Now) -> bool {
        let state = PlacedState {
            at,
            link: sample.body.link.clone(),
            fields: sample.body.fields.clone(),
            ages_s: ages_s(&sample.body),
        };
        let same_boot = sample.boot_id == self.boot_id;
        if same_boot {
            self.live.push((sample.seq, state));
        }
        same_boot
    }

    /// All states up to the newest live one, oldest first, or why the record is not taken.
    pub fn place(&self, record: &StateRecord<F>, asked: Asked) -> Result<Vec<PlacedState<F>>, String> {
        if record.boot_id != self.boot_id {
            return Err("it is of another incarnation of the device node than the live states".to_owned());
        }
        // False for NaN too.
        let same_speed = (record.speed - asked.speed).abs() <= 1e-6 * asked.speed;
        if !same_speed {
            return Err(format!("its sky time ran at {} x, here it runs at {} x", record.speed, asked.speed));
        }
        let ages = ages(&record.entries)?;
        let entries: Vec<(&StateEntry<F>, Duration)> = record.entries.iter().zip(ages).collect();
        let joins = self.live.first().is_some_and(|(first, _)| entries.iter().any(|(entry, _)| entry.seq == *first));
        let (Some((newest, _)), Some((last, _)), true) = (self.live.last(), entries.last(), joins) else {
            return Err("it does not reach the first state that was received here".to_owned());
        };
        let answered = self.answered(&entries, asked)?;
        let sky = asked.answered.sky.minus(asked.answered.machine.since(answered).mul_f64(asked.speed));
        let placed = entries.iter().filter(|(entry, _)| entry.seq <= *newest).map(|(entry, age)| PlacedState {
            at: Now { sky: sky.minus(age.mul_f64(asked.speed)), machine: answered.minus(*age) },
            link: entry.link.clone(),
            fields: entry.fields.clone(),
            ages_s: entry.reading_ages_s.clone(),
        });
        let later = self.live.iter().filter(|(seq, _)| *seq > last.seq).map(|(_, state)| state.clone());
        Ok(placed.chain(later).collect())
    }

    /// The latest moment at which the record can have been answered: before it arrived, before a later state arrived,
    /// and before the time at which a state had the age that the record gives. Late is the safe side: what was bad is
    /// the younger for it.
    fn answered(&self, entries: &[(&StateEntry<F>, Duration)], asked: Asked) -> Result<MachineTime, String> {
        let mut answered = asked.answered.machine;
        for (seq, live) in &self.live {
            match entries.iter().find(|(entry, _)| entry.seq == *seq) {
                Some((entry, _)) if entry.link != live.link || entry.fields != live.fields => {
                    return Err(format!("its state {seq} differs from the one that was received"));
                }
                Some((_, age)) => answered = answered.min(live.at.machine.plus(*age)),
                None => answered = answered.min(live.at.machine),
            }
        }
        if asked.at.since(answered) > DRIFT {
            return Err("it is younger than the question, by the age of what was received".to_owned());
        }
        let doubt = answered.since(asked.at);
        if doubt > DOUBT {
            return Err(format!("its answer took {:.1} s", doubt.as_secs_f64()));
        }
        Ok(answered)
    }
}

/// The ages of the entries, where they are those of a record.
fn ages<F>(entries: &[StateEntry<F>]) -> Result<Vec<Duration>, String> {
    if entries.len() > MOST_ENTRIES {
        return Err(format!("it has {} states", entries.len()));
    }
    let mut ages: Vec<Duration> = Vec::with_capacity(entries.len());
    for (index, entry) in entries.iter().enumerate() {
        let age = Duration::try_from_secs_f64(entry.age_s).ok().filter(|age| *age <= OLDEST);
        let age = age.ok_or_else(|| format!("its state {} has an age of {} s", entry.seq, entry.age_s))?;
        let before = index.checked_sub(1).and_then(|before| entries.get(before));
        if before.is_some_and(|before| before.seq.checked_add(1) != Some(entry.seq)) {
            return Err(format!("a state is missing before {}", entry.seq));
        }
        if ages.last().is_some_and(|before| *before < age) {
            return Err(format!("its state {} is older than the one before", entry.seq));
        }
        ages.push(age);
    }
    Ok(ages)
}

#[cfg(test)]
#[path = "recall_tests.rs"]
mod tests;
