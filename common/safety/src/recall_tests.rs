//! Where recalled states are placed, what is refused, and scenarios of an observatory that is restarted in a night.

use std::collections::BTreeMap;

use config::Response;
use contract::device::observing_conditions::Fields;
use contract::device::record::EarlierStates;
use contract::observatory::Verdict;
use contract::{Address, Datum, Device, Kind, NoData};
use proptest::prelude::*;
use units::SkyTime;

use super::*;
use crate::judge::{Judgement, judge};
use crate::measure::Measure;
use crate::received::History;
use crate::rules::{Bounds, LimitRule, Rules};

/// Sky seconds in a machine second, in all scenarios.
const SPEED: f64 = 10.0;
/// Machine time of the scenarios' zero: the machine has run for a day.
const ZERO_MS: u64 = 86_400_000;

fn machine(ms: i64) -> MachineTime {
    MachineTime::from_boot(Duration::from_millis(ZERO_MS.checked_add_signed(ms).unwrap()))
}

fn now(ms: i64) -> Now {
    let since_boot = machine(ms).since(MachineTime::from_boot(Duration::ZERO));
    Now { sky: SkyTime::from_start(since_boot.mul_f64(SPEED)), machine: machine(ms) }
}

/// A weather station's node: its states, and their times.
#[derive(Debug)]
struct Station {
    boot_id: BootId,
    published: Vec<(i64, Link, Fields)>,
}

impl Station {
    fn new() -> Self {
        Self { boot_id: BootId::fresh(), published: Vec::new() }
    }

    /// Publishes a humidity at each of these machine seconds; its thermometer always moves.
    fn publishes(mut self, seconds: impl IntoIterator<Item = i64>, humidity: f64) -> Self {
        for second in seconds {
            self.published.push((second * 1000, Link::Connected, air(second, Datum::Known(humidity))));
        }
        self
    }

    fn loses_link(mut self, second: i64) -> Self {
        let reason = NoData::new("timeout", "2 s");
        self.published.push((
            second * 1000,
            Link::Lost { reason: reason.clone() },
            air(second, Datum::missing(reason)),
        ));
        self
    }

