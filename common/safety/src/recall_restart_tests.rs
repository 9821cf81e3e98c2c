//! Scenarios of an observatory that is restarted in a night, and asks the node of a weather station for what it published.

use config::Response;
use contract::device::observing_conditions::Fields;
use contract::observatory::Verdict;
use contract::{Address, Datum, Device, Kind, NoData};
use proptest::prelude::*;

use super::tests::{SPEED, Station, air, asked, now};
use super::*;
use crate::judge::{Judgement, judge};
use crate::measure::Measure;
use crate::received::History;
use crate::rules::{Bounds, LimitRule, Rules};

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
