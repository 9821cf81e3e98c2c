use contract::{Address, Device, Kind};
use proptest::prelude::*;
use units::{MachineTime, SkyTime};

use super::*;
use crate::history::Entry;
use crate::measure::Measure;
use crate::rules::Bounds;

pub(super) fn at(seconds: u64) -> Now {
    let since = Duration::from_secs(seconds);
    Now { sky: SkyTime::from_start(since), machine: MachineTime::from_boot(since) }
}

pub(super) fn device(kind: Kind, name: &str) -> Device {
    Address::new("site", "scope").unwrap().device(kind, &name.parse().unwrap())
}

pub(super) fn monitor(name: &str, dwell_s: u64) -> MonitorRule {
    MonitorRule {
        input: format!("safetymonitor/{name}"),
        device: device(Kind::SafetyMonitor, name),
        dwell: Duration::from_secs(dwell_s),
        max_age: Duration::from_secs(5),
        by_period: false,
    }
}

pub(super) fn limit(upper: f64, dwell_s: u64, required: bool) -> LimitRule {
    LimitRule {
        input: "wx/Humidity".to_owned(),
        device: device(Kind::ObservingConditions, "wx"),
        parameter: "Humidity".to_owned(),
        measure: Measure::Value,
        bad: Bounds { upper: Some(upper), lower: None },
        reopen: Bounds { upper: Some(upper), lower: None },
        dwell: Duration::from_secs(dwell_s),
        max_age: Duration::from_secs(15),
        by_period: false,
        required,
        response: Response::Close,
        vote: None,
    }
}

pub(super) fn weather(limits: Vec<LimitRule>) -> Rules {
    Rules { limits, ..Rules::default() }
}

fn word(is_safe: bool, gapless_s: u64) -> MonitorReading {
    MonitorReading { is_safe, gapless_safe: Duration::from_secs(gapless_s) }
}

/// The states of one monitor (safe every second from `from` to `to`) and of one weather station.
pub(super) struct Scenario {
    pub(super) rules: Rules,
    pub(super) history: History,
}

impl Scenario {
    pub(super) fn new(rules: Rules) -> Self {
        let history = History::new(&rules, at(0).sky);
        Self { rules, history }
    }

    fn monitor_reports(
        mut self,
        index: usize,
        seconds: impl IntoIterator<Item = u64>,
        reading: MonitorReading,
    ) -> Self {
        for second in seconds {
            self.history.monitors[index].push(Entry { at: at(second), outcome: Ok(reading) });
        }
        self
    }

    fn monitor_is_silent(mut self, index: usize, second: u64) -> Self {
        self.history.monitors[index].push(Entry { at: at(second), outcome: Err("timeout: 2 s".to_owned()) });
        self
    }

    pub(super) fn weather_reports(
        mut self,
        index: usize,
        seconds: impl IntoIterator<Item = u64>,
        outcome: Result<f64, &str>,
    ) -> Self {
        for second in seconds {
            let value = outcome.map_err(str::to_owned);
            self.history.observe_value(&self.rules.limits[index], index, value, at(second));
        }
        self
    }

    pub(super) fn judged(&self, now: u64) -> Judgement {
        judge(&self.rules, &self.history, at(now))
    }
}

pub(super) fn one_monitor(dwell_s: u64) -> Scenario {
    Scenario::new(Rules { monitors: vec![monitor("m", dwell_s)], ..Rules::default() })
}

fn one_limit(dwell_s: u64, required: bool) -> Scenario {
    Scenario::new(weather(vec![limit(80.0, dwell_s, required)]))
}

pub(super) fn why(judgement: &Judgement) -> &str {
    &judgement.reasons[0].why
}

#[test]
fn without_any_input_it_is_never_safe() {
    let judged = Scenario::new(Rules::default()).judged(100_000);
    assert_eq!(judged.verdict, Verdict::Unsafe);
    assert!(why(&judged).contains("no safety monitor"), "{judged:?}");
    assert_eq!(judged.time_to_safe_s, None);
}

#[test]
fn nothing_received_is_unsafe() {
    assert_eq!(why(&one_monitor(0).judged(9)), "nothing received yet");
    assert_eq!(why(&one_limit(0, true).judged(9)), "nothing received yet");
}

