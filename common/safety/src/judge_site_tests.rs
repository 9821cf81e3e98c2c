//! Scenarios of stations that freeze, winds, and switches.

use contract::{Datum, DeviceState, Kind, Link, NoData};

use super::tests::{Scenario, at, device, limit, weather, why};
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

/// A station's values, by their ASCOM names, and a limit on one of its parameters.
fn reads(limited: LimitRule, values: &[(&str, f64)], from_s: u64) -> Scenario {
    use contract::device::observing_conditions::Fields;
    let mut fields = serde_json::to_value(Fields::default()).unwrap();
    for (field, value) in values {
        fields[*field] = (*value).into();
    }
    let fields: Fields = serde_json::from_value(fields).unwrap();
    let mut scenario = Scenario::new(weather(vec![limited]));
    let (rules, wx) = (scenario.rules.clone(), device(Kind::ObservingConditions, "wx"));
    for second in (from_s..=from_s + 100).step_by(5) {
        scenario.history.observe_weather(&rules, &wx, &state(fields.clone()), 1.0, at(second));
    }
    scenario
}

fn limit_on(parameter: &str, upper: Option<f64>, lower: Option<f64>) -> LimitRule {
    let bounds = Bounds { upper, lower };
    LimitRule { parameter: parameter.to_owned(), bad: bounds, reopen: bounds, ..limit(80.0, 0, true) }
}

#[test]
fn the_code_of_a_broken_cloud_sensor_never_counts_as_a_cold_clear_sky() {
    for code in [-273.15, -178.0, -94.0, -70.5, -999.0, -998.0, 998.8, 1e9] {
        for limited in [limit_on("SkyTemperature", Some(-15.0), None), limit_on("RelativeSkyTemp", Some(-20.0), None)] {
            let judged = reads(limited, &[("sky_c", code), ("air_c", 10.0)], 0).judged(100);
            assert!(
                judged.verdict == Verdict::Unsafe && why(&judged).contains("is not possible"),
                "{code}: {judged:?}"
            );
        }
    }
    let clear = reads(limit_on("RelativeSkyTemp", Some(-20.0), None), &[("sky_c", -25.0), ("air_c", 10.0)], 0);
    assert_eq!(clear.judged(100).verdict, Verdict::Safe);
}

#[test]
fn no_parameter_is_believed_outside_of_its_range_on_whichever_side_its_limit_is() {
    use contract::device::observing_conditions::{parameters, physical_range};
    for name in parameters() {
        let range = physical_range(name).unwrap();
        for value in [range.low - 1.0, range.high + 1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for limited in [limit_on(name, Some(f64::MAX), None), limit_on(name, None, Some(f64::MIN))] {
                let mut scenario = Scenario::new(weather(vec![limited]));
                let rules = scenario.rules.clone();
                // As a difference of two values, or as a value.
                let fields = spoilt(name, value);
                let wx = device(Kind::ObservingConditions, "wx");
                scenario.history.observe_weather(&rules, &wx, &state(fields), 1.0, at(1));
                assert_eq!(scenario.judged(1).verdict, Verdict::Unsafe, "{name}: {value}");
            }
        }
    }
}

/// Fields in which a parameter has this value.
fn spoilt(name: &str, value: f64) -> contract::device::observing_conditions::Fields {
    let mut fields = contract::device::observing_conditions::Fields::default();
    let known = Datum::Known(value);
    match name {
        "CloudCover" => fields.cloud_percent = known,
        "DewPoint" => fields.dew_point_c = known,
        "Humidity" => fields.humidity_percent = known,
        "Pressure" => fields.pressure_hpa = known,
        "RainRate" => fields.rain_mm_per_h = known,
        "SkyBrightness" => fields.sky_lux = known,
        "SkyQuality" => fields.sky_mag_per_arcsec2 = known,
        "SkyTemperature" => fields.sky_c = known,
        "StarFWHM" => fields.star_fwhm_arcsec = known,
        "Temperature" => fields.air_c = known,
        "WindDirection" => fields.wind_from_deg = known,
        "WindGust" => fields.gust_mps = known,
        "WindSpeed" => fields.wind_mps = known,
        "RelativeSkyTemp" => (fields.sky_c, fields.air_c) = (Datum::Known(value / 2.0), Datum::Known(-value / 2.0)),
        "DewPointMargin" => {
            (fields.air_c, fields.dew_point_c) = (Datum::Known(value / 2.0), Datum::Known(-value / 2.0))
        }
        other => panic!("{other} has no field here"),
    }
    fields
}

