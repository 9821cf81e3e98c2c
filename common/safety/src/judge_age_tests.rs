use contract::Kind;

use super::tests::{Scenario, at, device, limit, monitor, one_monitor, weather, why};
use super::*;

/// A state of a safety monitor in which `IsSafe` was read so long before.
fn monitor_state(
    age_s: f64,
    gapless_safe_s: f64,
    poll_s: f64,
) -> contract::DeviceState<contract::device::safety_monitor::Fields> {
    serde_json::from_value(serde_json::json!({
        "link": {"is": "connected"}, "busy": false, "period_s": poll_s.min(5.0), "poll_s": poll_s,
        "fields": {"is_safe": true, "gapless_safe_s": gapless_safe_s},
        "readings": {"IsSafe": {"value": true, "at_utc": "2026-11-21T03:00:00Z", "age_s": age_s}},
    }))
    .unwrap()
}

#[test]
fn an_old_reading_in_a_new_state_is_old_and_its_record_with_it() {
    let mut scenario = one_monitor(60);
    let m = device(Kind::SafetyMonitor, "m");
    let rules = scenario.rules.clone();
    let mut observe = |second, age_s, gapless_s| {
        scenario.history.observe_monitor(&rules, &m, &monitor_state(age_s, gapless_s, 1.0), at(second));
        scenario.judged(second)
    };
    assert_eq!(observe(100, 0.0, 3600.0).verdict, Verdict::Safe);
    // Its node was stalled for 12 s and goes on with what it had read.
    let stalled = observe(112, 12.0, 3600.0);
    assert_eq!(stalled.verdict, Verdict::Unsafe);
    assert!(why(&stalled).starts_with("stale: last received 12.0 s ago"), "{stalled:?}");
    // The state comes again and again, and the reading grows no younger.
    assert_eq!(observe(113, 13.0, 3600.0).verdict, Verdict::Unsafe);
    // A fresh reading after that has no record to show.
    assert_eq!(why(&observe(114, 0.0, 0.0)), "good for 0.0 of 1.0 min");
    for age_s in [-1.0, f64::NAN, f64::INFINITY] {
        // NaN and infinity are null in JSON, and an age that is none is no age.
        let mut state = monitor_state(0.0, 3600.0, 1.0);
        state.readings.get_mut("IsSafe").unwrap().age_s = Some(age_s);
        scenario.history.observe_monitor(&rules, &m, &state, at(200));
        assert_eq!(scenario.judged(200).verdict, Verdict::Unsafe, "{age_s}");
    }
}

#[test]
fn a_monitor_whose_age_nobody_set_is_judged_by_its_own_period() {
    let judged = |by_period, poll_s, now| {
        let mut rule = monitor("m", 0);
        rule.by_period = by_period;
        let mut scenario = Scenario::new(Rules { monitors: vec![rule], ..Rules::default() });
        let rules = scenario.rules.clone();
        scenario.history.observe_monitor(
            &rules,
            &device(Kind::SafetyMonitor, "m"),
            &monitor_state(0.0, 0.0, poll_s),
            at(100),
        );
        scenario.judged(now).verdict
    };
    assert_eq!(judged(true, 5.0, 107), Verdict::Safe, "asked each 5 s");
    assert_eq!((judged(true, 5.0, 125), judged(true, 5.0, 126)), (Verdict::Safe, Verdict::Unsafe));
    assert_eq!((judged(true, 1.0, 105), judged(true, 1.0, 106)), (Verdict::Safe, Verdict::Unsafe));
    assert_eq!(
        (judged(true, 1e9, 160), judged(true, 1e9, 161)),
        (Verdict::Safe, Verdict::Unsafe),
        "no period is that long"
    );
    assert_eq!(judged(false, 5.0, 106), Verdict::Unsafe, "somebody set 5 s");
}

#[test]
fn a_limit_counts_from_when_its_value_was_read() {
    let rules = weather(vec![limit(80.0, 0, true)]);
    let mut history = History::new(&rules, at(0).sky);
    let wx = device(Kind::ObservingConditions, "wx");
    let mut judged = |second, age_s: f64| {
        let state: contract::DeviceState<contract::device::observing_conditions::Fields> = {
            let mut fields = serde_json::to_value(contract::device::observing_conditions::Fields::default()).unwrap();
            fields["humidity_percent"] = 40.0.into();
            serde_json::from_value(serde_json::json!({
                "link": {"is": "connected"}, "busy": false, "period_s": 5.0, "fields": fields,
                "readings": {"Humidity": {"value": 40.0, "unit": "%", "at_utc": "2026-11-21T03:00:00Z", "age_s": age_s}},
            }))
            .unwrap()
        };
        history.observe_weather(&rules, &wx, &state, 1.0, at(second));
        judge(&rules, &history, at(second)).verdict
    };
    assert_eq!(
        (judged(100, 0.5), judged(110, 10.5), judged(116, 16.5)),
        (Verdict::Safe, Verdict::Safe, Verdict::Unsafe)
    );
    assert_eq!(judged(117, 0.2), Verdict::Safe);
}