#[test]
fn the_dwell_must_be_filled_before_the_first_safe() {
    let scenario = one_monitor(60).monitor_reports(0, 0..=60, word(true, 0));
    assert_eq!(scenario.judged(59).verdict, Verdict::Unsafe);
    let scenario = one_monitor(60).monitor_reports(0, 0..=30, word(true, 0));
    let judged = scenario.judged(30);
    assert_eq!(judged.time_to_safe_s, Some(30.0));
    assert_eq!(why(&judged), "good for 0.5 of 1.0 min");
    let scenario = one_monitor(60).monitor_reports(0, 0..=60, word(true, 0));
    assert_eq!(scenario.judged(60).verdict, Verdict::Safe);
}

#[test]
fn a_gust_over_a_window_that_is_longer_than_the_dwell_needs_the_whole_window_and_then_the_dwell() {
    for required in [true, false] {
        let gust = LimitRule { measure: Measure::Max(Duration::from_secs(600)), ..limit(80.0, 60, required) };
        let scenario = || Scenario::new(weather(vec![gust.clone()]));
        let calm = scenario().weather_reports(0, (0..=120).step_by(10), Ok(50.0));
        let judged = calm.judged(120);
        assert_eq!(
            (why(&judged), judged.time_to_safe_s),
            ("values for 2.0 of the 10.0 min that are needed", Some(540.0)),
            "{required}"
        );
        assert!(!judged.speaks_against, "too few readings are no bad reading");
        let verdict =
            |until: u64| scenario().weather_reports(0, (0..=until).step_by(10), Ok(50.0)).judged(until).verdict;
        assert_eq!((verdict(640), verdict(660)), (Verdict::Unsafe, Verdict::Safe), "{required}");
        // A hole in the record does not blow the gust before it away.
        let scenario =
            scenario().weather_reports(0, (0..=700).step_by(10), Ok(50.0)).weather_reports(0, [710], Ok(90.0));
        let scenario = scenario.weather_reports(0, [720], Err("timeout: 2 s")).weather_reports(
            0,
            (730..=1000).step_by(10),
            Ok(50.0),
        );
        assert!(why(&scenario.judged(1000)).starts_with("90 is above 80"), "{required}: {:?}", scenario.judged(1000));
    }
}

#[test]
fn a_record_stored_by_the_device_node_fills_the_dwell_at_once() {
    assert_eq!(one_monitor(900).monitor_reports(0, [5], word(true, 900)).judged(6).verdict, Verdict::Safe);
    assert_eq!(one_monitor(900).monitor_reports(0, [5], word(true, 899)).judged(6).verdict, Verdict::Unsafe);
}

#[test]
fn one_bad_word_is_unsafe_at_once_and_restarts_the_dwell() {
    let scenario = one_monitor(60).monitor_reports(0, 0..=100, word(true, 0)).monitor_reports(0, [101], word(false, 0));
    let judged = scenario.judged(101);
    assert_eq!((judged.verdict, judged.speaks_against), (Verdict::Unsafe, true));
    assert_eq!(judged.time_to_safe_s, None);
    let scenario = scenario.monitor_reports(0, 102..=160, word(true, 0));
    assert_eq!(scenario.judged(160).verdict, Verdict::Unsafe);
    let scenario = scenario.monitor_reports(0, 161..=162, word(true, 0));
    assert_eq!(scenario.judged(162).verdict, Verdict::Safe);
}

#[test]
fn a_stale_reading_is_unsafe() {
    let scenario = one_monitor(60).monitor_reports(0, 0..=100, word(true, 1000));
    assert_eq!(scenario.judged(105).verdict, Verdict::Safe);
    let judged = scenario.judged(106);
    assert_eq!(judged.verdict, Verdict::Unsafe);
    assert!(why(&judged).starts_with("stale"), "{judged:?}");
}

#[test]
fn a_missing_reading_is_unsafe_with_its_reason() {
    let scenario = one_monitor(0).monitor_reports(0, 0..=10, word(true, 1000)).monitor_is_silent(0, 11);
    assert_eq!(why(&scenario.judged(11)), "timeout: 2 s");
}

#[test]
fn any_monitor_that_reports_unsafe_decides() {
    // 1-out-of-n with required inputs: all 27 cases of three monitors.
    for case in 0..27_u32 {
        let rules = Rules { monitors: vec![monitor("a", 0), monitor("b", 0), monitor("c", 0)], ..Rules::default() };
        let mut scenario = Scenario::new(rules);
        let words: Vec<u32> = (0..3).map(|i| case / 3_u32.pow(i) % 3).collect();
        for (index, kind) in words.iter().enumerate() {
            scenario = match kind {
                0 => scenario.monitor_reports(index, [10], word(true, 0)),
                1 => scenario.monitor_reports(index, [10], word(false, 0)),
                _ => scenario,
            };
        }
        let expected = if words == [0, 0, 0] { Verdict::Safe } else { Verdict::Unsafe };
        assert_eq!(scenario.judged(10).verdict, expected, "{words:?}");
    }
}

