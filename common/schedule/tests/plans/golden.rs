//! Golden forecasts: each file of `schedules` has the expected result before each row.
//!
//! `// plan: STATUS FRAMES START END | WORDS`: times of the row's first begin and last end to the second, `-` where it
//! never runs; WORDS are part of its note. `// unsafe: FROM TO` is bad weather. The file explains the numbers.

use std::path::Path;

use schedule::plan::overheads::Sensor;
use schedule::plan::{PlannedNight, PlannedRow, Site, forecast};
use units::Utc;

/// Times of a file are as good as this, s: directions of slews are written to the hundredth of a degree.
const NEAR_S: f64 = 1.5;

/// The expected result of a row.
struct Expected<'a> {
    status: &'a str,
    frames: u32,
    span: Option<[Utc; 2]>,
    words: &'a str,
}

impl<'a> Expected<'a> {
    fn read(text: &'a str) -> Self {
        let (head, words) = text.split_once('|').unwrap_or((text, ""));
        let head: Vec<&str> = head.split_whitespace().collect();
        let [status, frames, start, end] = head.as_slice() else { panic!("expected STATUS FRAMES START END: {text}") };
        let span = (*start != "-").then(|| [start, end].map(|time| time.parse().unwrap()));
        Self { status, frames: frames.parse().unwrap(), span, words: words.trim() }
    }

    fn is(&self, row: &PlannedRow) -> bool {
        let near = match (self.span, row.span()) {
            (None, None) => true,
            (Some([start, end]), Some(span)) => {
                start.seconds_since(span.0).abs() < NEAR_S && end.seconds_since(span.1).abs() < NEAR_S
            }
            _ => false,
        };
        let status = serde_json::to_value(row.status).unwrap();
        near && status == self.status && row.frames == self.frames && row.note.contains(self.words)
    }
}

fn plan(text: &str) -> PlannedNight {
    plan_at(super::site(), text)
}

fn plan_at(mut site: Site, text: &str) -> PlannedNight {
    let bad = text.lines().filter_map(|line| line.strip_prefix("// unsafe:"));
    site.unsafe_spans = bad
        .map(|span| {
            let times: Vec<Utc> = span.split_whitespace().map(|time| time.parse().unwrap()).collect();
            (times[0], times[1])
        })
        .collect();
    forecast(super::rows(text), &mut site).unwrap()
}

#[test]
fn every_golden_plan_is_as_in_its_file() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/plans/schedules");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 5, "{files:?}");
    let mut differ = String::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let expected: Vec<Expected<'_>> =
            text.lines().filter_map(|line| line.strip_prefix("// plan:")).map(Expected::read).collect();
        let night = plan(&text);
        assert_eq!(expected.len(), night.rows.len(), "{}", file.display());
        for (expected, row) in expected.iter().zip(&night.rows) {
            if !expected.is(row) {
                let span = row.span().map(|(start, end)| format!("{start} {end}"));
                differ.push_str(&format!(
                    "{} line {}: {:?} {} {span:?} | {}\n",
                    file.display(),
                    row.line,
                    row.status,
                    row.frames,
                    row.note
                ));
            }
        }
    }
    assert!(differ.is_empty(), "not as expected:\n{differ}");
}

#[test]
fn a_plan_gives_altitudes_bytes_and_the_use_of_the_dark() {
    let text = r#"{"device_name": "main", "action_type": "object", "start_time": "2026-11-21 03:00:00",
        "end_time": "2026-11-21 05:00:00",
        "action_value": {"object": "x", "exptime": 58, "ra": 45.0, "dec": -24.6, "bin": 2, "n": 60}}"#;
    let night = plan(text);
    let row = &night.rows[0];
    assert!(row.is_whole(), "{row:?}");
    assert_eq!((row.frames, row.bytes), (60, 0.0), "no frame was archived, which would show the size of all");
    let mut site = super::site();
    let sensor = Sensor { size_px: [4096, 4096], bytes_per_px: 2.1, measured: 7 };
    site.overheads.sensors.insert("main".to_owned(), sensor);
    let bytes = plan_at(site, text).bytes();
    assert!((bytes / (60.0 * 2.1 * 2048.0 * 2048.0) - 1.0).abs() < 1e-12, "bin 2: {bytes}");
    let heights = row.heights.as_ref().unwrap();
    // ra 45 passes the zenith of latitude -24.6 at some 03:40 UTC.
    assert!(heights.max_deg > 89.0 && (60.0..85.0).contains(&heights.min_deg), "{heights:?}");
    assert!((heights.airmass_at_mid.unwrap() - 1.0).abs() < 0.05);
    let apart: Vec<f64> = heights.curve.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0)).collect();
    assert!(apart[..apart.len() - 1].iter().all(|step_s| (step_s - 300.0).abs() < 1.0), "{apart:?}");
    assert_eq!(heights.curve.last().unwrap().0, row.span().unwrap().1);
    // With the Sun at declination -19.7 deg it stands below -18 deg for 7.78 h at this latitude (cosine rule).
    assert!((27_700.0..28_200.0).contains(&night.dark_s), "{}", night.dark_s);
    assert!((night.dark_exposed_s - 60.0 * 58.0).abs() < 1e-3, "{}", night.dark_exposed_s);
    // Rows that need no sky reach into the day before and the night after.
    let calibration = |start: &str, end: &str| {
        format!(
            r#"{{"device_name": "main", "action_type": "calibration", "start_time": "{start}", "end_time": "{end}",
            "action_value": {{"exptime": [0], "n": [1]}}}}"#
        )
    };
    let (before, after) = ("2026-11-20 15:00:00", "2026-11-22 12:00:00");
    let longer =
        [calibration(before, "2026-11-20 16:00:00"), text.to_owned(), calibration("2026-11-21 06:00:00", after)];
    let longer = longer.map(|row| row.replace('\n', "")).join("\n");
    assert_eq!(plan(&longer).dark_s, night.dark_s);
    let span = row.span().unwrap();
    assert!(night.open_s > span.1.seconds_since(span.0) - 61.0 && night.closed.unwrap() > span.1);
}
