//! Where recalled states are placed, and what is refused.

use std::collections::BTreeMap;

use contract::device::observing_conditions::Fields;
use contract::device::record::EarlierStates;
use contract::{Datum, NoData};
use proptest::prelude::*;
use units::SkyTime;

use super::*;

/// Sky seconds in a machine second, in all scenarios.
pub(super) const SPEED: f64 = 10.0;
/// Machine time of the scenarios' zero: the machine has run for a day.
const ZERO_MS: u64 = 86_400_000;

fn machine(ms: i64) -> MachineTime {
    MachineTime::from_boot(Duration::from_millis(ZERO_MS.checked_add_signed(ms).unwrap()))
}

pub(super) fn now(ms: i64) -> Now {
    let since_boot = machine(ms).since(MachineTime::from_boot(Duration::ZERO));
    Now { sky: SkyTime::from_start(since_boot.mul_f64(SPEED)), machine: machine(ms) }
}

/// A weather station's node: its states, and their times.
#[derive(Debug)]
pub(super) struct Station {
    pub(super) boot_id: BootId,
    pub(super) published: Vec<(i64, Link, Fields)>,
}

impl Station {
    pub(super) fn new() -> Self {
        Self { boot_id: BootId::fresh(), published: Vec::new() }
    }

    /// Publishes a humidity at each of these machine seconds; its thermometer always moves.
    pub(super) fn publishes(mut self, seconds: impl IntoIterator<Item = i64>, humidity: f64) -> Self {
        for second in seconds {
            self.published.push((second * 1000, Link::Connected, air(second, Datum::Known(humidity))));
        }
        self
    }

    pub(super) fn loses_link(mut self, second: i64) -> Self {
        let reason = NoData::new("timeout", "2 s");
        self.published.push((
            second * 1000,
            Link::Lost { reason: reason.clone() },
            air(second, Datum::missing(reason)),
        ));
        self
    }

    pub(super) fn stamped(&self, index: usize) -> Stamped<DeviceState<Fields>> {
        let (_, link, fields) = self.published[index].clone();
        let body = DeviceState {
            link,
            busy: false,
            period_s: 5.0,
            poll_s: None,
            last_command: None,
            fields,
            readings: BTreeMap::new(),
        };
        Stamped {
            boot_id: self.boot_id.clone(),
            seq: index as u64,
            at_utc: units::Utc::EPOCH,
            sent_s: None,
            held_s: None,
            body,
        }
    }

    /// What its node answers at this moment.
    pub(super) fn record(&self, at_ms: i64) -> StateRecord<Fields> {
        let earlier = self.published.iter().enumerate().filter(|(_, (published_ms, ..))| *published_ms <= at_ms);
        let entries = earlier.map(|(index, (published_ms, link, fields))| StateEntry {
            seq: index as u64,
            age_s: (at_ms - published_ms) as f64 / 1000.0,
            reading_ages_s: BTreeMap::new(),
            link: link.clone(),
            fields: fields.clone(),
        });
        StateRecord { boot_id: self.boot_id.clone(), speed: SPEED, entries: entries.collect(), earlier: Vec::new() }
    }
}

pub(super) fn air(second: i64, humidity: Datum<f64>) -> Fields {
    Fields { humidity_percent: humidity, air_c: Datum::Known(5.0 + second as f64 * 1e-3), ..Fields::default() }
}

pub(super) fn asked(at_ms: i64, answered_ms: i64) -> Asked {
    Asked { at: machine(at_ms), answered: now(answered_ms), speed: SPEED }
}

/// The live states of a station from this one on, in time.
fn recall_of(station: &Station, indices: std::ops::Range<usize>) -> Recall<Fields> {
    let at = |index: usize| now(station.published[index].0);
    let mut recall = Recall::default();
    for index in indices.clone() {
        assert_eq!(recall.observe(&station.stamped(index), at(index)), index == indices.start, "one hole");
    }
    recall
}

fn placed_ms(states: &[PlacedState<Fields>]) -> Vec<i64> {
    let zero = machine(0);
    let since = |at: MachineTime| at.since(zero).as_millis() as i64 - zero.since(at).as_millis() as i64;
    states.iter().map(|state| since(state.at.machine)).collect()
}

#[test]
fn states_are_placed_when_they_were_published_and_the_newest_is_a_live_one() {
    let station = Station::new().publishes([0, 5, 10, 15, 20], 50.0);
    // 10 was received live, 15 got lost, 20 came live; the answer took half a second and was given half way.
    let mut recall = recall_of(&station, 2..3);
    recall.observe(&station.stamped(4), now(20_000));
    let states = recall.place(&station.record(20_350), asked(20_100, 20_600)).unwrap();
    assert_eq!(placed_ms(&states), [0, 5_000, 10_000, 15_000, 20_000], "in time, by what was received live");
    assert_eq!(states[1].at, now(5_000), "in sky time too");
    let recall = recall_of(&station, 2..3);
    let states = recall.place(&station.record(20_350), asked(20_100, 20_600)).unwrap();
    assert_eq!(states.len(), 3, "what nobody received live is not what is now");
}

#[test]
fn a_first_state_that_came_late_is_placed_when_it_was_published() {
    let station = Station::new().publishes([0, 5], 50.0).publishes([30, 35], 50.0);
    // Asked for what is true now at 29 s, the node was suspended and answers with the state of 5 s.
    let mut recall = Recall::default();
    recall.observe(&station.stamped(1), now(29_000));
    recall.observe(&station.stamped(2), now(30_000));
    let states = recall.place(&station.record(30_200), asked(30_100, 30_300)).unwrap();
    assert_eq!(placed_ms(&states), [0, 5_000, 30_000], "the gap is seen");
}

