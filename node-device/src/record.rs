//! Publishes the states of a device and records them: evidence that survives a restart of an observatory node.
//!
//! The record holds the basis of verdicts, as it was published, of weather stations and switches, since limits are put
//! on them (a safety monitor's state contains the length of its own record). Ages are those at the moment of the
//! answer, on this node's own boot-time clock, which counts a suspension: silence shows as a gap.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, BusError, Clock, MachineTime, Publisher, Quality, Service};
use contract::device::record::{RecordQuestion, StateEntry, StateRecord};
use contract::{BootId, Device, DeviceState, Key, Kind, Link, Payload, Topic};
use node::Node;
use serde_json::Value;

/// Kept at least, sky time: telescopes that share a station have limits that its node does not know.
const LEAST: Duration = Duration::from_secs(3600);
/// States kept at most: four hours of a station that publishes every 5 s.
const MOST_ENTRIES: usize = 3000;
/// Kept at most, whatever dwell is configured, sky time.
const MOST: Duration = Duration::from_secs(86_400);

/// The age of readings that were younger than this when they were published is not noted.
const LEAST_AGE_S: f64 = 0.5;

/// Publishes a device's states, and records them where limits may be put on them.
pub struct StatePublisher<F> {
    states: Publisher<DeviceState<F>>,
    memory: Option<Arc<Mutex<StateMemory<F>>>>,
    clock: Clock,
    _service: Option<Service>,
}

impl<F: Payload> StatePublisher<F> {
    /// For this device; `cache` states are kept for subscribers that were away.
    pub async fn open(node: &Node, device: &Device, cache: usize) -> Result<Self, BusError> {
        let (bus, clock) = (&node.bus, node.bus.clock().clone());
        let states = bus.publisher_as(&Key::State(device.clone()), Quality::State { cache }).await?;
        if !Topic::Record.kinds().contains(&device.kind) {
            return Ok(Self { states, memory: None, clock, _service: None });
        }
        let back = longest(&node.config, device).clamp(LEAST, MOST);
        let memory = Arc::new(Mutex::new(StateMemory::new(clock.machine_duration(back))));
        let service = answer(bus, device, memory.clone()).await?;
        Ok(Self { states, memory: Some(memory), clock, _service: Some(service) })
    }

    /// Publishes a state.
    pub async fn put(&self, state: DeviceState<F>) -> Result<(), BusError> {
        if let Some(memory) = &self.memory {
            let (link, fields, now) = (state.link.clone(), state.fields.clone(), self.clock.machine());
            let ages = state.readings.iter().filter_map(|(name, reading)| Some((name, reading.age_s?)));
            let ages_s = ages.filter(|(_, age_s)| *age_s >= LEAST_AGE_S).map(|(name, age_s)| (name.clone(), age_s));
            let ages_s = ages_s.collect();
            let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
            memory.keep(RecordedState { seq: self.states.next_seq(), at: now, link, fields, ages_s });
        }
        self.states.put(state).await
    }
}

/// How far back the limits of a device look, sky time: the dwell, and before it the window of a measure.
fn longest(config: &config::Observatory, device: &Device) -> Duration {
    let weather =
        config.observingconditions.iter().map(|station| (Kind::ObservingConditions, &station.common, &station.limit));
    let switches = config.switch.iter().map(|switch| (Kind::Switch, &switch.common, &switch.limit));
    let own = weather.chain(switches).filter(|(kind, common, _)| (*kind, &common.name) == (device.kind, &device.name));
    let looks_s = own
        .flat_map(|(_, _, limits)| limits)
        .map(|limit| (limit.dwell_min + limit.over_min.unwrap_or_default()) * 60.0 + limit.max_age_s.unwrap_or(60.0));
    // A dwell without end is no number of seconds.
    looks_s.map(|s| Duration::try_from_secs_f64(s).unwrap_or(MOST)).max().unwrap_or_default()
}

async fn answer<F: Payload>(
    bus: &Bus,
    device: &Device,
    memory: Arc<Mutex<StateMemory<F>>>,
) -> Result<Service, BusError> {
    let (boot_id, clock) = (bus.boot_id().clone(), bus.clock().clone());
    let answer = move |question: Result<RecordQuestion, String>| {
        // A question that cannot be read is answered with no evidence at all.
        let back = question.ok().and_then(|question| Duration::try_from_secs_f64(question.back_s).ok());
        let back = back.map(|back| clock.machine_duration(back.min(MOST)));
        let memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
        let record = memory.answer(back, &clock, &boot_id);
        drop(memory);
        let answer = serde_json::to_value(record).unwrap_or(Value::Null);
        async move { answer }
    };
    bus.serve::<RecordQuestion, Value, _, _>(&Key::Record(device.clone()), answer).await
}