#[test]
fn a_weather_limit_closes_at_once_and_reopens_after_its_dwell() {
    let scenario = one_limit(600, true).weather_reports(0, (0..=700).step_by(5), Ok(50.0));
    assert_eq!(scenario.judged(700).verdict, Verdict::Safe);
    let scenario = scenario.weather_reports(0, [705], Ok(80.5));
    let judged = scenario.judged(705);
    assert_eq!(why(&judged), "80.5 is above 80");
    let scenario = scenario.weather_reports(0, (710..=1305).step_by(5), Ok(50.0));
    assert_eq!(scenario.judged(1305).verdict, Verdict::Unsafe);
    let scenario = scenario.weather_reports(0, [1310], Ok(50.0));
    assert_eq!(scenario.judged(1310).verdict, Verdict::Safe);
}

#[test]
fn a_gap_in_the_weather_restarts_its_dwell() {
    let scenario = one_limit(100, true).weather_reports(0, (0..=200).step_by(5), Ok(50.0)).weather_reports(
        0,
        (216..=300).step_by(5),
        Ok(50.0),
    );
    let judged = scenario.judged(300);
    assert_eq!(judged.time_to_safe_s, Some(16.0));
}

#[test]
fn several_tiers_of_one_parameter_hold_side_by_side() {
    let rules = weather(vec![limit(80.0, 10, true), limit(90.0, 1000, true)]);
    let mut scenario = Scenario::new(rules);
    for index in 0..2 {
        scenario = scenario
            .weather_reports(index, (0..=2000).step_by(5), Ok(50.0))
            .weather_reports(index, [2005], Ok(95.0))
            .weather_reports(index, (2010..=2030).step_by(5), Ok(50.0));
    }
    let judged = scenario.judged(2030);
    assert_eq!(judged.verdict, Verdict::Unsafe);
    assert_eq!(judged.reasons.len(), 1, "the mild tier is over, the harsh one is not: {judged:?}");
    assert_eq!(judged.time_to_safe_s, Some(980.0));
}

#[test]
fn an_optional_sensor_may_be_missing_but_not_bad() {
    let scenario = one_limit(60, false);
    assert_eq!(scenario.judged(59).verdict, Verdict::Unsafe);
    let missing = one_limit(60, false).weather_reports(0, (0..=60).step_by(5), Err("not implemented"));
    let judged = missing.judged(60);
    assert_eq!(judged.verdict, Verdict::Safe);
    assert_eq!((judged.inputs[0].value.as_str(), judged.inputs[0].good), ("not implemented", false));
    let bad_then_silent = one_limit(60, false).weather_reports(0, (0..=60).step_by(5), Ok(90.0)).weather_reports(
        0,
        (65..=900).step_by(5),
        Err("timeout"),
    );
    assert_eq!(why(&bad_then_silent.judged(900)), "90 is above 80 when last received");
    let good_again = bad_then_silent.weather_reports(0, [905], Ok(50.0));
    assert_eq!(good_again.judged(905).verdict, Verdict::Safe);
}

#[test]
fn reasons_that_nobody_can_time_leave_the_time_open() {
    let rules = Rules { monitors: vec![monitor("a", 60), monitor("b", 60)], ..Rules::default() };
    let scenario = Scenario::new(rules).monitor_reports(0, 0..=10, word(true, 0));
    assert_eq!(scenario.judged(10).time_to_safe_s, None);
}

#[test]
fn a_closed_dome_reopens_at_a_stricter_value_than_it_closed_at() {
    let mut rule = limit(80.0, 60, true);
    rule.reopen.upper = Some(75.0);
    let scenario = Scenario::new(weather(vec![rule]));
    let scenario = scenario.weather_reports(0, (0..=100).step_by(5), Ok(70.0)).weather_reports(
        0,
        (105..=300).step_by(5),
        Ok(78.0),
    );
    assert_eq!(scenario.judged(300).verdict, Verdict::Safe, "78 closes nothing");
    let scenario = scenario.weather_reports(0, [305], Ok(81.0)).weather_reports(0, (310..=1000).step_by(5), Ok(78.0));
    assert_eq!(why(&scenario.judged(1000)), "78 is not down to 75 yet");
    let scenario = scenario.weather_reports(0, [1005], Ok(75.0)).weather_reports(0, (1010..=1065).step_by(5), Ok(79.0));
    assert_eq!(scenario.judged(1060).verdict, Verdict::Unsafe, "the dwell");
    assert_eq!(scenario.judged(1065).verdict, Verdict::Safe);
}

