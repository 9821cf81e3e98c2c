//! Scenarios of stations that freeze, winds, and switches.

use contract::{Datum, DeviceState, Kind, Link, NoData};

use super::tests::{Scenario, at, device, limit, weather};
use super::*;
use crate::rules::Bounds;

fn state<F>(fields: F) -> DeviceState<F> {
    DeviceState {
        link: Link::Connected,
        busy: false,
        period_s: 5.0,
        poll_s: None,
        last_command: None,
        fields,
        readings: std::collections::BTreeMap::new(),
    }
}

/// A good monitor and one weather station that has these values at these seconds; all of its limits are advice.
fn station_reports(
    rules: Rules,
    values: impl Fn(u64) -> (f64, f64),
    seconds: impl Iterator<Item = u64>,
) -> (Rules, History) {
    use contract::device::observing_conditions::Fields;
    let mut history = History::new(&rules, at(0).sky);
    let wx = device(Kind::ObservingConditions, "wx");
    for second in seconds {
        let (wind_mps, humidity_percent) = values(second);
        let fields = Fields {
            wind_mps: Datum::Known(wind_mps),
            wind_from_deg: Datum::Known(200.0),
            humidity_percent: Datum::Known(humidity_percent),
            ..Fields::default()
        };
        history.observe_weather(&rules, &wx, &state(fields), 1.0, at(second));
    }
    (rules, history)
}

#[test]
fn a_frozen_station_is_reported_and_then_closes() {
    let rules = || Rules { frozen_after: Duration::from_secs(3600), ..weather(vec![limit(80.0, 0, true)]) };
    let minutes = |end: u64| (0..=end * 12).map(|step| step * 5);
    let (still, history) = station_reports(rules(), |_| (3.0, 40.0), minutes(61));
    let judged = judge(&still, &history, at(1810));
    assert!(judged.advisories.iter().any(|advice| advice.input == "wx/frozen"), "{judged:?}");
    let frozen = judge(&still, &history, at(3660));
    assert_eq!((frozen.verdict, frozen.reasons[0].input.as_str()), (Verdict::Unsafe, "wx/frozen"));
    let (alive, history) = station_reports(rules(), |second| (3.0 + second as f64 * 1e-6, 40.0), minutes(61));
    assert_eq!(judge(&alive, &history, at(3660)).verdict, Verdict::Safe);
}

#[test]
fn between_reopening_and_the_limit_it_is_near_the_limit() {
    let mut rule = limit(80.0, 0, true);
    rule.reopen = Bounds { upper: Some(70.0), lower: None };
    let scenario =
        Scenario::new(weather(vec![rule])).weather_reports(0, [0], Ok(60.0)).weather_reports(0, [5], Ok(75.0));
    let judged = scenario.judged(5);
    assert_eq!((judged.verdict, judged.advisories[0].why.as_str()), (Verdict::Safe, "75 is near its limit"));
}

#[test]
fn a_wind_sector_closes_nothing_and_names_where_not_to_point() {
    let sector = config::WindSector { above_mps: 8.0, half_width_deg: 60.0 };
    let rules = Rules { wind_sector: Some(sector), ..weather(vec![limit(80.0, 0, true)]) };
    let (rules, history) = station_reports(rules, |second| (second as f64, 40.0), [5, 10].into_iter());
    let judged = judge(&rules, &history, at(10));
    assert_eq!(judged.verdict, Verdict::Safe);
    assert!(judged.suspended.is_empty() && judged.avoid[0].contains(150.0) && !judged.avoid[0].contains(10.0));
}

#[test]
fn a_switch_is_an_input_like_any_other() {
    use contract::device::switch::Fields;
    let mut rule = limit(0.0, 0, true);
    rule.device = device(Kind::Switch, "ups");
    (rule.input, rule.parameter) = ("ups/GetSwitchValue1".to_owned(), "GetSwitchValue1".to_owned());
    (rule.bad, rule.reopen) = (Bounds { upper: None, lower: Some(0.5) }, Bounds { upper: None, lower: Some(0.5) });
    let rules = weather(vec![rule]);
    let verdict = |values: Vec<Datum<f64>>| {
        let mut history = History::new(&rules, at(0).sky);
        history.observe_switch(&rules, &device(Kind::Switch, "ups"), &state(Fields { values }), at(1));
        judge(&rules, &history, at(1)).verdict
    };
    assert_eq!(verdict(vec![Datum::Known(0.0), Datum::Known(1.0)]), Verdict::Safe);
    assert_eq!(verdict(vec![Datum::Known(1.0), Datum::Known(0.0)]), Verdict::Unsafe, "on battery");
    assert_eq!(verdict(vec![Datum::Known(1.0)]), Verdict::Unsafe, "there is no such switch");
    assert_eq!(verdict(vec![Datum::Known(1.0), Datum::missing(NoData::new("timeout", "2 s"))]), Verdict::Unsafe);
}

#[test]
fn a_site_whose_only_input_is_disabled_is_never_safe() {
    let site = |monitor: &str| {
        let text = format!(
            "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n{monitor}"
        );
        Rules::of(&config::parse(&text, std::path::Path::new("/")).unwrap())
    };
    let disabled = "[[safetymonitor]]\nname = \"m\"\nserver = \"a:1\"\ndisabled = \"the cable is cut\"\n";
    let dome = "[[dome]]\nname = \"roof\"\nserver = \"a:1\"\n";
    for configured in [disabled.to_owned(), format!("{disabled}{dome}"), dome.to_owned()] {
        let judged = Scenario::new(site(&configured)).judged(100_000);
        let no_input = judged.reasons.iter().filter(|reason| reason.input == "safety inputs").count();
        assert_eq!((judged.verdict, no_input), (Verdict::Unsafe, 1), "{configured}: {judged:?}");
    }
}
