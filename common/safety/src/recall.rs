//! The record of a device node of what this observatory node did not receive, placed on this node's own clocks: of the
//! time before it listened, and of holes in what it received since.
//!
//! A record is evidence for the past only. It is taken if it joins what was received: without a gap in the numbers of
//! any incarnation of the device node, and with the states that were received here before and after the hole among them,
//! with the same content. Live states alone decide what is now; states in the record after the newest live one that nobody
//! received are left out, and so are those from before this machine was started. A record that does not fit is refused as
//! a whole; whether it says something against what was received is told apart ([`NotTaken`]).

use std::collections::BTreeMap;
use std::time::Duration;

use contract::device::record::{StateEntry, StateRecord};
use contract::{BootId, DeviceState, Link, Payload, Stamped};
use units::{MachineTime, Utc};

use super::history::Now;
use super::missed::Hole;

/// The moment of the answer must be known this well: by so much may the silence before the next live state look
/// shorter than it was, machine time. It is far less than any allowed age.
const DOUBT: Duration = Duration::from_secs(1);
/// Two reckonings of one moment may differ by the drift of two machines' clocks.
const DRIFT: Duration = Duration::from_millis(100);
/// Older states are no evidence; machine time.
const OLDEST: Duration = Duration::from_secs(10 * 86_400);
/// The state before a hole is asked for too, however long it was on its way; machine time.
const MARGIN: Duration = Duration::from_secs(5);
/// More states than any device node keeps.
const MOST_ENTRIES: usize = 20_000;
/// More states than any device node publishes while it is asked.
const MOST_LIVE: usize = 2000;

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

/// What was received of one device, and where something is missing in it.
#[derive(Debug)]
pub struct Recall<F> {
    /// The newest state before a hole; none before the first one.
    before: Option<LiveState<F>>,
    /// All states after the hole, until the device node was asked; none while nothing is missing.
    live: Vec<LiveState<F>>,
    /// More came than are kept: some of `live` are missing before the newest one.
    is_over: bool,
}

/// Why a record is not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotTaken {
    /// It came too early or too late to be placed, and says nothing against what was received: as good as no answer.
    Untimely(String),
    /// It contradicts what was received, or does not contain it.
    Contradicts(String),
}

impl From<String> for NotTaken {
    fn from(why: String) -> Self {
        Self::Contradicts(why)
    }
}

/// One state as it was received.
#[derive(Debug)]
struct LiveState<F> {
    boot_id: BootId,
    seq: u64,
    at_utc: Utc,
    placed: PlacedState<F>,
}

/// One state of a record, with its age when that was answered.
struct RecordedState<'a, F> {
    boot_id: &'a BootId,
    entry: &'a StateEntry<F>,
    age: Duration,
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

impl<F> Default for Recall<F> {
    fn default() -> Self {
        Self { before: None, live: Vec::new(), is_over: false }
    }
}

impl<F: Payload + PartialEq> Recall<F> {
    /// Takes in a live state, newer than those before; true if a hole ends with it, so that its node is to be asked.
    /// While that is done, later holes are parts of this one.
    pub fn observe(&mut self, sample: &Stamped<DeviceState<F>>, at: Now) -> bool {
        let placed = PlacedState {
            at,
            link: sample.body.link.clone(),
            fields: sample.body.fields.clone(),
            ages_s: ages_s(&sample.body),
        };
        let state = LiveState { boot_id: sample.boot_id.clone(), seq: sample.seq, at_utc: sample.at_utc, placed };
        if !self.live.is_empty() {
            if self.live.len() >= MOST_LIVE {
                // The next hole begins with the newest one.
                self.live.pop();
                self.is_over = true;
            }
            self.live.push(state);
            return false;
        }
        let is_next =
            |before: &LiveState<F>| before.boot_id == state.boot_id && before.seq.checked_add(1) == Some(state.seq);
        if self.before.as_ref().is_some_and(is_next) {
            self.before = Some(state);
            return false;
        }
        self.live.push(state);
        true
    }