/// One state as it was published.
struct RecordedState<F> {
    seq: u64,
    at: MachineTime,
    link: Link,
    fields: F,
    /// How old its readings were, where that matters.
    ages_s: BTreeMap<String, f64>,
}

/// The published states, oldest first.
struct StateMemory<F> {
    back: Duration,
    published: VecDeque<RecordedState<F>>,
}

impl<F: Payload> StateMemory<F> {
    /// One that reaches so far back, machine time.
    fn new(back: Duration) -> Self {
        Self { back, published: VecDeque::new() }
    }

    fn keep(&mut self, state: RecordedState<F>) {
        let now = state.at;
        // The newest of those that are too old shows what was true when the window began.
        while self.published.get(1).is_some_and(|second| now.since(second.at) > self.back) {
            self.published.pop_front();
        }
        if self.published.len() >= MOST_ENTRIES {
            self.published.pop_front();
        }
        self.published.push_back(state);
    }

    fn answer(&self, back: Option<Duration>, clock: &Clock, boot_id: &BootId) -> StateRecord<F> {
        let now = clock.machine();
        let inside =
            self.published.iter().rev().take_while(|state| back.is_some_and(|back| now.since(state.at) <= back));
        // And the one before.
        let reported = if back.is_some() { inside.count() + 1 } else { 0 };
        let entries =
            self.published.iter().skip(self.published.len().saturating_sub(reported)).map(|state| StateEntry {
                seq: state.seq,
                age_s: now.since(state.at).as_secs_f64(),
                reading_ages_s: state.ages_s.clone(),
                link: state.link.clone(),
                fields: state.fields.clone(),
            });
        StateRecord { boot_id: boot_id.clone(), speed: clock.speed(), entries: entries.collect() }
    }
}

#[cfg(test)]
mod tests {
    use contract::Datum;
    use contract::device::switch::Fields;

    use super::*;

    /// A memory of a minute in which number n was published n x `step` s after the machine had booted.
    fn memory(numbers: std::ops::Range<u64>, step: u64) -> StateMemory<Fields> {
        let mut memory = StateMemory::new(Duration::from_secs(60));
        for seq in numbers {
            let fields = Fields { values: vec![Datum::Known(seq as f64)] };
            let at = MachineTime::from_boot(Duration::from_secs(seq * step));
            memory.keep(RecordedState { seq, at, link: Link::Connected, fields, ages_s: BTreeMap::new() });
        }
        memory
    }

    fn stored(memory: &StateMemory<Fields>) -> Vec<u64> {
        memory.published.iter().map(|state| state.seq).collect()
    }

    fn answered(memory: &StateMemory<Fields>, back: Option<Duration>) -> Vec<u64> {
        let record = memory.answer(back, &Clock::machine_clock(), &BootId::fresh());
        assert!(record.entries.is_sorted_by(|a, b| a.age_s >= b.age_s && a.seq + 1 == b.seq));
        record.entries.iter().map(|entry| entry.seq).collect()
    }

    #[test]
    fn what_is_older_than_the_window_goes_but_for_the_one_that_began_it() {
        assert_eq!(stored(&memory(0..4, 20)), [0, 1, 2, 3]);
        assert_eq!(stored(&memory(0..6, 20)), [1, 2, 3, 4, 5]);
        assert_eq!(stored(&memory(0..3, 1000)), [1, 2]);
    }

    #[test]
    fn the_memory_is_bounded() {
        let memory = memory(0..MOST_ENTRIES as u64 + 10, 0);
        assert_eq!((memory.published.len(), memory.published[0].seq), (MOST_ENTRIES, 10));
    }

    #[test]
    fn the_answer_is_the_window_and_the_one_state_before_it() {
        let now = Clock::machine_clock().machine().since(MachineTime::from_boot(Duration::ZERO));
        let mut memory = memory(0..0, 0);
        for (seq, age_s) in [(7, 50), (8, 30), (9, 10), (10, 0)] {
            let at = MachineTime::from_boot(now.saturating_sub(Duration::from_secs(age_s)));
            memory.keep(RecordedState {
                seq,
                at,
                link: Link::Connected,
                fields: Fields::default(),
                ages_s: BTreeMap::new(),
            });
        }
        assert_eq!(answered(&memory, Some(Duration::from_secs(20))), [8, 9, 10]);
        assert_eq!(answered(&memory, Some(Duration::from_secs(3600))), [7, 8, 9, 10]);
        assert_eq!(answered(&memory, None), [0_u64; 0], "a question that nobody can read");
    }
}
