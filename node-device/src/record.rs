//! Publishes the states of a device and records them: evidence that survives a restart of an observatory node, and of
//! this node.
//!
//! The record holds the basis of verdicts, as it was published: of safety monitors, and of weather stations and
//! switches, since limits are put on them. Ages are those at the moment of the answer, on this machine's boot-time clock,
//! which counts a suspension: silence shows as a gap.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bus::{Bus, BusError, Clock, MachineTime, Publisher, Quality, Service};
use config::Common;
use contract::device::record::{EarlierStates, RecordQuestion, StateEntry, StateRecord};
use contract::{BootId, Device, DeviceState, Key, Kind, Payload, Topic};
use node::Node;
use serde_json::Value;

use crate::state_file::{self, RecordedState, Source, StateFile};

/// Kept at least, sky time: telescopes that share a station have limits that its node does not know.
const LEAST: Duration = Duration::from_secs(3600);
/// States kept at most: four hours of a station that publishes every 5 s, 50 minutes of a monitor that is asked each
/// second.
const MOST_ENTRIES: usize = 3000;
/// Kept at most, whatever dwell is configured, sky time.
const MOST: Duration = Duration::from_secs(86_400);

/// A disk that takes longer keeps no node from ending.
const ENDS: Duration = Duration::from_secs(1);

/// The age of readings that were younger than this when they were published is not noted.
const LEAST_AGE_S: f64 = 0.5;

/// Publishes a device's states, and records them where a verdict may rest on them.
pub struct StatePublisher<F> {
    states: Publisher<DeviceState<F>>,
    recorder: Option<Recorder<F>>,
}

/// Where the states go that are published.
struct Recorder<F> {
    boot_id: BootId,
    clock: Clock,
    memory: Arc<Mutex<StateMemory<F>>>,
    file: StateFile,
    _service: Service,
}

impl<F: Payload> StatePublisher<F> {
    /// For this device, as its block has it; `cache` states are kept for subscribers that were away.
    pub async fn open(node: &Node, device: &Device, common: &Common, cache: usize) -> Result<Self, BusError> {
        let states = node.bus.publisher_as(&Key::State(device.clone()), Quality::State { cache }).await?;
        if !Topic::Record.kinds().contains(&device.kind) {
            return Ok(Self { states, recorder: None });
        }
        Ok(Self { states, recorder: Some(Recorder::open(node, device, common).await?) })
    }

    /// Publishes a state.
    pub async fn put(&self, state: DeviceState<F>) -> Result<(), BusError> {
        if let Some(recorder) = &self.recorder {
            recorder.keep(self.states.next_seq(), &state);
        }
        self.states.put(state).await
    }

    /// Ends at a stop in good order: what was published last is recorded.
    pub async fn end(self) {
        if let Some(Recorder { file, .. }) = self.recorder {
            file.end(ENDS).await;
        }
    }
}

impl<F: Payload> Recorder<F> {
    async fn open(node: &Node, device: &Device, common: &Common) -> Result<Self, BusError> {
        let (bus, clock) = (&node.bus, node.bus.clock().clone());
        let server = format!("{}#{}", common.server, common.number);
        let source = Source { kernel_boot_id: node::kernel_boot_id(), server, speed: clock.speed() };
        let (file, earlier) = StateFile::open(state_file::path(node, device), source, clock.machine()).await;
        let back = clock.machine_duration(longest(&node.config, device).clamp(LEAST, MOST));
        let memory = Arc::new(Mutex::new(StateMemory::new(back, earlier)));
        let service = answer(bus, device, memory.clone()).await?;
        Ok(Self { boot_id: bus.boot_id().clone(), clock, memory, file, _service: service })
    }

    fn keep(&self, seq: u64, state: &DeviceState<F>) {
        let ages = state.readings.iter().filter_map(|(name, reading)| Some((name, reading.age_s?)));
        let ages_s = ages.filter(|(_, age_s)| *age_s >= LEAST_AGE_S).map(|(name, age_s)| (name.clone(), age_s));
        let recorded = RecordedState {
            boot_id: self.boot_id.clone(),
            seq,
            since_boot: since_boot(self.clock.machine()),
            link: state.link.clone(),
            ages_s: ages_s.collect(),
            fields: state.fields.clone(),
        };
        self.file.append(&recorded);
        self.memory.lock().unwrap_or_else(PoisonError::into_inner).keep(recorded);
    }
}