#[test]
fn a_station_of_zeros_never_opens_a_dome() {
    let zeros = [
        ("humidity_percent", 0.0),
        ("wind_mps", 0.0),
        ("gust_mps", 0.0),
        ("rain_mm_per_h", 0.0),
        ("air_c", 0.0),
        ("dew_point_c", 0.0),
        ("pressure_hpa", 0.0),
        ("sky_c", 0.0),
    ];
    for (name, upper) in [("WindGust", 15.0), ("WindSpeed", 12.0), ("RainRate", 0.0)] {
        let judged = reads(limit_on(name, Some(upper), None), &zeros, 0).judged(100);
        assert!(judged.verdict == Verdict::Unsafe && why(&judged).contains("exactly 0"), "{name}: {judged:?}");
    }
    // What is left of a station without its thermometers is frozen.
    let mut scenario = reads(limit_on("WindGust", Some(15.0), None), &zeros[1..4], 0);
    assert_eq!(scenario.judged(100).verdict, Verdict::Safe);
    scenario.rules.frozen_after = Duration::from_secs(30);
    assert_eq!(scenario.judged(100).reasons[0].input, "wx/frozen");
}

#[test]
fn a_station_that_contradicts_itself_is_unsafe_whatever_of_it_is_limited_and_for_a_whole_dwell_after() {
    let wet = [("air_c", 3.0), ("dew_point_c", 9.0), ("wind_mps", 2.0)];
    for required in [true, false] {
        let limited = LimitRule { required, dwell: Duration::from_secs(60), ..limit_on("WindSpeed", Some(12.0), None) };
        let mut scenario = reads(limited, &[("air_c", 9.0), ("dew_point_c", 3.0), ("wind_mps", 2.0)], 0);
        assert_eq!(scenario.judged(100).verdict, Verdict::Safe);
        let (rules, wx) = (scenario.rules.clone(), device(Kind::ObservingConditions, "wx"));
        let mut observe = |second, values: &[(&str, f64)]| {
            let values = values.iter().copied().collect::<std::collections::BTreeMap<_, _>>();
            let known = |name: &str| values.get(name).map_or(Datum::default(), |value| Datum::Known(*value));
            let fields = contract::device::observing_conditions::Fields {
                air_c: known("air_c"),
                dew_point_c: known("dew_point_c"),
                wind_mps: known("wind_mps"),
                ..Default::default()
            };
            scenario.history.observe_weather(&rules, &wx, &state(fields), 1.0, at(second));
            scenario.judged(second)
        };
        let judged = observe(105, &wet);
        assert!(judged.verdict == Verdict::Unsafe && why(&judged).contains("contradicts itself"), "{judged:?}");
        let dry = [("air_c", 9.0), ("dew_point_c", 3.0), ("wind_mps", 2.0)];
        for second in (110..=160).step_by(5) {
            assert_eq!(observe(second, &dry).verdict, Verdict::Unsafe, "{second}, required {required}");
        }
        observe(165, &dry);
        assert_eq!(observe(170, &dry).verdict, Verdict::Safe, "required {required}");
    }
}

#[test]
fn a_value_beyond_its_limit_is_named_as_that_also_where_the_station_contradicts_itself() {
    let values = [("air_c", 3.0), ("dew_point_c", 9.0), ("wind_mps", 22.0)];
    let judged = reads(limit_on("WindSpeed", Some(12.0), None), &values, 0).judged(100);
    assert_eq!(why(&judged), "22 is above 12");
}