#[test]
fn a_record_that_does_not_fit_is_refused_as_a_whole() {
    let station = Station::new().publishes((0..=60).step_by(5), 50.0);
    let recall = recall_of(&station, 10..12);
    let good = || station.record(56_000);
    let in_time = asked(55_900, 56_100);
    let refused = |record: StateRecord<Fields>, asked| contradiction(recall.place(&record, asked));
    assert_eq!(recall.place(&good(), in_time).unwrap().len(), 12);
    let spoilt = |spoil: fn(&mut StateRecord<Fields>)| {
        let mut record = good();
        spoil(&mut record);
        refused(record, in_time)
    };
    assert!(spoilt(|record| record.boot_id = BootId::fresh()).contains("another incarnation"));
    assert!(spoilt(|record| record.speed = 100.0).contains("ran at 100 x"));
    assert!(spoilt(|record| record.speed = f64::NAN).contains("NaN"));
    assert!(spoilt(|record| record.entries.clear()).contains("does not reach"));
    assert!(spoilt(|record| record.entries.truncate(8)).contains("does not reach"));
    assert!(spoilt(|record| drop(record.entries.drain(..11))).contains("does not reach"));
    assert!(spoilt(|record| drop(record.entries.remove(3))).contains("a state is missing before 4"));
    assert!(spoilt(|record| record.entries[3].seq = u64::MAX).contains("a state is missing"));
    assert!(spoilt(|record| record.entries[3].age_s = 500.0).contains("older than the one before"));
    for age_s in [f64::NAN, f64::INFINITY, -1.0, 1e18, 1e300] {
        let mut record = good();
        record.entries[0].age_s = age_s;
        assert!(refused(record, in_time).contains("has an age of"), "{age_s}");
    }
    let other = |record: &mut StateRecord<Fields>| record.entries[11].fields.humidity_percent = Datum::Known(49.0);
    assert!(spoilt(other).contains("its state 11 differs"));
}

/// Why an answer says something against what was received.
fn contradiction(placed: Result<Vec<PlacedState<Fields>>, NotTaken>) -> String {
    match placed {
        Err(NotTaken::Contradicts(why)) => why,
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_answer_that_came_too_early_or_too_late_says_nothing_against_what_was_received() {
    let station = Station::new().publishes((0..=60).step_by(5), 50.0);
    let recall = recall_of(&station, 10..12);
    let untimely = |record: StateRecord<Fields>, asked| match recall.place(&record, asked) {
        Err(NotTaken::Untimely(why)) => why,
        other => panic!("{other:?}"),
    };
    // Ages that a delay has spoilt.
    assert!(untimely(station.record(56_000), asked(52_000, 57_000)).contains("took 4"), "not known well enough");
    assert!(untimely(station.record(55_500), asked(55_900, 56_100)).contains("younger than the question"));
    assert!(untimely(station.record(55_000), asked(56_000, 56_100)).contains("younger than the question"));
    // Its node is restarted again and again, and the next incarnation answers before its first state has arrived.
    let mut restarted = station.record(56_000);
    let (boot_id, entries) = (restarted.boot_id.clone(), std::mem::take(&mut restarted.entries));
    restarted.boot_id = BootId::fresh();
    restarted.earlier.push(EarlierStates { boot_id, entries });
    assert!(untimely(restarted, asked(55_900, 56_100)).contains("restarted meanwhile"));
}

#[test]
fn what_comes_while_a_device_node_is_asked_is_bounded() {
    let most = MOST_LIVE as i64;
    let station = Station::new().publishes(0..=most + 3, 50.0);
    let mut recall = recall_of(&station, 0..MOST_LIVE + 1);
    assert_eq!(recall.live.len(), MOST_LIVE);
    let ms = |number: usize| station.published[number].0;
    let answer = |recall: &Recall<Fields>, number: usize| {
        recall.place(&station.record(ms(number)), asked(ms(number), ms(number)))
    };
    assert_eq!(contradiction(answer(&recall, MOST_LIVE)), "more states than are kept came meanwhile");
    recall.close();
    // It goes on with the newest one, and the next hole counts for itself.
    assert!(!recall.observe(&station.stamped(MOST_LIVE + 1), now(ms(MOST_LIVE + 1))));
    assert!(recall.observe(&station.stamped(MOST_LIVE + 3), now(ms(MOST_LIVE + 3))));
    assert_eq!(placed_ms(&answer(&recall, MOST_LIVE + 3).unwrap()), [ms(MOST_LIVE + 2), ms(MOST_LIVE + 3)]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn no_record_of_any_numbers_panics(
        ages in proptest::collection::vec(any::<f64>(), 0..8),
        (first, speed, asked_ms, took_ms) in (0..4_u64, any::<f64>(), -100_000..100_000_i64, 0..10_000_i64),
    ) {
        let station = Station::new().publishes([0, 5, 10], 50.0);
        let recall = recall_of(&station, 1..3);
        let entries = ages.into_iter().zip(first..).map(|(age_s, seq)| {
            StateEntry { seq, age_s, reading_ages_s: BTreeMap::new(), link: Link::Connected, fields: air(5 * seq as i64, Datum::Known(50.0)) }
        });
        let record =
            StateRecord { boot_id: station.boot_id.clone(), speed, entries: entries.collect(), earlier: Vec::new() };
        for speed in [SPEED, speed] {
            let record = StateRecord { speed, ..record.clone() };
            if let Ok(states) = recall.place(&record, asked(asked_ms, asked_ms + took_ms)) {
                prop_assert!(states.is_sorted_by(|a, b| a.at.machine <= b.at.machine));
            }
        }
    }
}
