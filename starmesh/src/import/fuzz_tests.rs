//! Any content of a site's old files gives blocks and rows, or a message; never a panic.

#[path = "../../../tests/fuzz/spoilt.rs"]
mod spoilt;

use proptest::prelude::*;

use super::entry::Notes;
use super::yaml::{self, Node, Value};
use super::{devices_of, schedule, telescopes};

const YAML: &[&str] = &[
    "Telescope:\n  - device_name: m1\n    ip: \"10.0.0.1:11111\"\n    device_number: 0\n    settle_factor: 0.5\nCamera:\n  - device_name: \
     c1\n    ip: 10.0.0.1:11111\n    device_number: 0\n    temperature: -60\n    paired_devices: {Telescope: m1}\n    flats: \
     {target_adu: [30000, 5000], offset: 300, lower_exposure_limit: 1.5}\n",
    "Telescope: [{device_name: m1, ip: \"a:1\", meridian_flip: true, meridian_flip_min: 5, equatorial_system: JNow, guider: {PIX2TIME: {+x: \
     80, -x: 81, +y: 82, -y: 83.5}, RA_AXIS: x, DIRECTIONS: {+x: East, -x: West, +y: North, -y: South}, PID_COEFFS: {x: {p: 1}, set_y: \
     2}}}]\nDome: [{device_name: d, ip: \"a:1\", telescopes: [m1]}]\nObservingConditions: [{device_name: w, ip: \"a:1\", closing_limits: \
     {Humidity: [{upper: 70, max_safe_duration: 30}]}}]\nCamera: [{device_name: c, ip: \"a:1\", autofocus: {n: 1}, paired_devices: \
     {Telescope: m1}}]\n",
    "a: &one {x: [1, 2.5, true, ~, 'text', \"q\\n\"]}\nb: *one\nMisc:\n  backup_time: 12:00\n  filename_templates:\n    object: \
     \"{x}\"\n# end\n",
    "- 1\n- [a, b]\n-\n  c: |\n    block\n    text\n  d: >-\n    folded\n",
];

const YAML_WORDS: &[&str] = &[
    ":",
    ": ",
    "-",
    "- ",
    "\n",
    "\n  ",
    "\t",
    "{",
    "}",
    "[",
    "]",
    "[[",
    ",",
    "&a ",
    "*a",
    "&a [*a]",
    "!!str ",
    "!",
    "|",
    ">",
    "'",
    "\"",
    "#",
    " #",
    "---\n",
    "...\n",
    "%YAML 9.9\n",
    "? ",
    "~",
    ".inf",
    ".nan",
    "1e999",
    "0x7f",
    "<<: *a",
    "Camera:",
    "\u{feff}",
    "\0",
    "é",
    "\u{2028}",
];

const SCHEDULE: &[&str] = &[
    "// before\n{\"device_name\": \"c1\", \"action_type\": \"object\", \"action_value\": {\"object\": \"x\"}}\n// after\n",
    "{\"device_name\": \"c1\"}{\"device_name\": 5}\n\n[1]\n",
    "// a\n{\"device_name\": \"c1\", \"action_type\": \"object\", \"status\": \"pending\", \"twirl\": 1,\n// b\n\"action_value\": {\"object\": \
     \"x\", \"ra\": 10, \"dec\": -20, \"exptime\": 5, \"n\": -1, \"guidng\": true}, \"start_time\": \"2026-01-01 01:00:00\", \"end_time\": \
     \"2026-01-01T06:00:00\"}\n",
];

const JSON_WORDS: &[&str] =
    &["{", "}", "[", "[[", "\"", ":", ",", "//", "\n", "\r\n", "\\u0000", "1e999", "null", "é", "\0"];

/// Values and depth of a document.
fn extent(node: &Node) -> (usize, usize) {
    let inside: Vec<(usize, usize)> = match &node.value {
        Value::List(list) => list.iter().map(extent).collect(),
        Value::Map(map) => map.iter().map(|(_, node)| extent(node)).collect(),
        _ => Vec::new(),
    };
    (
        1 + inside.iter().map(|(values, _)| values).sum::<usize>(),
        1 + inside.iter().map(|(_, deep)| *deep).max().unwrap_or(0),
    )
}

proptest! {
    #![proptest_config(spoilt::config(2000))]

    #[test]
    fn any_text_is_a_site_of_the_old_sort_or_refused_with_a_reason(text in spoilt::spoilt(YAML, YAML_WORDS)) {
        match yaml::read(&text) {
            Ok(node) => {
                let (values, deep) = extent(&node);
                // An alias may put a nest into a nest; because all of them are counted, they stay flat enough for any
                // stack.
                prop_assert!(values <= 100_000 && deep <= 3000, "{values} values, {deep} deep");
                let mut notes = Notes::default();
                match devices_of(&node, &mut notes) {
                    Ok((mut blocks, _)) => {
                        let devices = blocks.len();
                        telescopes::give_calibrations(&mut blocks, &mut notes);
                        let files = telescopes::distribute(blocks, "site", &mut notes);
                        let count: usize = files.iter().map(|file| file.blocks.len()).sum();
                        prop_assert_eq!(count, devices, "no device is lost");
                    }
                    Err(why) => prop_assert!(!format!("{:#}", why).is_empty(), "a reason is reported"),
                }
            }
            Err(why) => prop_assert!(why.to_string().starts_with("line "), "{why}"),
        }
    }

    #[test]
    fn any_old_schedule_is_taken_apart_without_losing_a_letter_or_refused_with_its_line(
        text in spoilt::spoilt(SCHEDULE, JSON_WORDS)
    ) {
        match schedule::pieces(&text) {
            Ok((pieces, rest)) => {
                let mut all: String = pieces.iter().map(|piece| format!("{}{}", piece.before, piece.row)).collect();
                all += &rest;
                prop_assert_eq!(all, text);
                let mut notes = Notes::default();
                let camera: contract::Name = "c1".parse().unwrap();
                let new = schedule::of_telescope(&pieces, &[schedule::Camera { old: "c1".to_owned(), new: camera.clone(), has_wheel: false }], &mut notes);
                // The written file is accepted: comments, and rows without a fault.
                let read = ::schedule::read(&new, &[camera]);
                let is_empty = new.lines().all(|line| line.trim().is_empty() || line.trim_start().starts_with("//"));
                prop_assert!(is_empty || read.findings.is_empty(), "{}: {:?}", new, read.findings);
            }
            Err(why) => prop_assert!(why.to_string().starts_with("line "), "{why}"),
        }
    }
}

#[test]
fn texts_too_large_are_refused_before_they_are_read() {
    assert!(yaml::read(&" ".repeat((1 << 20) + 1)).unwrap_err().to_string().contains("at most 1048576"));
    assert!(schedule::pieces(&" ".repeat(5_000_001)).unwrap_err().to_string().contains("at most 5000000"));
    assert!(schedule::pieces(&"1 ".repeat(10_001)).unwrap_err().to_string().contains("more than 10000 rows"));
}
