//! Golden schedules: the comments of each file of `tests/schedules` list its findings, and there must be no others.
//!
//! `// expect: SEVERITY CHECK FIELD `TEXT` WORDS` stands before the line of a finding (`// expect N:` names the line);
//! FIELD is `-` where there is none, TEXT is what stands at its column, WORDS are part of its message. `// unchecked:
//! WORDS` is what cannot be checked, `// now: TIME` the time at which the file is read.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use contract::observatory::{Finding, Severity};
use proptest::prelude::*;
use schedule::validate::{KnownFacts, accept, validate};

/// An expected finding.
#[derive(Debug)]
struct Expected {
    line: u32,
    severity: String,
    check: String,
    field: Option<String>,
    stands: String,
    words: String,
}

impl Expected {
    fn read(line: u32, text: &str) -> Self {
        let (head, rest) = text.split_once('`').unwrap_or_else(|| panic!("no `text`: {text}"));
        let (stands, words) = rest.split_once('`').unwrap_or_else(|| panic!("no second `: {text}"));
        let head: Vec<&str> = head.split_whitespace().collect();
        let [severity, check, field] = head.as_slice() else { panic!("expected SEVERITY CHECK FIELD: {text}") };
        Self {
            line,
            severity: (*severity).to_owned(),
            check: (*check).to_owned(),
            field: (*field != "-").then(|| (*field).to_owned()),
            stands: stands.to_owned(),
            words: words.trim().to_owned(),
        }
    }

    fn is(&self, found: &Finding, text: &str) -> bool {
        let written = serde_json::to_value(found).unwrap();
        let line = text.lines().nth(found.line as usize - 1).unwrap_or_default();
        let there: String = line.chars().skip(found.column as usize - 1).collect();
        self.line == found.line
            && written["severity"] == self.severity.as_str()
            && written["check"] == self.check.as_str()
            && found.field == self.field
            && there.starts_with(&self.stands)
            && found.words().contains(&self.words)
    }
}

/// The comments of a file.
#[derive(Debug, Default)]
struct Comments {
    expected: Vec<Expected>,
    unchecked: Vec<String>,
    now: Option<units::Utc>,
}

fn comments(text: &str) -> Comments {
    let mut comments = Comments::default();
    let mut waiting: Vec<&str> = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let comment = line.trim().strip_prefix("//").map(str::trim);
        match comment {
            Some(comment) => {
                if let Some(expect) = comment.strip_prefix("expect:") {
                    waiting.push(expect);
                } else if let Some(expect) = comment.strip_prefix("expect ") {
                    let (at, expect) = expect.split_once(':').unwrap();
                    comments.expected.push(Expected::read(at.parse().unwrap(), expect));
                } else if let Some(what) = comment.strip_prefix("unchecked:") {
                    comments.unchecked.push(what.trim().to_owned());
                } else if let Some(now) = comment.strip_prefix("now:") {
                    comments.now = Some(now.parse().unwrap());
                }
            }
            None if line.trim().is_empty() => {}
            None => comments.expected.extend(waiting.drain(..).map(|expect| Expected::read(number, expect))),
        }
    }
    assert!(waiting.is_empty(), "no line follows {waiting:?}");
    comments
}

/// The differences between the findings and the comments of a file.
fn differences(text: &str, known: KnownFacts) -> Vec<String> {
    let text = text.trim_start_matches('\u{feff}');
    let comments = comments(text);
    let found = validate(text, &comments.now.into_iter().fold(known, KnownFacts::at));
    let mut differ = Vec::new();
    let mut left: Vec<&Finding> = found.findings.iter().collect();
    for expected in &comments.expected {
        match left.iter().position(|finding| expected.is(finding, text)) {
            Some(index) => drop(left.remove(index)),
            None => differ.push(format!("not found: {expected:?}")),
        }
    }
    let describe = |finding: &&Finding| format!("not expected: {} {:?} {finding}", finding.severity, finding.check);
    differ.extend(left.iter().map(describe));
    let mut unchecked: Vec<&String> = found.unchecked.iter().collect();
    for expected in &comments.unchecked {
        match unchecked.iter().position(|what| what.contains(expected)) {
            Some(index) => drop(unchecked.remove(index)),
            None => differ.push(format!("not reported as unchecked: {expected}")),
        }
    }
    differ.extend(unchecked.iter().map(|what| format!("not expected to be unchecked: {what}")));
    let errors = comments.expected.iter().filter(|expected| expected.severity == "error").count();
    if found.valid != (errors == 0) || found.errors as usize != errors {
        differ.push(format!("valid {}, {} errors; expected {errors}", found.valid, found.errors));
    }
    differ
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/schedules")
}

