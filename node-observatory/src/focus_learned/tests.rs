use contract::CommandId;

use super::*;

/// A run `hours` after the first, through a filter whose offset is zero by the wheel.
fn run(hours: f64, filter: Option<&str>, position: f64, temperature_c: f64) -> FocusRun {
    let sample = r#"{"id": "", "camera": "cam", "focuser": "f", "filter_offset": 0, "night": "20261121",
        "started_utc": "2026-11-21T00:00:00Z", "outcome": "focused", "start_position": 0, "operator": "hfd",
        "value_label": "", "points": []}"#;
    let run: FocusRun = serde_json::from_str(sample).unwrap();
    FocusRun {
        id: CommandId(format!("{hours} {filter:?}")),
        started_utc: run.started_utc.plus_seconds(3600.0 * hours),
        filter: filter.map(str::to_owned),
        wheel_offset: filter.map(|_| 0),
        best_position: Some(position),
        best_position_error: Some(3.0),
        stored_position: Some(position),
        critical_zone: Some(120.0),
        temperature_c: Some(temperature_c),
        ..run
    }
}

#[test]
fn the_newest_run_gives_the_best_position_and_ten_runs_how_it_follows_the_temperature() {
    let mut learned = LearnedFocus::default();
    assert_eq!(learned.best("f", Some(10.0)), None);
    for n in 0..9 {
        let temperature_c = 12.0 - f64::from(n);
        assert!(learned.learn(&run(f64::from(n), None, 5000.0 - 15.0 * temperature_c, temperature_c)));
    }
    // 4 C: nine runs do not show the effect of temperature yet.
    assert_eq!((learned.best("f", Some(0.0)), learned.model("f")), (Some(5000.0 - 60.0), None));
    assert!(learned.learn(&run(9.0, None, 5000.0 - 45.0, 3.0)));
    assert!(!learned.learn(&run(9.0, None, 1.0, 3.0)), "known already");
    let model = learned.model("f").unwrap();
    assert!((model.steps_per_c.value + 15.0).abs() < 0.01, "{model:?}");
    assert!((learned.best("f", Some(0.0)).unwrap() - 5000.0).abs() < 0.5);
    assert_eq!(learned.best("f", None), Some(4955.0), "without a thermometer nothing moves");
    assert_eq!(learned.best("other", Some(0.0)), None);
}

#[test]
fn a_coefficient_that_is_not_proven_moves_nothing() {
    let mut learned = LearnedFocus::default();
    // Seeing and chance: 40 steps of scatter that lean a little with the temperature.
    let leans = [30.0, -45.0, 38.0, -20.0, -41.0, 44.0, 12.0, -33.0, 50.0, 9.0, -12.0, 35.0];
    for (n, steps) in leans.into_iter().enumerate() {
        learned.learn(&run(n as f64, None, 5000.0 + steps, 0.6 * n as f64));
    }
    assert_eq!((learned.runs("f").len(), learned.model("f")), (12, None));
    assert_eq!(learned.best("f", Some(0.0)), Some(5035.0), "where the newest run found it");
}

#[test]
fn what_is_published_is_taken_over_whole() {
    let mut learned = LearnedFocus::default();
    learned.learn(&run(0.0, Some("V"), 1000.0, 10.0));
    let mut other = LearnedFocus::default();
    other.learn(&run(5.0, Some("B"), 1.0, 1.0));
    assert!(other.adopt(learned.0.clone()));
    assert_eq!(other, learned);
    assert!(!other.adopt(learned.0.clone()), "nothing new");
    assert!(!other.adopt(FocusLearned::default()), "a commander that has just been installed teaches nothing");
    assert_eq!(other, learned);
}

#[test]
fn runs_through_two_filters_teach_what_the_wheel_does_not_report() {
    let mut learned = LearnedFocus::default();
    let mut learn = |hours, filter, position| assert!(learned.learn(&run(hours, Some(filter), position, 10.0)));
    learn(0.0, "V", 1000.0);
    learn(0.3, "B", 1040.0);
    learn(24.0, "V", 1010.0);
    learn(30.0, "R", 1005.0);
    learn(48.0, "V", 1020.0);
    learn(49.0, "B", 1062.0);
    let offset = |filter| learned.offset("f", filter, 0);
    assert_eq!((offset("V"), offset("B")), (0, 41));
    assert_eq!(offset("R"), 0, "its only run is far in time from any other");
    assert_eq!(learned.offset("f", "B", 45), 45, "the wheel is right within the errors");
    // The newest run is one through B: without its offset it gives the best position.
    assert_eq!(learned.best("f", Some(10.0)), Some(1021.0));
}

#[test]
fn one_bad_run_teaches_neither_offset_nor_coefficient_nor_zone() {
    // The bad run may come first, last or between.
    for bad in 0..12 {
        let mut learned = LearnedFocus::default();
        // One run more than through B, so that offsets count from V.
        learned.learn(&run(-48.0, Some("V"), 5000.0 - 15.0 * 14.0, 14.0));
        for n in 0..12 {
            let (hours, temperature_c) = (24.0 * f64::from(n), 12.0 - f64::from(n));
            let off = if n == bad { 900.0 } else { f64::from(n % 3) };
            let best = 5000.0 - 15.0 * temperature_c;
            learned.learn(&run(hours, Some("V"), best, temperature_c));
            let blue = run(hours + 0.3, Some("B"), best + 40.0 + off, temperature_c);
            let zone = if n == bad { 1e6 } else { 120.0 };
            learned.learn(&FocusRun { critical_zone: Some(zone), ..blue });
        }
        let offset = learned.offset("f", "B", 0);
        assert!((offset - 41).abs() <= 1, "bad {bad}: {offset}");
        let model = learned.model("f").unwrap();
        assert!((model.steps_per_c.value + 15.0).abs() < 0.5, "bad {bad}: {model:?}");
        assert_eq!(learned.critical_zone("f"), Some(120.0), "bad {bad}");
    }
    // If two pairs do not agree, nobody knows which one is right.
    let mut learned = LearnedFocus::default();
    for (hours, filter, position) in [(0.0, "V", 1000.0), (0.3, "B", 1040.0), (24.0, "V", 1000.0), (24.3, "B", 1900.0)]
    {
        learned.learn(&run(hours, Some(filter), position, 10.0));
    }
    assert_eq!(learned.offset("f", "B", 0), 0);
}

#[test]
fn a_run_that_found_nothing_or_is_not_to_be_stored_teaches_nothing() {
    let mut learned = LearnedFocus::default();
    assert!(!learned.learn(&FocusRun { outcome: FocusOutcome::Failed, ..run(0.0, None, 1.0, 1.0) }));
    assert!(!learned.learn(&FocusRun { stored_position: None, ..run(0.0, None, 1.0, 1.0) }));
    assert_eq!(learned, LearnedFocus::default());
}

#[test]
fn only_the_newest_runs_are_remembered_and_a_file_gives_them_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("focus-x.json");
    let mut learned = LearnedFocus::default();
    for n in 0..REMEMBERED + 20 {
        learned.learn(&run(n as f64, None, n as f64, 1.0));
    }
    assert_eq!(learned.runs("f").len(), REMEMBERED);
    assert_eq!(learned.runs("f")[0].position, 20.0);
    std::fs::write(&path, serde_json::to_vec(&learned).unwrap()).unwrap();
    assert_eq!(LearnedFocus::read(&path), learned);
    std::fs::write(&path, "half a fi").unwrap();
    assert_eq!(LearnedFocus::read(&path), LearnedFocus::default());
    assert_eq!(LearnedFocus::read(&folder.path().join("none")), LearnedFocus::default());
}