fn since_boot(at: MachineTime) -> Duration {
    at.since(MachineTime::from_boot(Duration::ZERO))
}

/// How far back the dwell of a device looks, sky time, and before it the window of a measure.
fn longest(config: &config::Observatory, device: &Device) -> Duration {
    let weather =
        config.observingconditions.iter().map(|station| (Kind::ObservingConditions, &station.common, &station.limit));
    let switches = config.switch.iter().map(|switch| (Kind::Switch, &switch.common, &switch.limit));
    let is_own = |kind: Kind, common: &Common| (kind, &common.name) == (device.kind, &device.name);
    let limits_s = weather
        .chain(switches)
        .filter(|&(kind, common, _)| is_own(kind, common))
        .flat_map(|(_, _, limits)| limits)
        .map(|limit| (limit.dwell_min + limit.over_min.unwrap_or_default()) * 60.0 + limit.max_age_s.unwrap_or(60.0));
    let monitors = config.safetymonitor.iter().filter(|monitor| is_own(Kind::SafetyMonitor, &monitor.common));
    let monitors_s = monitors.map(|monitor| monitor.dwell_min * 60.0 + monitor.max_age_s.unwrap_or(60.0));
    // A dwell without end is no number of seconds.
    let looks = limits_s.chain(monitors_s).map(|s| Duration::try_from_secs_f64(s).unwrap_or(MOST));
    looks.max().unwrap_or_default()
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

/// The published states, oldest first.
struct StateMemory<F> {
    back: Duration,
    published: VecDeque<RecordedState<F>>,
}

impl<F: Payload> StateMemory<F> {
    /// One that reaches so far back, machine time, and begins with what earlier incarnations published.
    fn new(back: Duration, earlier: Vec<RecordedState<F>>) -> Self {
        let too_many = earlier.len().saturating_sub(MOST_ENTRIES);
        Self { back, published: earlier.into_iter().skip(too_many).collect() }
    }

    fn keep(&mut self, state: RecordedState<F>) {
        let now = state.since_boot;
        // The newest of those that are too old shows what was true when the window began.
        while self.published.get(1).is_some_and(|second| now.saturating_sub(second.since_boot) > self.back) {
            self.published.pop_front();
        }
        if self.published.len() >= MOST_ENTRIES {
            self.published.pop_front();
        }
        self.published.push_back(state);
    }

    fn answer(&self, back: Option<Duration>, clock: &Clock, boot_id: &BootId) -> StateRecord<F> {
        let now = since_boot(clock.machine());
        let age = |state: &RecordedState<F>| now.saturating_sub(state.since_boot);
        let inside = self.published.iter().rev().take_while(|&state| back.is_some_and(|back| age(state) <= back));
        // And the one before.
        let reported = if back.is_some() { inside.count() + 1 } else { 0 };
        let mut record =
            StateRecord { boot_id: boot_id.clone(), speed: clock.speed(), entries: Vec::new(), earlier: Vec::new() };
        for state in self.published.iter().skip(self.published.len().saturating_sub(reported)) {
            let entry = StateEntry {
                seq: state.seq,
                age_s: age(state).as_secs_f64(),
                reading_ages_s: state.ages_s.clone(),
                link: state.link.clone(),
                fields: state.fields.clone(),
            };
            if state.boot_id == *boot_id {
                record.entries.push(entry);
                continue;
            }
            match record.earlier.last_mut().filter(|run| run.boot_id == state.boot_id) {
                Some(run) => run.entries.push(entry),
                None => record.earlier.push(EarlierStates { boot_id: state.boot_id.clone(), entries: vec![entry] }),
            }
        }
        record
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use contract::device::switch::Fields;
    use contract::{Datum, Link};

    use super::*;

    fn state(boot_id: &BootId, seq: u64, since_boot: Duration) -> RecordedState<Fields> {
        let fields = Fields { values: vec![Datum::Known(seq as f64)] };
        RecordedState {
            boot_id: boot_id.clone(),
            seq,
            since_boot,
            link: Link::Connected,
            ages_s: BTreeMap::new(),
            fields,
        }
    }

    /// A memory of a minute in which number n was published n x `step` s after the machine had booted.
    fn memory(numbers: std::ops::Range<u64>, step: u64) -> StateMemory<Fields> {
        let (mut memory, boot_id) = (StateMemory::new(Duration::from_secs(60), Vec::new()), BootId::fresh());
        for seq in numbers {
            memory.keep(state(&boot_id, seq, Duration::from_secs(seq * step)));
        }
        memory
    }

    fn stored(memory: &StateMemory<Fields>) -> Vec<u64> {
        memory.published.iter().map(|state| state.seq).collect()
    }

    fn answered(memory: &StateMemory<Fields>, back: Option<Duration>, boot_id: &BootId) -> Vec<u64> {
        let record = memory.answer(back, &Clock::machine_clock(), boot_id);
        assert!(record.entries.is_sorted_by(|a, b| a.age_s >= b.age_s && a.seq + 1 == b.seq));
        record.entries.iter().map(|entry| entry.seq).collect()
    }

    /// Now, as the machine's clock has it.
    fn now() -> Duration {
        since_boot(Clock::machine_clock().machine())
    }

    #[test]
    fn what_is_older_than_the_window_goes_but_for_the_one_that_began_it() {
        assert_eq!(stored(&memory(0..4, 20)), [0, 1, 2, 3]);
        assert_eq!(stored(&memory(0..6, 20)), [1, 2, 3, 4, 5]);
        assert_eq!(stored(&memory(0..3, 1000)), [1, 2]);
    }

    #[test]
    fn the_memory_is_bounded_also_where_it_begins_with_a_file() {
        let (numbers, boot_id) = (0..MOST_ENTRIES as u64 + 10, BootId::fresh());
        let earlier = numbers.clone().map(|seq| state(&boot_id, seq, Duration::ZERO)).collect();
        for memory in [memory(numbers, 0), StateMemory::new(Duration::from_secs(60), earlier)] {
            assert_eq!((memory.published.len(), memory.published[0].seq), (MOST_ENTRIES, 10));
        }
    }

    #[test]
    fn the_answer_is_the_window_and_the_one_state_before_it() {
        let (now, boot_id) = (now(), BootId::fresh());
        let mut memory = memory(0..0, 0);
        for (seq, age_s) in [(7, 50), (8, 30), (9, 10), (10, 0)] {
            memory.keep(state(&boot_id, seq, now.saturating_sub(Duration::from_secs(age_s))));
        }
        assert_eq!(answered(&memory, Some(Duration::from_secs(20)), &boot_id), [8, 9, 10]);
        assert_eq!(answered(&memory, Some(Duration::from_secs(3600)), &boot_id), [7, 8, 9, 10]);
        assert_eq!(answered(&memory, None, &boot_id), [0_u64; 0], "a question that nobody can read");
    }

    #[test]
    fn what_earlier_incarnations_published_is_answered_apart() {
        let (now, [first, second, own]) = (now(), [(); 3].map(|()| BootId::fresh()));
        let at = |age_s| now.saturating_sub(Duration::from_secs(age_s));
        let earlier = vec![state(&first, 7, at(40)), state(&first, 8, at(30)), state(&second, 0, at(20))];
        let mut memory = StateMemory::new(Duration::from_secs(60), earlier);
        memory.keep(state(&own, 0, at(10)));
        let record = memory.answer(Some(Duration::from_secs(600)), &Clock::machine_clock(), &own);
        let numbers = |entries: &[StateEntry<Fields>]| entries.iter().map(|entry| entry.seq).collect::<Vec<_>>();
        let apart: Vec<_> = record.earlier.iter().map(|run| (&run.boot_id, numbers(&run.entries))).collect();
        assert_eq!(apart, [(&first, vec![7, 8]), (&second, vec![0])]);
        assert_eq!((&record.boot_id, numbers(&record.entries)), (&own, vec![0]));
        assert!(record.earlier[0].entries[0].age_s >= 40.0);
    }
}