#[test]
fn what_was_never_good_enough_does_not_open() {
    let mut rule = limit(80.0, 0, true);
    rule.reopen.upper = Some(75.0);
    let scenario = Scenario::new(weather(vec![rule])).weather_reports(0, (0..=100).step_by(5), Ok(78.0));
    assert_eq!(scenario.judged(100).verdict, Verdict::Unsafe);
}

#[test]
fn tiers_suspend_before_they_close() {
    let mut mild = limit(60.0, 30, true);
    mild.response = Response::Suspend;
    let mut hint = limit(50.0, 0, true);
    hint.response = Response::Advise;
    let mut scenario = Scenario::new(weather(vec![limit(80.0, 60, true), mild, hint]));
    for index in 0..3 {
        scenario =
            scenario.weather_reports(index, (0..=100).step_by(5), Ok(40.0)).weather_reports(index, [105], Ok(65.0));
    }
    let judged = scenario.judged(105);
    assert_eq!((judged.verdict, judged.speaks_against), (Verdict::Safe, false));
    assert_eq!(judged.suspended[0].why, "65 is above 60");
    assert_eq!(judged.advisories[0].why, "65 is above 50");
    for index in 0..3 {
        scenario = scenario.weather_reports(index, [110], Ok(40.0));
    }
    assert_eq!(scenario.judged(110).suspended[0].clears_in_s, Some(30.0));
    assert_eq!(scenario.judged(130).verdict, Verdict::Unsafe, "silence closes");
}

#[test]
fn limits_that_only_advise_are_no_limits() {
    let mut hint = limit(50.0, 0, true);
    hint.response = Response::Advise;
    let scenario = Scenario::new(weather(vec![hint])).weather_reports(0, (0..=100).step_by(5), Ok(40.0));
    assert!(why(&scenario.judged(100)).contains("no safety monitor"));
}

#[test]
fn of_three_stations_that_vote_any_bad_one_decides_and_one_good_one_suffices() {
    for case in 0..27_u32 {
        let voter = || LimitRule { vote: Some("humidity".to_owned()), ..limit(80.0, 20, true) };
        let mut scenario = Scenario::new(weather(vec![voter(), voter(), voter()]));
        let words: Vec<u32> = (0..3).map(|i| case / 3_u32.pow(i) % 3).collect();
        for (index, kind) in words.iter().enumerate() {
            let value = [Ok(50.0), Ok(90.0), Err("timeout")][*kind as usize];
            scenario = scenario.weather_reports(index, (0..=60).step_by(5), value);
        }
        let is_safe = !words.contains(&1) && words.contains(&0);
        let expected = if is_safe { Verdict::Safe } else { Verdict::Unsafe };
        assert_eq!(scenario.judged(60).verdict, expected, "{words:?}");
        assert_eq!(scenario.judged(80).verdict, Verdict::Unsafe, "all silent: {words:?}");
    }
}

#[test]
fn a_value_has_as_many_decimals_as_show_that_it_is_not_its_limit() {
    let told = [(15.001, 15.0, 2), (15.2, 15.0, 2), (0.04, 0.0, 1), (15.0, 15.0, 2), (1e300, 15.0, 0)];
    let told = told.map(|(value, limit, decimals)| beyond(value, limit, decimals));
    assert_eq!(told[..4], ["15.001", "15.20", "0.04", "15.00"]);
    assert_eq!(told[4].len(), 301);
}

#[test]
fn the_sun_closes() {
    let mut scenario = one_monitor(0).monitor_reports(0, [10], word(true, 0));
    scenario.rules.sun_altitude_max_deg = Some(-1.0);
    assert_eq!(scenario.judged(10).reasons[0].input, "sun", "not computed is unsafe");
    for (altitude_deg, expected) in
        [(-1.0, Verdict::Safe), (-0.9, Verdict::Unsafe), (f64::NAN, Verdict::Unsafe), (-40.0, Verdict::Safe)]
    {
        scenario.history.sun.altitude_deg = Ok(altitude_deg);
        assert_eq!(scenario.judged(10).verdict, expected, "{altitude_deg}");
    }
    scenario.history.sun.altitude_deg = Ok(3.21);
    assert_eq!(why(&scenario.judged(10)), "altitude 3.2 deg, allowed are -1 deg");
    scenario.history.sun.altitude_deg = Ok(-0.996);
    assert_eq!(why(&scenario.judged(10)), "altitude -0.996 deg, allowed are -1 deg", "not its limit");
    assert_eq!(scenario.judged(10).time_to_safe_s, None);
    scenario.history.sun.low_in = Some(Duration::from_secs(600));
    assert_eq!(scenario.judged(10).time_to_safe_s, Some(600.0));
}