    /// The hole for which the device node is to be asked, if there is one.
    pub fn hole(&self) -> Option<Hole> {
        let from_utc = self.before.as_ref().map(|before| before.at_utc);
        self.live.first().map(|first| Hole { from_utc, until_utc: first.at_utc })
    }

    /// How far back the device node is to be asked, sky time, of which `speed` seconds are one of the machine: over the
    /// hole, or as far as anybody looks.
    pub fn back(&self, now: Now, longest: Duration, speed: f64) -> Duration {
        let hole = |before: &LiveState<F>| now.machine.since(before.placed.at.machine).saturating_add(MARGIN);
        self.before.as_ref().map_or(longest, |before| hole(before).mul_f64(speed).min(longest))
    }

    /// The device node was asked, with whatever result.
    pub fn close(&mut self) {
        if let Some(newest) = self.live.pop() {
            self.before = Some(newest);
            self.live.clear();
            self.is_over = false;
        }
    }

    /// All states of the hole and since, oldest first, or why the record is not taken.
    pub fn place(&self, record: &StateRecord<F>, asked: Asked) -> Result<Vec<PlacedState<F>>, NotTaken> {
        let newest = self.live.last().ok_or_else(|| "nothing was received since".to_owned())?;
        if self.is_over {
            return Err("more states than are kept came meanwhile".to_owned().into());
        }
        if record.boot_id != newest.boot_id {
            if record.earlier.iter().any(|earlier| earlier.boot_id == newest.boot_id) {
                let why = "its node was restarted meanwhile, and nothing of the next incarnation was received yet";
                return Err(NotTaken::Untimely(why.to_owned()));
            }
            return Err("it is of another incarnation of the device node than the live states".to_owned().into());
        }
        // False for NaN too.
        let same_speed = (record.speed - asked.speed).abs() <= 1e-6 * asked.speed;
        if !same_speed {
            return Err(format!("its sky time ran at {} x, here it runs at {} x", record.speed, asked.speed).into());
        }
        let states = states(record)?;
        let begins = self.begins(&states)?;
        let answered = self.answered(&states, record, asked)?;
        let ends = states.iter().rposition(|state| state.is(newest)).map_or(states.len(), |newest| newest + 1);
        let sky = asked.answered.sky.minus(asked.answered.machine.since(answered).mul_f64(asked.speed));
        // What was published before this machine was started has no place on its clock, whose zero would look fresh.
        let since_boot = answered.since(MachineTime::from_boot(Duration::ZERO));
        let has_place = |state: &&RecordedState<'_, F>| state.age < since_boot;
        let missed = states.get(begins..ends).unwrap_or_default().iter().filter(has_place).map(|state| PlacedState {
            at: Now { sky: sky.minus(state.age.mul_f64(asked.speed)), machine: answered.minus(state.age) },
            link: state.entry.link.clone(),
            fields: state.entry.fields.clone(),
            ages_s: state.entry.reading_ages_s.clone(),
        });
        let later = self.live.iter().filter(|live| !states.iter().any(|state| state.is(live)));
        Ok(missed.chain(later.map(|live| live.placed.clone())).collect())
    }

    /// The index of the first state that was missed, or why the record does not join what was received.
    fn begins(&self, states: &[RecordedState<'_, F>]) -> Result<usize, String> {
        let Some(before) = &self.before else {
            let joins = self.live.first().is_some_and(|first| states.iter().any(|state| state.is(first)));
            let why = "it does not reach the first state that was received here";
            return if joins { Ok(0) } else { Err(why.to_owned()) };
        };
        if let Some((index, state)) = states.iter().enumerate().find(|(_, state)| state.is(before)) {
            return state.agrees(before).map(|()| index + 1);
        }
        // It need not reach so far back, if it is of the incarnation that answers, which forgets only its oldest states.
        let answers = self.live.last().is_some_and(|newest| newest.boot_id == before.boot_id);
        let begins_later = |oldest: &RecordedState<'_, F>| {
            answers && *oldest.boot_id == before.boot_id && oldest.entry.seq > before.seq
        };
        let why = "it does not reach the newest state that was received before the hole";
        if states.first().is_some_and(begins_later) { Ok(0) } else { Err(why.to_owned()) }
    }