fn known() -> KnownFacts {
    let text = std::fs::read_to_string(folder().join("observatory.toml")).unwrap();
    KnownFacts::of(Arc::new(config::parse(&text, &folder()).unwrap()))
}

fn golden_files() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "jsonl"));
    files.sort();
    files
}

#[test]
fn every_golden_schedule_gets_the_verdict_that_it_asks_for() {
    let files = golden_files();
    assert!(files.len() >= 60, "{} files", files.len());
    let mut differ = Vec::new();
    for file in &files {
        let text = std::fs::read_to_string(file).unwrap();
        let of_file = differences(&text, known());
        differ.extend(of_file.iter().map(|what| format!("{}: {what}", file.file_name().unwrap().display())));
    }
    assert!(differ.is_empty(), "\n{}", differ.join("\n"));
}

#[test]
fn a_verdict_that_is_not_the_expected_one_is_noticed() {
    let row =
        r#"{"device_name": "main", "action_type": "close", "start_time": "2026-11-21 03:00:00", "end_time": "x"}"#;
    for (comment, words) in [
        ("// valid", "not expected: error Time line 2, column 98"),
        ("// expect: error time end_time `\"x\"` is no time", ""),
        ("// expect: warning time end_time `\"x\"` is no time", "not found"),
        ("// expect: error time end_time `\"y\"` is no time", "not found"),
        ("// expect: error time end_time `\"x\"` is a time", "not found"),
        ("// expect: error time start_time `\"x\"` is no time", "not found"),
        ("// expect 3: error time end_time `\"x\"` is no time", "not found"),
    ] {
        let differ = differences(&format!("{comment}\n{row}\n"), known()).join("\n");
        assert!(differ.contains(words) && differ.is_empty() == words.is_empty(), "{comment}: {differ:?}");
    }
}

#[test]
fn what_a_wheel_reports_counts_before_what_is_configured() {
    let row = |filter: &str| {
        format!(
            r#"{{"device_name": "main", "action_type": "calibration", "action_value": {{"exptime": [1], "n": [1], "filter": "{filter}"}}, "start_time": "2026-11-21 03:00:00", "end_time": "2026-11-21 04:00:00"}}"#
        )
    };
    let wheel = known().with_filters(&"wheel".parse().unwrap(), vec!["Sloan r".to_owned()]);
    assert!(validate(&row("V"), &known()).valid && !validate(&row("Sloan r"), &known()).valid);
    assert!(!validate(&row("V"), &wheel).valid && validate(&row("Sloan r"), &wheel).valid);
}

/// The example `validates_500_rows` measures the time; here it must end at all, and report all.
#[test]
fn findings_about_hundreds_of_rows_are_printed_within_bounded_memory() {
    let rows: String = (0..3000)
        .map(|n| {
            format!(
                "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"o{n}\", \"exptime\": -1}}, \
                 \"start_time\": \"2026-11-21 03:00:00\", \"end_time\": \"2026-11-21 04:00:00\"}}\n"
            )
        })
        .collect();
    let found = validate(&rows, &known());
    assert_eq!((found.valid, found.findings.len()), (false, 200));
    assert_eq!((found.findings[0].line, found.findings[199].line), (1, 200));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn findings_of_a_torn_golden_schedule_lie_within_its_lines_and_it_is_taken_only_without_errors(
        which in any::<prop::sample::Index>(),
        at in any::<prop::sample::Index>(),
        length in 0_usize..40,
        put_in in prop::option::of("[{}\\[\\]\",:0-9a-z\\\\é\n/ ]{0,6}"),
    ) {
        let files = golden_files();
        let text = std::fs::read_to_string(which.get(&files)).unwrap();
        let mut letters: Vec<char> = text.chars().collect();
        let begin = at.index(letters.len());
        let end = (begin + length).min(letters.len());
        letters.splice(begin..end, put_in.unwrap_or_default().chars());
        let torn: String = letters.into_iter().collect();
        let found = validate(&torn, &known());
        let lines: Vec<&str> = torn.trim_start_matches('\u{feff}').split('\n').collect();
        for finding in &found.findings {
            let line = lines.get(finding.line as usize - 1);
            prop_assert!(line.is_some(), "{finding}");
            prop_assert!(finding.column as usize <= line.unwrap().chars().count() + 1, "{finding}");
        }
        let errors = found.findings.iter().filter(|finding| finding.severity == Severity::Error).count();
        prop_assert_eq!(found.valid, errors == 0);
        prop_assert_eq!(accept(&torn, &known()).is_ok(), found.valid);
    }
}
