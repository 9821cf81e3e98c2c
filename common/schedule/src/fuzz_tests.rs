//! Any content of the schedule file gives rows that make sense, or a message with a line; never a panic.

#[path = "../../../tests/fuzz/spoilt.rs"]
mod spoilt;

use proptest::prelude::*;

use crate::parse;

const GOOD: &[&str] = &[
    r#"// a night
{"device_name": "cam", "action_type": "open", "action_value": {}, "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21T05:00:00+02:00"}
{"device_name": "cam", "action_type": "object", "action_value": {"object": "x", "exptime": 10.5, "ra": 1.5, "dec": -2,
  "filter": "V", "n": 10, "bin": 2, "guiding": true, "pointing": true, "subframe_width": 100, "subframe_height": 50,
  "subframe_center_x": 0.2, "metadata": {"program": "p1", "visit": 3}},
 "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21T03:00:00.000Z"}
"#,
    r#"{"device_name": "cam", "action_type": "calibration", "action_value": {"exptime": [0, 30], "n": [10, 5], "execute_parallel": true}, "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21 04:00:00", "completed": false, "status": "pending"}
{"device_name": "guide-cam", "action_type": "close", "action_value": null, "start_time": "2026-11-21 02:00:00", "end_time": "2026-11-21 09:00:00.5"}"#,
    r#"{"device_name": "cam", "action_type": "autofocus", "action_value": {"exptime": 3}, "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21 02:00:00"}
{"device_name": "cam", "action_type": "pointing_model", "action_value": {}, "start_time": "2026-11-21 01:00:00", "end_time": "2026-11-21 02:00:00"}
"#,
];

const WORDS: &[&str] = &[
    "{",
    "}",
    "[",
    "]",
    "\"",
    ",",
    ":",
    "\\",
    "//",
    "\n",
    "\r\n",
    "\u{feff}",
    "\0",
    "null",
    "NaN",
    "1e999",
    "-0",
    "99999999999999999999",
    "\"a\":",
    "[[",
    "{\"a\":",
    "\\u0000",
    "\\ud800",
    "é",
    "2026-11-21 25:61:61",
    "9999-12-31 23:59:60",
    "\"n\"",
    "\"exptime\"",
    "\"ra\"",
    "-1",
    "true",
    "\"device_name\"",
];

proptest! {
    #![proptest_config(spoilt::config(3000))]

    #[test]
    fn any_text_is_a_schedule_or_refused_with_a_reason(text in spoilt::spoilt(GOOD, WORDS)) {
        let cameras = ["cam".parse().unwrap(), "guide-cam".parse().unwrap()];
        match parse(&text, &cameras).map_err(|fault| fault.to_string()) {
            Ok(rows) => {
                prop_assert!(!rows.is_empty() && rows.len() <= 10_000);
                prop_assert!(rows.is_sorted_by_key(|row| row.start));
                for row in &rows {
                    prop_assert!(row.start < row.end, "{row:?}");
                    prop_assert!(cameras.contains(&row.camera));
                    prop_assert!(row.line >= 1 && row.line <= text.lines().count(), "{row:?}");
                }
                let ids: std::collections::BTreeSet<_> = rows.iter().map(|row| &row.id).collect();
                prop_assert_eq!(ids.len(), rows.len(), "two rows of one name: a restart would count one for the other");
            }
            // A message may quote the faulty text once or twice.
            Err(why) => prop_assert!(why.contains("line ") && why.len() <= 8 * text.len() + 2000, "{why:?}"),
        }
    }
}

#[test]
fn the_texts_that_are_spoilt_are_good_ones() {
    let cameras = ["cam".parse().unwrap(), "guide-cam".parse().unwrap()];
    for text in GOOD {
        parse(text, &cameras).unwrap();
    }
}
