//! Golden schedules: the comments of each file of `tests/schedules` list its findings, and there must be no others.
//!
//! `// expect: SEVERITY CHECK FIELD `TEXT` WORDS` stands before the line of a finding (`// expect N:` names the line);
//! FIELD is `-` where there is none, TEXT is what stands at its column, WORDS are part of its message. `// unchecked:
//! WORDS` is what cannot be checked, `// now: TIME` the time at which the file is read.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use contract::observatory::{Finding, Fix, ScheduleFindings, Severity};
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
    // It has not been read yet.
    let unread = known().with_filters(&"wheel".parse().unwrap(), Vec::new());
    assert!(validate(&row("V"), &unread).valid && !validate(&row("Sloan r"), &unread).valid);
}

/// A text with a finding's fix made.
fn fixed(text: &str, fix: &Fix) -> String {
    let at = |line: u32, column: u32| {
        let before: usize = text.split_inclusive('\n').take(line as usize - 1).map(str::len).sum();
        before + text[before..].chars().take(column as usize - 1).map(char::len_utf8).sum::<usize>()
    };
    format!("{}{}{}", &text[..at(fix.line, fix.column)], fix.text, &text[at(fix.end_line, fix.end_column)..])
}

#[test]
fn a_fix_takes_its_finding_away() {
    let mut fixes = 0;
    for file in &golden_files() {
        let text = std::fs::read_to_string(file).unwrap();
        let text = text.trim_start_matches('\u{feff}');
        let found = validate(text, &known());
        for finding in &found.findings {
            let Some(fix) = &finding.fix else { continue };
            let same = |all: &ScheduleFindings| {
                let is_same = |one: &&Finding| (&one.field, &one.what) == (&finding.field, &finding.what);
                all.findings.iter().filter(is_same).count()
            };
            let after = fixed(text, fix);
            assert!(same(&validate(&after, &known())) < same(&found), "{}: {finding}\n{after}", file.display());
            fixes += 1;
        }
    }
    assert!(fixes >= 8, "{fixes} fixes");
}

/// Two rows of which the second repeats the first, and everything of the first that has a fix is wrong.
const WRONG: &str = r#"// é 🔭
{"device_name": "mian", "note": "🔭",
 // the field
 "action_type": "objekt", "action_value": {"zzzzzzzzzz": 1, "object": "é🔭", "exptim": "60",  "bin": 99, "ra": 60.0, "dec": "-30:00:00", "filter": "Clear "},
 "start_time": "2026-11-20 23:00:00",   "end_time": "2026-11-20 02:00:00"}"#;
const RIGHT: &str = r#"// é 🔭
{"device_name": "main",
 // the field
 "action_type": "object", "action_value": {"object": "é🔭", "exptime": 60,  "bin": 16, "ra": 60.0, "dec": -30.00000, "filter": "clear"},
 "start_time": "2026-11-20 23:00:00",   "end_time": "2026-11-21T02:00:00Z"}"#;

#[test]
fn fixes_one_after_the_other_change_what_they_name_and_nothing_else() {
    let mut text = WRONG.to_owned();
    for _ in 0..20 {
        let found = validate(&text, &known()).findings;
        let Some(fix) = found.into_iter().find_map(|finding| finding.fix) else { break };
        text = fixed(&text, &fix);
    }
    assert_eq!(text, RIGHT);
    let twice = validate(&format!("{RIGHT} {}", RIGHT.replace("// é 🔭\n", "")), &known()).findings;
    let fixes: Vec<&Fix> = twice.iter().filter_map(|finding| finding.fix.as_ref()).collect();
    let [fix] = fixes.as_slice() else { panic!("{twice:?}") };
    assert_eq!((fix.line, fix.end_line, fix.text.as_str()), (5, 8, ""));
    assert_eq!(fixed(&format!("{RIGHT} {}", RIGHT.replace("// é 🔭\n", "")), fix), format!("{RIGHT} "));
}

#[test]
fn commas_too_many_truth_values_in_quotes_and_pythons_words_are_told_at_once_and_mended_by_their_fixes() {
    let night = |guiding: &str, comma: &str| {
        format!(
            "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"x\", \"exptime\": 60, \
             \"ra\": 60.0, \"dec\": -30.0, {guiding}{comma}}}, \"start_time\": \"2026-11-21 03:00:00\", \
             \"end_time\": \"2026-11-21 04:00:00\"{comma}\n}}{comma}\n{{\"device_name\": \"main\", \"action_type\": \"close\", \
             \"start_time\": \"2026-11-21 05:00:00\", \"end_time\": \"2026-11-21 06:00:00\"}}"
        )
    };
    let mut text = night("\"guiding\": \" True\", \"pointing\": False", ",");
    let found = validate(&text, &known());
    let fixes = found.findings.iter().filter(|finding| finding.fix.is_some()).count();
    assert_eq!((found.errors, fixes, found.rows), (5, 5, 2), "{found:?}");
    for _ in 0..fixes {
        let fix = validate(&text, &known()).findings.into_iter().find_map(|finding| finding.fix).unwrap();
        text = fixed(&text, &fix);
    }
    assert_eq!(text, night("\"guiding\": true, \"pointing\": false", ""));
    assert!(validate(&text, &known()).valid);
    // A text that is no truth value, or none where a truth value belongs, is not changed.
    for given in ["\"guiding\": \"yes\"", "\"object\": \"true\", \"exptime\": \"true\""] {
        let found = validate(&night(given, ""), &known());
        assert!(found.findings.iter().all(|finding| finding.fix.is_none()), "{found:?}");
    }
}

#[test]
fn what_is_not_sure_to_be_right_has_no_fix() {
    let row = |own: &str, value: &str| {
        format!(
            r#"{{"device_name": "main", {own}"action_type": "object", "action_value": {{"object": "x", "ra": 60.0, "dec": -30.0{value}}}, "start_time": "2026-11-21 03:00:00", "end_time": "2026-11-21 05:00:00"}}"#
        )
    };
    for (own, value) in [
        ("", r#", "exptime": -1"#),
        ("", r#", "exptime": 60, "exptim": 30"#),
        ("", r#", "exptime": 60, "alt": 95"#),
        ("", r#", "exptime": 60, "bin": [99]"#),
        ("", r#", "exptime": 60, "bin": 99, "bin": 99"#),
        (r#""exptime": 60, "#, r#", "exptime": 60"#),
        ("\n// why\n\"note\": 1, ", r#", "exptime": 60"#),
    ] {
        let found = validate(&row(own, value), &known());
        let fixes: Vec<&Finding> = found.findings.iter().filter(|finding| finding.fix.is_some()).collect();
        assert!(found.errors > 0 && fixes.is_empty(), "{own} {value}: {found:?}");
    }
    // A coordinate beyond its range is no other place, and one that may be hours is not changed.
    for ra in ["400.0", "\"04:00:00\""] {
        let found = validate(&row("", ", \"exptime\": 60").replace("60.0", ra), &known());
        assert!(found.errors > 0 && found.findings.iter().all(|finding| finding.fix.is_none()), "{ra}: {found:?}");
    }
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