    fn stamped(&self, index: usize) -> Stamped<DeviceState<Fields>> {
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
    fn record(&self, at_ms: i64) -> StateRecord<Fields> {
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

fn air(second: i64, humidity: Datum<f64>) -> Fields {
    Fields { humidity_percent: humidity, air_c: Datum::Known(5.0 + second as f64 * 1e-3), ..Fields::default() }
}

fn asked(at_ms: i64, answered_ms: i64) -> Asked {
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

fn wx() -> Device {
    Address::new("site", "scope").unwrap().device(Kind::ObservingConditions, &"wx".parse().unwrap())
}

/// Humidity above 80 closes for five sky minutes, that is 30 s of the machine.
fn limit() -> LimitRule {
    let bounds = Bounds { upper: Some(80.0), lower: None };
    LimitRule {
        input: "wx/Humidity".to_owned(),
        device: wx(),
        parameter: "Humidity".to_owned(),
        measure: Measure::Value,
        bad: bounds,
        reopen: bounds,
        dwell: Duration::from_secs(300),
        max_age: Duration::from_millis(15_500),
        by_period: false,
        required: true,
        response: Response::Close,
        vote: None,
    }
}

fn rules(limits: Vec<LimitRule>) -> Rules {
    Rules { limits, frozen_after: Duration::from_secs(3600), ..Rules::default() }
}

/// Observes a state of the station when it is published.
fn observe(history: &mut History, rules: &Rules, station: &Station, index: usize, at: Now) {
    history.observe_weather(rules, &wx(), &station.stamped(index).body, SPEED, at);
}

/// The verdict of an observatory that has listened all the time.
fn listened(rules: &Rules, station: &Station, judged_ms: i64) -> Judgement {
    let mut history = History::new(rules, now(-1_000_000).sky);
    for (index, (published_ms, ..)) in
        station.published.iter().enumerate().filter(|(_, (published_ms, ..))| *published_ms <= judged_ms)
    {
        observe(&mut history, rules, station, index, now(*published_ms));
    }
    judge(rules, &history, now(judged_ms))
}

/// The verdict of a node that was started at some moment: it asks for the state of that moment (`late`) or receives the
/// next one, then asks for the record, which takes so long. Also returns whether the record was taken.
fn restarted(
    rules: &Rules,
    station: &Station,
    started_ms: i64,
    (late, answer_ms): (bool, i64),
    judged_ms: i64,
) -> Option<(Judgement, bool)> {
    let mut history = History::new(rules, now(started_ms).sky);
    let next = station.published.iter().take_while(|(published_ms, ..)| *published_ms <= started_ms).count();
    let (first, first_ms) =
        if late && next > 0 { (next - 1, started_ms) } else { (next, station.published.get(next)?.0) };
    let answered_ms = first_ms + answer_ms;
    if judged_ms < answered_ms {
        return None;
    }
    let mut recall = Recall::default();
    recall.observe(&station.stamped(first), now(first_ms));
    observe(&mut history, rules, station, first, now(first_ms));
    let (mut record, mut taken) = (Some(station.record(first_ms + answer_ms / 2)), false);
    for index in first + 1..=station.published.len() {
        let published_ms = station.published.get(index).map_or(i64::MAX, |(published_ms, ..)| *published_ms);
        if published_ms.min(judged_ms) >= answered_ms
            && let Some(record) = record.take()
        {
            let states = recall.place(&record, asked(first_ms, answered_ms)).unwrap();
            let newest = &recall.live.last().unwrap().placed;
            assert_eq!(states.last().unwrap().fields, newest.fields, "the newest state is live");
            taken = history.recall_weather(rules, &wx(), states, SPEED).is_ok();
        }
        if published_ms > judged_ms {
            break;
        }
        recall.observe(&station.stamped(index), now(published_ms));
        observe(&mut history, rules, station, index, now(published_ms));
    }
    Some((judge(rules, &history, now(judged_ms)), taken))
}

/// Seconds of the machine until it is safe, by a node that was started at 100 s and judges at 106 s.
fn waits_s(limits: Vec<LimitRule>, station: &Station) -> Option<f64> {
    let (judged, _) = restarted(&rules(limits), station, 100_000, (false, 20), 106_000).unwrap();
    judged.time_to_safe_s.map(|sky_s| (sky_s / SPEED).round())
}

#[test]
fn a_restart_in_the_middle_of_a_good_night_waits_for_nothing() {
    assert_eq!(waits_s(vec![limit()], &Station::new().publishes((0..=105).step_by(5), 50.0)), Some(0.0));
    let several = vec![limit(), LimitRule { dwell: Duration::from_secs(900), ..limit() }];
    assert_eq!(waits_s(several, &Station::new().publishes((0..=105).step_by(5), 50.0)), Some(0.0));
}

#[test]
fn a_bad_reading_within_the_dwell_leaves_the_rest_of_it() {
    let station = Station::new()
        .publishes((0..=80).step_by(5), 50.0)
        .publishes([85], 90.0)
        .publishes((90..=105).step_by(5), 50.0);
    // Good since 90 s, so 14 s of the 30 s are left.
    assert_eq!(waits_s(vec![limit()], &station), Some(14.0));
    let optional = LimitRule { required: false, ..limit() };
    assert_eq!(waits_s(vec![optional], &station), Some(9.0), "counts from the bad one");
}

#[test]
fn a_gap_of_any_kind_restarts_the_dwell() {
    let silent = Station::new().publishes((0..=70).step_by(5), 50.0).publishes((90..=105).step_by(5), 50.0);
    assert_eq!(waits_s(vec![limit()], &silent), Some(14.0), "suspended");
    let lost = |until: i64| {
        let lost = (until + 5..90)
            .step_by(5)
            .fold(Station::new().publishes((0..=until).step_by(5), 50.0), Station::loses_link);
        lost.publishes((90..=105).step_by(5), 50.0)
    };
    assert_eq!(waits_s(vec![limit()], &lost(70)), Some(14.0), "no link for longer than readings may be old");
    assert_eq!(waits_s(vec![limit()], &lost(75)), Some(0.0), "no link for 15 s, as long as readings may be old");
    let born = Station::new().loses_link(89).publishes((90..=105).step_by(5), 50.0);
    assert_eq!(waits_s(vec![limit()], &born), Some(14.0), "the device node was restarted too");
}

#[test]
fn what_reopens_at_less_than_it_closes_at_is_remembered() {
    let mut reopens = limit();
    reopens.reopen.upper = Some(70.0);
    let was_good = Station::new().publishes((0..=60).step_by(5), 60.0).publishes((65..=105).step_by(5), 75.0);
    assert_eq!(waits_s(vec![reopens.clone()], &was_good), Some(0.0), "75 closes nothing");
    let was_bad = Station::new().publishes((0..=60).step_by(5), 85.0).publishes((65..=105).step_by(5), 75.0);
    assert_eq!(waits_s(vec![reopens], &was_bad), None, "and opens nothing");
}

#[test]
fn a_measure_over_a_window_needs_the_whole_window_before_the_dwell() {
    // The largest of five sky minutes, good for five: an hour of the record would do, and a minute of the machine.
    let gust = || LimitRule { measure: Measure::Max(Duration::from_secs(300)), ..limit() };
    assert_eq!(waits_s(vec![gust()], &Station::new().publishes((40..=105).step_by(5), 50.0)), Some(0.0));
    assert_eq!(waits_s(vec![gust()], &Station::new().publishes((70..=105).step_by(5), 50.0)), Some(24.0));
    let rate = LimitRule { measure: Measure::Rate(Duration::from_secs(300)), ..limit() };
    assert_eq!(waits_s(vec![rate], &Station::new().publishes((40..=105).step_by(5), 50.0)), Some(0.0));
}

#[test]
fn an_optional_sensor_is_vouched_for_from_its_first_value_on() {
    let optional = || LimitRule { required: false, ..limit() };
    assert_eq!(waits_s(vec![optional()], &Station::new().publishes((0..=105).step_by(5), 50.0)), Some(0.0));
    let mut silent = Station::new().publishes((0..=105).step_by(5), 50.0);
    for (_, _, fields) in &mut silent.published {
        fields.humidity_percent = Datum::missing(NoData::not_implemented());
    }
    assert_eq!(waits_s(vec![optional()], &silent), Some(24.0), "perhaps its last value was a bad one");
}

#[test]
fn a_record_in_which_nothing_moves_may_be_that_of_a_frozen_station() {
    let mut still = Station::new().publishes((0..=105).step_by(5), 50.0);
    for (_, _, fields) in &mut still.published {
        fields.air_c = Datum::Known(5.0);
    }
    // Good since 105 s, when this observatory received it first.
    assert_eq!(waits_s(vec![limit()], &still), Some(29.0));
    let heedless = Rules { frozen_after: Duration::ZERO, ..rules(vec![limit()]) };
    let (judged, taken) = restarted(&heedless, &still, 100_000, (false, 20), 106_000).unwrap();
    assert_eq!((judged.verdict, taken), (Verdict::Safe, true));
}

#[test]
fn recalled_evidence_without_live_states_is_not_what_is_now() {
    let rules = rules(vec![limit()]);
    let station = Station::new().publishes((0..=100).step_by(5), 50.0);
    let (judged, taken) = restarted(&rules, &station, 99_000, (false, 20), 101_000).unwrap();
    assert_eq!((judged.verdict, taken), (Verdict::Safe, true));
    let (later, _) = restarted(&rules, &station, 99_000, (false, 20), 116_000).unwrap();
    assert!(later.reasons[0].why.starts_with("stale"), "{later:?}");
    // And a late first state is as old as it is.
    let (late, _) = restarted(&rules, &station, 117_000, (true, 20), 118_000).unwrap();
    assert!(late.reasons[0].why.starts_with("stale"), "{late:?}");
}

/// A station that publishes after each pause (s), of each kind: mostly good.
fn stations() -> impl Strategy<Value = Station> {
    let pause = prop_oneof![12 => 1..=5_i64, 1 => 14..=18_i64];
    let humidity = prop_oneof![8 => Just(Some(50.0)), 3 => Just(Some(75.0)), 1 => Just(Some(85.0)), 1 => Just(None)];
    let thermometer =
        prop_oneof![1 => Just(None), 1 => Just(Some(0.0)), 3 => (1..4_u8).prop_map(|c| Some(f64::from(c)))];
    let lost = prop_oneof![30 => Just(false), 1 => Just(true)];
    proptest::collection::vec((pause, humidity, thermometer, lost), 30..90).prop_map(|words| {
        let (mut station, mut second) = (Station::new(), 0);
        let datum = |value: Option<f64>| value.map_or(Datum::missing(NoData::not_implemented()), Datum::Known);
        for (pause, humidity, air_c, lost) in words {
            second += pause;
            if lost {
                station = station.loses_link(second);
            } else {
                // A thermometer that may stand still, be zero or be missing.
                let fields = Fields { air_c: datum(air_c), ..air(second, datum(humidity)) };
                station.published.push((second * 1000, Link::Connected, fields));
            }
        }
        station
    })
}

fn limits() -> impl Strategy<Value = LimitRule> {
    let measure = prop_oneof![
        Just(Measure::Value),
        (20..400_u64).prop_map(|s| Measure::Max(Duration::from_secs(s))),
        (20..200_u64).prop_map(|s| Measure::Rate(Duration::from_secs(s))),
    ];
    let vote = prop_oneof![3 => Just(None), 1 => Just(Some("damp".to_owned()))];
    (measure, 0..700_u64, any::<bool>(), vote, prop_oneof![Just(80.0), Just(60.0)], 4..20_u64).prop_map(
        |(measure, dwell_s, required, vote, reopen, age_s)| LimitRule {
            measure,
            dwell: Duration::from_secs(dwell_s),
            max_age: Duration::from_millis(age_s * 1000 + 500),
            by_period: false,
            required,
            vote,
            reopen: Bounds { upper: Some(reopen), lower: None },
            ..limit()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn a_restarted_observatory_is_never_safe_where_one_that_listened_is_not(
        station in stations(),
        mut limits in proptest::collection::vec(limits(), 1..4),
        (started, late, answer_ms) in (0.0..1.0_f64, any::<bool>(), 0..400_i64),
        frozen_s in prop_oneof![Just(0), 20..200_u64],
        forgotten in 0..40_usize,
    ) {
        limits[0].response = Response::Close;
        let rules = Rules { frozen_after: Duration::from_secs(frozen_s), ..rules(limits) };
        let last_ms = station.published.last().unwrap().0;
        let started_ms = (last_ms as f64 * started) as i64;
        // Its node was started after the first of these states, or has forgotten them.
        let mut younger = Station { boot_id: station.boot_id.clone(), published: station.published.clone() };
        let known = forgotten.min(younger.published.iter().filter(|(published_ms, ..)| *published_ms <= started_ms).count());
        younger.published.drain(..known.saturating_sub(1));
        for judged_ms in (started_ms..last_ms + 20_000).step_by(2900) {
            let restarted = restarted(&rules, &younger, started_ms, (late, answer_ms), judged_ms);
            // One that stands still: what is refused is as if there were no record.
            let Some((judged, true)) = restarted else { continue };
            let truth = listened(&rules, &station, judged_ms);
            // The time of a state that was first received late is known to the time that the answer took.
            let a_moment_ago = listened(&rules, &station, judged_ms - answer_ms);
            // A record without a single value is none: a limit that the site can do without needs no value to be safe.
            let knows = younger.published.iter().any(|(published_ms, _, fields)| {
                *published_ms <= judged_ms && fields.humidity_percent.known().is_some()
            });
            let can_do_without = rules.limits.iter().all(|rule| !rule.required || rule.response != Response::Close);
            prop_assert!(
                judged.verdict == Verdict::Unsafe
                    || [&truth, &a_moment_ago].iter().any(|truth| truth.verdict == Verdict::Safe)
                    || (!knows && can_do_without),
                "at {judged_ms}: {:?}", truth.reasons
            );
        }
    }

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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(25))]

    #[test]
    fn who_listens_later_is_never_safe_where_who_listened_all_the_time_is_not(
        station in stations(),
        mut limit in limits(),
        started in 0.0..1.0_f64,
    ) {
        // For a limit that the site can do without, the last bad value may be one that the later node never received.
        (limit.required, limit.vote) = (true, None);
        let rules = Rules { frozen_after: Duration::ZERO, ..rules(vec![limit]) };
        let last_ms = station.published.last().unwrap().0;
        let started_ms = (last_ms as f64 * started) as i64;
        let mut later = History::new(&rules, now(started_ms).sky);
        for (index, (published_ms, ..)) in station.published.iter().enumerate().filter(|(_, (published_ms, ..))| *published_ms >= started_ms) {
            observe(&mut later, &rules, &station, index, now(*published_ms));
            for judged_ms in [*published_ms, published_ms + 900] {
                let truth = listened(&rules, &station, judged_ms);
                let judged = judge(&rules, &later, now(judged_ms));
                prop_assert!(
                    judged.verdict == Verdict::Unsafe || truth.verdict == Verdict::Safe,
                    "at {judged_ms}: {:?}", truth.reasons
                );
            }
        }
    }
}
