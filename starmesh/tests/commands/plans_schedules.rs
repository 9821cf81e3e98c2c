//! `starmesh plan` as a person calls it: a table, curves, the rows that will not run, JSON; many files; and no forecast
//! of a bad file.

use std::fs;

use crate::command::{number, starmesh};

const SITE: &str = concat!(
    include_str!("../../../common/config/tests/paranal.toml"),
    r#"[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
[[camera]]
name = "main"
server = "10.0.0.5:11111"
[[dome]]
name = "dome"
server = "10.0.0.5:11111"
"#
);

fn row(value: &str, hours: [&str; 2], day: u32) -> String {
    let [start, end] = hours;
    format!(
        "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {value}, \
         \"start_time\": \"2026-11-{day} {start}\", \"end_time\": \"2026-11-{day} {end}\"}}\n"
    )
}

#[test]
fn a_night_a_folder_of_nights_and_a_bad_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    fs::write(file("observatory.toml"), SITE).unwrap();
    let good = r#"{"object": "good", "exptime": 60, "ra": 55, "dec": -24.6, "n": 20}"#;
    let day = r#"{"object": "day", "exptime": 60, "ra": 55, "dec": -24.6, "n": 20}"#;
    let night = |n: u32| [row(good, ["03:00:00", "04:00:00"], n), row(day, ["15:00:00", "16:00:00"], n)].concat();
    fs::write(file("night.jsonl"), night(21)).unwrap();
    let plan = |more: &[&str]| {
        let given = [vec!["plan"], more.to_vec()].concat();
        starmesh(given)
    };

    let output = plan(&[&file("night.jsonl")]);
    assert!(output.success, "{}\n{}", output.out, output.err);
    for message in [
        "object  good    main    11-21 03:00:00",
        "20/20",
        "line 2, object day will not run: its window passed; the Sun stands above 0 deg over its whole window",
        "20 frames, size not known yet; open for",
        "measured, medians: none",
        "assumed: open 60.00 s",
        "frames of main: none is archived, so that the size of their files is not known",
    ] {
        assert!(output.out.contains(message), "{message}: {}", output.out);
    }
    let curve = output.out.lines().find(|line| line.starts_with("good ")).unwrap();
    assert!(curve.chars().filter(|c| ('▁'..='█').contains(c)).count() > 60, "{curve}");

    let json = plan(&[&file("night.jsonl"), "--json", "--unsafe", "2026-11-21T03:10:00Z..2026-11-21T03:30:00Z"]);
    assert!(json.success, "{}", json.err);
    let lines = json.json();
    assert_eq!(lines.len(), 4, "overheads, two rows, the night");
    assert!(lines[0]["overheads"].as_array().unwrap().iter().all(|figure| figure["measured"] == 0));
    assert_eq!(
        (&lines[1]["frames"], &lines[1]["whole"], &lines[1]["status"]),
        (&20.into(), &true.into(), &"finished".into())
    );
    assert_eq!(lines[1]["runs_utc"].as_array().unwrap().len(), 2, "interrupted once: {}", lines[1]);
    assert!(lines[1]["altitude_curve"].as_array().unwrap().len() > 8 && number(&lines[1], "airmass_at_mid") < 1.1);
    assert!(lines[2]["status"] == "skipped" && lines[2]["start_utc"].is_null(), "{}", lines[2]);
    assert!(number(&lines[3], "dark_exposed_s") == 1200.0 && lines[3]["rows_at_risk"] == 1, "{}", lines[3]);
    let refused = plan(&[&file("night.jsonl"), "--unsafe", "tonight"]);
    assert!(!refused.success && refused.err.contains("expected FROM..TO"), "{}", refused.err);

    fs::create_dir(file("nights")).unwrap();
    for n in 21..24 {
        fs::write(file(&format!("nights/{n}.jsonl")), night(n)).unwrap();
    }
    let config = file("observatory.toml");
    let output = plan(&[&file("nights"), "--config", &config]);
    let sum = "3 schedules: 60 frames, size not known yet; open for";
    assert!(output.success && output.out.contains(sum), "{}\n{}", output.out, output.err);
    assert_eq!(output.out.matches("object day will not run").count(), 3);

    fs::write(file("nights/22.jsonl"), row(r#"{"object": "x", "exptime": -1}"#, ["03:00:00", "04:00:00"], 22)).unwrap();
    let output = plan(&[&file("nights"), "--config", &config]);
    assert!(
        !output.success && output.err.contains("22.jsonl is not a valid schedule: 1 errors; there is no plan"),
        "{}",
        output.err
    );
    assert!(
        output.out.contains("22.jsonl:1:93: error: exptime: expected") && !output.out.contains("GB"),
        "{}",
        output.out
    );
    let output = plan(&[&file("night.jsonl"), "--archive", &file("none.db")]);
    assert!(!output.success && output.err.contains("cannot open the database"), "{}", output.err);
}
