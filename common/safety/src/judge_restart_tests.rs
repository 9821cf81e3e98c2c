//! Scenarios of a device node, or of the server that it asks, that is restarted within the allowed age of its readings.

use contract::device::observing_conditions::Fields;
use contract::device::safety_monitor::Fields as Monitor;
use contract::device::switch::Fields as Switches;
use contract::{Datum, DeviceState, Kind, Link, NoData};
use proptest::prelude::*;

use super::tests::{Scenario, at, device, limit, monitor, weather, why};
use super::*;
use crate::rules::Bounds;

fn state<F>(link: Link, fields: F) -> DeviceState<F> {
    DeviceState {
        link,
        busy: false,
        period_s: 5.0,
        poll_s: None,
        last_command: None,
        fields,
        readings: std::collections::BTreeMap::new(),
    }
}

/// What a device reports of a value.
#[derive(Debug, Clone)]
enum Report {
    Reads(f64),
    /// The node was just started.
    Connecting,
    /// The link is lost for this reason.
    Lost(NoData),
    /// It answers, but not for this value.
    Missing(NoData),
}

use Report::{Connecting, Lost, Missing, Reads};

fn refused() -> NoData {
    NoData::new("transport", "connection refused")
}

impl Report {
    fn link(&self) -> Link {
        match self {
            Reads(_) | Missing(_) => Link::Connected,
            Connecting => Link::Connecting,
            Lost(reason) => Link::Lost { reason: reason.clone() },
        }
    }

    fn datum(&self) -> Datum<f64> {
        match self {
            Reads(value) => Datum::Known(*value),
            Connecting => Datum::default(),
            Lost(reason) | Missing(reason) => Datum::missing(reason.clone()),
        }
    }
}

/// Three inputs that report the same: a monitor (5 s allowed, 60 s of dwell), a weather limit and a switch (15 s, 60 s).
fn site() -> Scenario {
    let wind = LimitRule { parameter: "WindSpeed".to_owned(), ..limit(12.0, 60, true) };
    let ups = LimitRule {
        device: device(Kind::Switch, "ups"),
        parameter: "GetSwitchValue0".to_owned(),
        ..limit(12.0, 60, true)
    };
    Scenario::new(Rules { monitors: vec![monitor("m", 60)], ..weather(vec![wind, ups]) })
}

fn observe(scenario: &mut Scenario, second: u64, report: &Report) {
    let (rules, history, now) = (scenario.rules.clone(), &mut scenario.history, at(second));
    let is_safe = report.datum().map(|value| value <= 12.0);
    let fields = Monitor { is_safe, gapless_safe_s: 0.0 };
    history.observe_monitor(&rules, &device(Kind::SafetyMonitor, "m"), &state(report.link(), fields), now);
    let fields = Fields { wind_mps: report.datum(), ..Fields::default() };
    history.observe_weather(&rules, &device(Kind::ObservingConditions, "wx"), &state(report.link(), fields), 1.0, now);
    let fields = Switches { values: vec![report.datum()] };
    history.observe_switch(&rules, &device(Kind::Switch, "ups"), &state(report.link(), fields), now);
}

/// A site that was good until 200 s, and safe.
fn good_site() -> Scenario {
    let mut scenario = site();
    (0..=200).for_each(|second| observe(&mut scenario, second, &Reads(3.0)));
    assert_eq!(scenario.judged(200).verdict, Verdict::Safe);
    scenario
}

/// Nothing was reported, in each of the ways in which that is published.
fn silences() -> Vec<Report> {
    let lost = [refused(), NoData::new("timeout", "2 s"), NoData::not_connected(), NoData::new("http 503", "loading")];
    let missing = [refused(), NoData::never_read(), NoData::new("stale", "this node was stalled for 2.1 s")];
    [Connecting].into_iter().chain(lost.map(Lost)).chain(missing.map(Missing)).collect()
}

#[test]
fn a_restart_within_the_allowed_age_closes_nothing_and_starts_no_dwell_anew() {
    for silence in silences() {
        let mut scenario = good_site();
        for second in 201..=203 {
            observe(&mut scenario, second, &silence);
            assert_eq!(scenario.judged(second).verdict, Verdict::Safe, "{silence:?} at {second}");
        }
        observe(&mut scenario, 204, &Reads(3.0));
        assert_eq!(scenario.judged(204).verdict, Verdict::Safe, "{silence:?}");
    }
}

