//! `starmesh check` of wrong schedules: each with its line, what is wrong, and what would be right; none panics, and
//! none is taken that cannot run.

use std::fs;

use crate::command::starmesh;
use crate::wrong::FOREIGN;

const SITE: &str = concat!(
    include_str!("../../../common/config/tests/paranal.toml"),
    r#"[[telescope]]
name = "mount"
server = "10.0.0.5:11111"
limits = { altitude_min_deg = 20 }
[[camera]]
name = "main"
server = "10.0.0.5:11111"
temperature_c = -20
[[camera]]
name = "guide"
server = "10.0.0.5:11111"
number = 1
filterwheel = "none"
[[filterwheel]]
name = "wheel"
server = "10.0.0.5:11111"
filters = ["g", "r"]
"#
);

/// A row of a camera; it is on line 2 of its file.
fn row(action: &str, value: &str, window: &str) -> String {
    let (start, end) = window.split_once("..").unwrap();
    format!(
        "// night\n{{\"device_name\": \"main\", \"action_type\": \"{action}\", \"action_value\": {value}, \
         \"start_time\": \"{start}\", \"end_time\": \"{end}\"}}\n"
    )
}

const NIGHT: &str = "2026-11-21 03:00:00..2026-11-21 05:00:00";

/// Parameters of an `object` row that refuse it.
const OBJECTS: &[(&str, &[&str])] = &[
    (r#"{"object": "x", "exptime": 0, "ra": 50, "dec": -30}"#, &["exptime", "0 s takes no light"]),
    (r#"{"object": "x", "exptime": -5, "ra": 50, "dec": -30}"#, &["exptime", "0 to 86400 s"]),
    (r#"{"object": "x", "exptime": "30 s", "ra": 50, "dec": -30}"#, &["exptime", "expected a number"]),
    (r#"{"object": "x", "exptime": "30", "ra": 50, "dec": -30}"#, &["exptime", "leave the quotes away: 30"]),
    (r#"{"object": "x", "exptime": null, "ra": 50, "dec": -30}"#, &["exptime"]),
    (r#"{"object": "x", "exptime": 1e9, "ra": 50, "dec": -30}"#, &["exptime", "86400"]),
    (r#"{"object": "x", "ra": 50, "dec": -30}"#, &["exptime", "missing"]),
    (r#"{"exptime": 30, "ra": 50, "dec": -30}"#, &["object", "missing"]),
    (r#"{"object": 5, "exptime": 30, "ra": 50, "dec": -30}"#, &["object", "a text"]),
    (r#"{"object": "x", "exptime": 30, "n": 0, "ra": 50, "dec": -30}"#, &["n:", "0 frames", "1 or more"]),
    (r#"{"object": "x", "exptime": 30, "n": 2.5, "ra": 50, "dec": -30}"#, &["n:", "whole number"]),
    (r#"{"object": "x", "exptime": 30, "n": "ten", "ra": 50, "dec": -30}"#, &["n:", "whole number"]),
    (
        r#"{"object": "x", "exptime": 30, "ra": "03:20:00", "dec": -30}"#,
        &["ra:", "ra is in degrees", "50.00000 if these are hours"],
    ),
    (r#"{"object": "x", "exptime": 30, "ra": "03h20m00s", "dec": -30}"#, &["ra:", "50.00000 if these are hours"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": "-30:30:00"}"#, &["dec:", "dec is in degrees: -30.50000"]),
    (r#"{"object": "x", "exptime": 30, "ra": "50.5", "dec": -30}"#, &["ra:", "leave the quotes away: 50.5"]),
    (r#"{"object": "x", "exptime": 30, "ra": 500, "dec": -30}"#, &["ra:", "-360 to 360 deg"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -95}"#, &["dec:", "-90 to 90 deg"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50}"#, &["dec"]),
    (r#"{"object": "x", "exptime": 30, "alt": 50}"#, &["az"]),
    (r#"{"object": "x", "exptime": 30, "alt": -5, "az": 10}"#, &["alt:", "0 to 90 deg"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "alt": 50, "az": 10}"#, &["alt", "not both"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "filter": "G"}"#, &["filter", "did you mean \"g\"?"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "filter": 1}"#, &["filter", "a text"]),
    (
        r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "guidng": true}"#,
        &["guidng", "did you mean \"guiding\"?"],
    ),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "guiding": "yes"}"#, &["guiding", "true or false"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "bin": 0}"#, &["bin", "1 to 16"]),
    (r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30, "subframe_width": 100}"#, &["subframe_height"]),
    (r#"{"object": "x", "exptime": 30, "lookup_name": "TLE"}"#, &["tle"]),
    (r#"{"object": "x", "exptime": 30, "lookup_name": "TLE", "tle": "1 nonsense"}"#, &["tle"]),
    (r#"["x", 30]"#, &["action_value", "expected an object"]),
    (r#""x""#, &["action_value", "expected an object"]),
];

/// Rows of other actions.
const ACTIONS: &[(&str, &str, &[&str])] = &[
    ("objekt", "{}", &["action_type", "did you mean \"object\"?"]),
    ("observe", "{}", &["action_type"]),
    ("calibration", r#"{"exptime": [0, 30], "n": [10]}"#, &["n", "as many"]),
    ("calibration", r#"{"exptime": [0, 30], "n": [10, 0]}"#, &["n", "1 to 1000000"]),
    ("calibration", r#"{"exptime": [], "n": []}"#, &["exptime"]),
    ("calibration", r#"{"exptime": 30, "n": 5}"#, &["exptime", "list"]),
    ("flats", r#"{"filter": ["g"], "n": [0]}"#, &["n", "1 to 1000000"]),
    ("flats", r#"{"filter": ["g", "r"], "n": [5]}"#, &["n"]),
    ("flats", r#"{"filter": ["z"], "n": [5]}"#, &["filter", "z"]),
    ("autofocus", r#"{"exptime": 0}"#, &["exptime", "0 s takes no light"]),
    ("autofocus", r#"{"exptime": 3, "search_range": "wide"}"#, &["search_range"]),
    ("calibrate_guiding", r#"{"exptime": 0}"#, &["exptime", "0 s takes no light"]),
    ("calibrate_guiding", r#"{"pulse_time": 5}"#, &["pulse_time", "10 to 60000 ms"]),
    ("close", r#"{"at": "dawn"}"#, &["at", "none"]),
];

/// Whole files: bytes, line, words.
fn files() -> Vec<(Vec<u8>, usize, Vec<&'static str>)> {
    let good = row("object", r#"{"object": "x", "exptime": 30, "ra": 50, "dec": -30}"#, NIGHT);
    let changed = |from: &str, to: &str| good.replace(from, to).into_bytes();
    let wide: Vec<u8> = format!("\u{feff}{good}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    vec![
        (Vec::new(), 1, vec!["no rows"]),
        (b"// only a comment\n".to_vec(), 1, vec!["no rows"]),
        (changed("\"main\"", "\"mian\""), 2, vec!["device_name", "did you mean \"main\"?"]),
        (changed("\"main\"", "7"), 2, vec!["device_name", "expected a text"]),
        (changed("\"device_name\": \"main\", ", ""), 2, vec!["device_name is missing"]),
        (changed("\"action_type\": \"object\", ", ""), 2, vec!["action_type is missing"]),
        (changed("start_time", "starttime"), 2, vec!["start_time"]),
        (changed("2026-11-21 03:00:00", "21.13.2026 03:00"), 2, vec!["start_time", "is no time"]),
        (changed("2026-11-21 03:00:00", "2026-02-30 03:00:00"), 2, vec!["start_time", "is no time"]),
        (changed("2026-11-21 03:00:00", "2026-11-21 25:00:00"), 2, vec!["start_time", "is no time"]),
        (changed("05:00:00", "02:00:00"), 2, vec!["end_time", "is not after"]),
        (changed("05:00:00", "03:00:00"), 2, vec!["end_time", "is not after"]),
        (changed("}\n", "\n"), 2, vec!["no JSON"]),
        (changed("\"exptime\": 30", "\"exptime\": NaN"), 2, vec!["no JSON", "NaN is no number"]),
        (changed("\"exptime\": 30", "\"exptime\": True"), 2, vec!["no JSON", "small letters"]),
        (changed("\"x\"", "'x'"), 2, vec!["no JSON", "double quotes"]),
        (changed("\"exptime\": 30,", "\"exptime\": 30,,"), 2, vec!["no JSON"]),
        (changed("{\"device_name\"", "[{\"device_name\""), 2, vec!["one after another"]),
        (changed("\"exptime\": 30", "\"exptime\": 30, \"exptime\": 60"), 2, vec!["exptime", "twice"]),
        (b"device_name,action_type\nmain,object\n".to_vec(), 1, vec!["no JSON"]),
        (b"- device_name: main\n".to_vec(), 1, vec!["no JSON"]),
        (
            [good.as_bytes(), b"{\"object\": \"Andr\xe9\"}\n"].concat(),
            3,
            vec!["not UTF-8", "Latin-1", "save the file as UTF-8"],
        ),
        (wide, 1, vec!["UTF-16", "save it as UTF-8"]),
    ]
}

#[test]
fn every_wrong_schedule_is_refused_with_its_line_and_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    let (site, file) = (folder.path().join("observatory.toml"), folder.path().join("night.jsonl"));
    fs::write(&site, SITE.replace("filterwheel = \"none\"\n", "")).unwrap();
    let mut cases: Vec<(Vec<u8>, usize, Vec<&str>)> = files();
    cases.extend(OBJECTS.iter().map(|(value, words)| (row("object", value, NIGHT).into_bytes(), 2, words.to_vec())));
    cases.extend(ACTIONS.iter().map(|(name, value, words)| (row(name, value, NIGHT).into_bytes(), 2, words.to_vec())));
    let mut failed = Vec::new();
    for (bytes, line, words) in &cases {
        fs::write(&file, bytes).unwrap();
        let output = starmesh(["check", &file.display().to_string(), "--at", "2026-11-20T12:00:00Z"]);
        let all = format!("{}{}", output.out, output.err);
        let place = [format!("night.jsonl:{line}:"), format!("line {line}:")];
        let message = all.lines().find(|message| place.iter().any(|place| message.contains(place)));
        let is_reported = message.is_some_and(|message| words.iter().all(|word| message.contains(word)));
        let foreign = FOREIGN.iter().find(|word| all.contains(**word));
        if output.success || !is_reported || foreign.is_some() {
            failed.push(format!("{}\nline {line}, {words:?}, {foreign:?}:\n{all}", String::from_utf8_lossy(bytes)));
        }
    }
    assert!(failed.is_empty(), "{} of {}:\n\n{}", failed.len(), cases.len(), failed.join("\n\n"));
}

#[test]
fn what_the_sky_does_is_reported_and_refuses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (site, file) = (folder.path().join("observatory.toml"), folder.path().join("night.jsonl"));
    fs::write(&site, SITE.replace("filterwheel = \"none\"\n", "")).unwrap();
    let check = |value: &str, window: &str| {
        fs::write(&file, row("object", value, window)).unwrap();
        let output = starmesh(["check", &file.display().to_string(), "--at", "2026-11-20T12:00:00Z"]);
        assert!(output.success, "{}{}", output.out, output.err);
        output.out
    };
    let message = check(r#"{"object": "Polaris", "exptime": 30, "ra": 37.95, "dec": 89.26}"#, NIGHT);
    assert!(message.contains("dec: Polaris never rises at this site") && message.contains("23.9 deg"), "{message}");
    assert!(!message.contains("give it another time"), "{message}");
    let message = check(r#"{"object": "M31", "exptime": 30, "ra": 10.68, "dec": 50}"#, NIGHT);
    assert!(message.contains("M31 never rises above 20 deg at this site: 15.4 deg at the highest"), "{message}");
    let message = check(r#"{"object": "x", "exptime": 30, "lookup_name": "Vega"}"#, NIGHT);
    assert!(message.contains("not checked: altitude, Sun and Moon of line 2") && message.contains("Vega"), "{message}");
    // Once the observatory node has found the name, it is checked as any other.
    fs::create_dir(folder.path().join("data")).unwrap();
    let found =
        r#"{"found": {"vega": {"fixed": {"ra_deg": 279.23, "dec_deg": 78.78, "pm_ra_mas": 0, "pm_dec_mas": 0}}}}"#;
    fs::write(folder.path().join("data/names-callisto.json"), found).unwrap();
    let message = check(r#"{"object": "x", "exptime": 30, "lookup_name": "Vega"}"#, NIGHT);
    assert!(message.contains("x never rises at this site") && !message.contains("not checked: altitude"), "{message}");
}