/// A random history of two monitors and three limits (the last optional), and a moment to judge it.
fn histories() -> impl Strategy<Value = (Vec<(usize, u64, u8)>, f64, u64)> {
    (proptest::collection::vec((0..5_usize, 0..120_u64, 0..10_u8), 0..120), 10.0..100.0_f64, 119..126_u64)
}

fn played(words: &[(usize, u64, u8)], upper: f64) -> Scenario {
    let rules = Rules {
        monitors: vec![monitor("a", 20), monitor("b", 0)],
        limits: vec![limit(upper, 20, true), limit(upper + 10.0, 40, true), limit(upper, 30, false)],
        ..Rules::default()
    };
    let mut words = words.to_vec();
    // In order of time, and dense enough that some histories are safe.
    for second in 0..120 {
        words.extend((0..5).map(|input| (input, second, 0)));
    }
    words.sort_by_key(|(_, second, _)| *second);
    words.into_iter().fold(Scenario::new(rules), |scenario, (input, second, kind)| match (input, kind) {
        (0 | 1, 9) => scenario.monitor_reports(input, [second], word(false, 0)),
        (0 | 1, 8) => scenario.monitor_is_silent(input, second),
        (0 | 1, _) => scenario.monitor_reports(input, [second], word(true, 0)),
        (_, 8) => scenario.weather_reports(input - 2, [second], Err("timeout")),
        (_, kind) => scenario.weather_reports(input - 2, [second], Ok(f64::from(kind) * 10.0 + 5.0)),
    })
}

proptest! {
    #[test]
    fn a_missing_input_never_makes_it_safe((words, upper, now) in histories(), input in 0..4_usize) {
        let mut scenario = played(&words, upper);
        match input {
            0 | 1 => scenario.history.monitors[input] = Record::default(),
            _ => scenario.history.limits[input - 2] = Record::default(),
        }
        prop_assert_eq!(scenario.judged(now).verdict, Verdict::Unsafe);
    }

    #[test]
    fn a_spoilt_input_never_makes_it_safer((words, upper, now) in histories(), input in 0..5_usize) {
        let scenario = played(&words, upper);
        let before = scenario.judged(now).verdict;
        let spoilt = match input {
            0 | 1 => scenario.monitor_is_silent(input, now),
            _ => scenario.weather_reports(input - 2, [now], Err("not a number")),
        };
        let after = spoilt.judged(now).verdict;
        prop_assert!(!(before == Verdict::Unsafe && after == Verdict::Safe));
        if input < 4 {
            prop_assert_eq!(after, Verdict::Unsafe);
        }
    }

    #[test]
    fn a_bad_reading_is_always_unsafe((words, upper, now) in histories(), input in 0..5_usize) {
        let scenario = played(&words, upper);
        let after = match input {
            0 | 1 => scenario.monitor_reports(input, [now], word(false, 0)),
            _ => scenario.weather_reports(input - 2, [now], Ok(1000.0)),
        };
        prop_assert_eq!(after.judged(now).verdict, Verdict::Unsafe);
    }

    #[test]
    fn ageing_beyond_the_allowed_age_is_unsafe((words, upper, _) in histories(), later in 136..5000_u64) {
        prop_assert_eq!(played(&words, upper).judged(later).verdict, Verdict::Unsafe);
    }

    #[test]
    fn a_raised_limit_never_makes_a_safe_sky_unsafe((words, upper, now) in histories(), more in 0.0..100.0_f64) {
        if played(&words, upper).judged(now).verdict == Verdict::Safe {
            prop_assert_eq!(played(&words, upper + more).judged(now).verdict, Verdict::Safe);
        }
    }

    #[test]
    fn a_safe_verdict_has_no_reasons_and_an_unsafe_one_has((words, upper, now) in histories()) {
        let judged = played(&words, upper).judged(now);
        prop_assert_eq!(judged.reasons.is_empty(), judged.verdict == Verdict::Safe);
        prop_assert_eq!(judged.inputs.len(), 5);
    }
}