#[test]
fn a_restart_that_takes_longer_closes_with_the_reason_and_the_dwell_runs() {
    let mut scenario = good_site();
    (201..=230).for_each(|second| observe(&mut scenario, second, &Lost(refused())));
    assert_eq!(scenario.judged(205).verdict, Verdict::Safe);
    assert_eq!(scenario.judged(206).verdict, Verdict::Unsafe, "the monitor's allowed age is 5 s");
    let judged = scenario.judged(230);
    assert_eq!(judged.reasons.len(), 3, "{judged:?}");
    let expected = "stale: last received 30.0 s ago, allowed are 5.0 s; link lost: transport: connection refused";
    assert_eq!(why(&judged), expected);
    (231..=240).for_each(|second| observe(&mut scenario, second, &Reads(3.0)));
    assert_eq!(scenario.judged(240).time_to_safe_s, Some(51.0));
}

#[test]
fn a_device_that_never_connected_has_reported_nothing() {
    let mut scenario = site();
    observe(&mut scenario, 1, &Connecting);
    let judged = scenario.judged(1);
    assert!(judged.reasons.iter().all(|reason| reason.why == "not connected yet"), "{judged:?}");
    assert!(!scenario.history.all_received() && !judged.speaks_against);
}

#[test]
fn what_the_device_does_answer_counts_at_once() {
    let answers = ["not a number", "wrong type", "missing", "not implemented", "ascom 0x500", "http 500", "http 404"];
    let answers = answers.map(|class| Missing(NoData::new(class, "")));
    let writers = Lost(NoData::new("two writers", "the nodes with boot ids a and b both publish"));
    for report in answers.into_iter().chain([writers, Reads(13.0)]) {
        let mut scenario = good_site();
        observe(&mut scenario, 201, &report);
        assert_eq!(scenario.judged(201).reasons.len(), 3, "{report:?}");
        observe(&mut scenario, 202, &Reads(3.0));
        assert_eq!(scenario.judged(202).time_to_safe_s, Some(60.0), "{report:?}");
    }
}

#[test]
fn a_silent_half_of_a_difference_does_not_hide_the_other_one() {
    let sky = |sky_c: f64, air_c: Datum<f64>| Fields { sky_c: Datum::Known(sky_c), air_c, ..Fields::default() };
    let bounds = Bounds { upper: Some(-20.0), lower: None };
    let limited =
        LimitRule { parameter: "RelativeSkyTemp".to_owned(), bad: bounds, reopen: bounds, ..limit(0.0, 0, true) };
    let judged = |second_state: Fields| {
        let mut scenario = Scenario::new(weather(vec![limited.clone()]));
        let (rules, wx) = (scenario.rules.clone(), device(Kind::ObservingConditions, "wx"));
        for (second, fields) in [(1, sky(-30.0, Datum::Known(5.0))), (2, second_state)] {
            scenario.history.observe_weather(&rules, &wx, &state(Link::Connected, fields), 1.0, at(second));
        }
        scenario.judged(2).verdict
    };
    assert_eq!(judged(sky(-30.0, Datum::default())), Verdict::Safe);
    assert_eq!(judged(sky(-273.15, Datum::default())), Verdict::Unsafe);
}

fn reports() -> impl Strategy<Value = Vec<(u64, Report)>> {
    let silence = proptest::sample::select(silences());
    let report = prop_oneof![
        12 => Just(Reads(3.0)),
        1 => Just(Reads(13.0)),
        1 => Just(Missing(NoData::new("wrong type", ""))),
        4 => silence,
    ];
    proptest::collection::vec((1..3_u64, report), 60..90).prop_map(|reports| {
        let mut second = 0;
        reports
            .into_iter()
            .map(|(pause, report)| {
                second += pause;
                (second, report)
            })
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(24), ..ProptestConfig::with_cases(100) })]

    #[test]
    fn a_reported_silence_is_judged_as_if_nothing_had_come(reports in reports()) {
        let (mut informed, mut deaf) = (site(), site());
        for (second, report) in &reports {
            observe(&mut informed, *second, report);
            let is_silence = report.link() == Link::Connecting
                || report.datum().as_result().is_err_and(NoData::is_silence);
            if !is_silence {
                observe(&mut deaf, *second, report);
            }
            for judged in [*second, second + 4, second + 30] {
                prop_assert_eq!(informed.judged(judged).verdict, deaf.judged(judged).verdict);
            }
        }
    }
}