    /// The latest moment at which the record can have been answered: before it arrived, before a later state arrived,
    /// and before the time at which a state had the age that the record gives. Late is the safe side: what was bad is
    /// the younger for it.
    fn answered(
        &self,
        states: &[RecordedState<'_, F>],
        record: &StateRecord<F>,
        asked: Asked,
    ) -> Result<MachineTime, NotTaken> {
        let mut answered = asked.answered.machine;
        for live in &self.live {
            let at = live.placed.at.machine;
            let is_later =
                || live.boot_id == record.boot_id && record.entries.last().is_none_or(|newest| newest.seq < live.seq);
            match states.iter().find(|state| state.is(live)) {
                Some(state) => {
                    state.agrees(live)?;
                    answered = answered.min(at.plus(state.age));
                }
                None if is_later() => answered = answered.min(at),
                None => return Err(format!("its state {} is missing, which was received", live.seq).into()),
            }
        }
        if asked.at.since(answered) > DRIFT {
            // No contradiction: a clock that stood still places what arrives after it too early for a while.
            let why = "it is younger than the question, by the age of what was received";
            return Err(NotTaken::Untimely(why.to_owned()));
        }
        let doubt = answered.since(asked.at);
        if doubt > DOUBT {
            return Err(NotTaken::Untimely(format!("its answer took {:.1} s", doubt.as_secs_f64())));
        }
        Ok(answered)
    }
}

impl<F: PartialEq> RecordedState<'_, F> {
    fn is(&self, live: &LiveState<F>) -> bool {
        *self.boot_id == live.boot_id && self.entry.seq == live.seq
    }

    /// Is what was received of it the same?
    fn agrees(&self, live: &LiveState<F>) -> Result<(), String> {
        if self.entry.link != live.placed.link || self.entry.fields != live.placed.fields {
            return Err(format!("its state {} differs from the one that was received", live.seq));
        }
        Ok(())
    }
}

/// All states in their order, with their ages, where they are those of a record.
fn states<F>(record: &StateRecord<F>) -> Result<Vec<RecordedState<'_, F>>, String> {
    let earlier = record.earlier.iter().map(|earlier| (&earlier.boot_id, &earlier.entries));
    let mut states: Vec<RecordedState<'_, F>> = Vec::new();
    for (boot_id, entries) in earlier.chain([(&record.boot_id, &record.entries)]) {
        let mut before: Option<u64> = None;
        for entry in entries {
            let age = Duration::try_from_secs_f64(entry.age_s).ok().filter(|age| *age <= OLDEST);
            let age = age.ok_or_else(|| format!("its state {} has an age of {} s", entry.seq, entry.age_s))?;
            // Only the oldest incarnation may have lost its first states.
            let next = if before.is_none() && !states.is_empty() {
                Some(0)
            } else {
                before.map_or(Some(entry.seq), |before| before.checked_add(1))
            };
            if next != Some(entry.seq) {
                return Err(format!("a state is missing before {}", entry.seq));
            }
            if states.last().is_some_and(|before| before.age < age) {
                return Err(format!("its state {} is older than the one before", entry.seq));
            }
            if states.len() >= MOST_ENTRIES {
                return Err(format!("it has more than {MOST_ENTRIES} states"));
            }
            before = Some(entry.seq);
            states.push(RecordedState { boot_id, entry, age });
        }
    }
    Ok(states)
}

#[cfg(test)]
#[path = "recall_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "recall_restart_tests.rs"]
mod restart_tests;
