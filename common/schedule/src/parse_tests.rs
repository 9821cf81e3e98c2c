use super::*;

fn cameras() -> Vec<Name> {
    vec!["main".parse().unwrap(), "guide-cam".parse().unwrap()]
}

fn read(text: &str) -> Result<Vec<Row>, Fault> {
    parse(text, &cameras())
}

/// A row with its parts put in as text.
fn row_text(camera: &str, action: &str, value: &str, start: &str, end: &str) -> String {
    format!(
        r#"{{"device_name": "{camera}", "action_type": "{action}", "action_value": {value}, "start_time": "{start}", "end_time": "{end}"}}"#
    )
}

const START: &str = "2026-11-21 01:00:00";
const END: &str = "2026-11-21 03:00:00";

fn object(value: &str) -> String {
    row_text("main", "object", value, START, END)
}

#[track_caller]
fn refused(text: &str, line: usize, words: &[&str]) {
    let fault = read(text).unwrap_err();
    let is_it = |finding: &&Finding| words.iter().all(|word| finding.words().contains(word));
    let at: Vec<u32> = fault.findings.iter().filter(is_it).map(|finding| finding.line).collect();
    assert!(usize::try_from(at[0]).unwrap() == line, "expected {words:?} on line {line}: {fault}");
}

#[test]
fn comments_blank_lines_and_objects_over_several_lines_are_read() {
    let text = "\u{feff}// a night\r\n\n{\"device_name\": \"main\",\n  // inside an object\n  \"action_type\": \"open\",\n  \"start_time\": \"2026-11-21T01:00:00.000Z\", \"end_time\": \"2026-11-21T05:00:00+02:00\"} {\"device_name\": \"main\", \"action_type\": \"close\", \"action_value\": null, \"start_time\": \"2026-11-21 00:00:00\", \"end_time\": \"2026-11-21 09:00:00.5\"}\n";
    let rows = read(text).unwrap();
    let names: Vec<_> = rows.iter().map(|row| (row.action.name(), row.line)).collect();
    assert_eq!(names, [("close", 6), ("open", 3)], "sorted by start, lines of the file");
    assert_eq!(rows[1].end, "2026-11-21T03:00:00Z".parse().unwrap());
}

#[test]
fn rows_with_the_same_start_keep_their_order() {
    let two = [row_text("main", "open", "{}", START, END), row_text("main", "close", "{}", START, END)].join("\n");
    let names: Vec<_> = read(&two).unwrap().iter().map(|row| row.action.name()).collect();
    assert_eq!(names, ["open", "close"]);
}

#[test]
fn all_parameters_of_an_object_are_accepted_by_name() {
    let value = r#"{"object": "x", "exptime": 10, "ra": 1.5, "dec": -2, "filter": "V", "focus_shift": 5, "focus_position": 3000,
        "n": 10, "guiding": true, "pointing": true, "bin": 2, "dir": "here", "execute_parallel": true,
        "disable_telescope_movement": true, "reset_guiding_reference": false, "subframe_width": 100,
        "subframe_height": 50, "subframe_center_x": 0.2, "subframe_center_y": 1, "nonsidereal_recenter_interval": 0,
        "nonsidereal_start_lead_time_seconds": 0, "nonsidereal_rate_update_interval": null,
        "metadata": {"program": "p1", "visit": 3}}"#;
    let rows = read(&object(value)).unwrap();
    assert_eq!(rows[0].action.frames_wanted(), Some(10));
    assert_eq!(rows[0].action.object(), Some("x"));
    assert!(rows[0].action.needs().parallel);
}

#[test]
fn what_astra_writes_into_its_own_output_is_passed_over() {
    let text = row_text("main", "open", r#"{}, "completed": false, "status": "pending""#, START, END);
    assert_eq!(read(&text).unwrap().len(), 1);
}

#[test]
fn the_same_row_is_found_again_and_twins_are_distinguished() {
    let first = read(&object(r#"{"object": "x", "exptime": 10}"#)).unwrap();
    let again = read(&format!("// moved down\n\n{}", object(r#"{"exptime": 10, "object": "x"}"#))).unwrap();
    assert_eq!(first[0].id, again[0].id);
    let other = read(&object(r#"{"object": "x", "exptime": 11}"#)).unwrap();
    assert_ne!(first[0].id, other[0].id);
    let twins = read(&object(r#"{"object": "x", "exptime": 10}"#).repeat(2)).unwrap();
    assert_eq!(first[0].id, twins[0].id);
    assert_ne!(twins[0].id, twins[1].id);
}

#[test]
fn an_empty_file_is_refused() {
    refused("", 1, &["no rows"]);
    refused("// nothing\n\n", 1, &["no rows"]);
}

#[test]
fn half_a_file_is_refused_with_its_line() {
    let text = format!("{}\n{}", object(r#"{"object": "x", "exptime": 10}"#), r#"{"device_name": "main","#);
    refused(&text, 2, &["no JSON", "EOF"]);
    refused("{}\n\nnonsense", 1, &["device_name is missing"]);
    refused(&format!("{}\n\nnonsense", object(r#"{"object": "x", "exptime": 10}"#)), 3, &["no JSON"]);
    refused("[1, 2]", 1, &["expected an object"]);
}

#[test]
fn an_unknown_key_is_refused_with_the_one_that_was_meant() {
    let text = "{\"device_name\": \"main\",\n\"action_typ\": \"open\"}";
    refused(text, 2, &["unknown key \"action_typ\"", "did you mean \"action_type\"?"]);
    refused(
        &object(r#"{"object": "x", "exptime": 10, "guidng": true}"#),
        1,
        &["guidng: unknown parameter; did you mean \"guiding\"?"],
    );
    refused(
        &object("{\"object\": \"x\",\n\"exptime\": 10,\n\"zzzzzzzzzz\": 1}"),
        3,
        &["expected one of", "object, exptime"],
    );
}

#[test]
fn an_unknown_camera_is_refused() {
    refused(&row_text("mian", "open", "{}", START, END), 1, &["no camera is named \"mian\"", "did you mean \"main\"?"]);
}

#[test]
fn an_unknown_action_is_refused() {
    refused(&row_text("main", "objekt", "{}", START, END), 1, &["unknown action_type \"objekt\"", "\"object\"?"]);
}

#[test]
fn a_time_that_is_none_is_refused_with_what_was_expected() {
    refused(
        &row_text("main", "open", "{}", "tonight", END),
        1,
        &["start_time", "\"tonight\" is no time", "expected UTC"],
    );
    refused(&row_text("main", "open", "{}", END, START), 1, &["is not after start_time"]);
    refused(&row_text("main", "open", "{}", START, START), 1, &["is not after start_time"]);
    refused(
        r#"{"device_name": "main", "action_type": "open", "start_time": 5, "end_time": "x"}"#,
        1,
        &["expected a text"],
    );
}

#[test]
fn wrong_parameters_are_refused() {
    for (value, words) in [
        (r#"{"exptime": 10}"#, ["object: is missing", "expected a text"]),
        (r#"{"object": "x"}"#, ["exptime: is missing", "a number, 0 to 86400 s"]),
        (r#"{"object": "x", "exptime": -1}"#, ["exptime", "0 to 86400 s, found -1"]),
        (r#"{"object": "x", "exptime": "10"}"#, ["exptime: expected a number", "found \"10\""]),
        (r#"{"object": "x", "exptime": 1, "ra": 5}"#, ["ra and dec", ""]),
        (r#"{"object": "x", "exptime": 1, "ra": 5, "dec": 91}"#, ["dec", "-90 to 90"]),
        (r#"{"object": "x", "exptime": 1, "alt": 5}"#, ["alt and az", ""]),
        (r#"{"object": "x", "exptime": 1, "alt": 5, "az": 1, "ra": 1, "dec": 1}"#, ["not both", ""]),
        (r#"{"object": "x", "exptime": 1, "lookup_name": "Sun"}"#, ["lookup_name", "no telescope is pointed at it"]),
        (r#"{"object": "x", "exptime": 1, "tle": "1 2"}"#, ["tle", "expected two lines"]),
        (r#"{"object": "x", "exptime": 1, "bin": 0}"#, ["bin", "1 to 16"]),
        (r#"{"object": "x", "exptime": 1, "subframe_width": 10}"#, ["subframe_width", "or neither"]),
        (r#"{"object": "x", "exptime": 1, "subframe_center_x": 1.5}"#, ["subframe_center_x", "0 to 1"]),
    ] {
        refused(&object(value), 1, &words);
    }
    refused(&object("5"), 1, &["expected an object"]);
}

#[test]
fn wrong_calibrations_are_refused() {
    for (value, word) in [
        (r#"{"exptime": [], "n": []}"#, "exptime: expected a list of numbers, at least 1"),
        (r#"{"exptime": [0, 1], "n": [1]}"#, "n: exptime has 2 and n has 1 values; expected as many"),
    ] {
        refused(&row_text("main", "calibration", value, START, END), 1, &[word]);
    }
    let negative = row_text("main", "calibration", r#"{"exptime": [1], "n": [-1]}"#, START, END);
    refused(&negative, 1, &["n: expected a list of whole numbers", "1 to 1000000 frames, found [-1]"]);
    refused(&row_text("main", "open", r#"{"object": "x"}"#, START, END), 1, &["object: unknown parameter"]);
}

#[test]
fn the_fault_names_the_line_of_the_row_that_is_wrong() {
    let good = object(r#"{"object": "x", "exptime": 10}"#);
    let bad = object("{\n  \"object\": \"x\",\n  \"exptime\": 10,\n  \"bin\": 99}");
    refused(&format!("// one\n{good}\n// two\n{bad}"), 7, &["bin: expected a whole number, 1 to 16 px, found 99"]);
}

#[test]
fn a_file_too_large_is_refused_before_it_is_read() {
    refused(&" ".repeat(5_000_001), 1, &["at most 5000000"]);
}

#[test]
fn a_row_with_names_without_number_or_end_is_reported_briefly() {
    let many: String = (0..20_000).map(|n| format!("\"k{n}\": 1, ")).collect();
    let long = "x".repeat(100_000);
    for text in [
        format!("{{{many}\"end\": 1}}"),
        object(&format!("{{{many}\"object\": 5}}")),
        object(&format!(r#"{{"object": "x", "exptime": "{long}"}}"#)),
        object(&format!(r#"{{"object": "x", "{long}": 1}}"#)),
        row_text(&long, &long, "{}", &long, &long),
        "{\"a\": [\n".repeat(10_000),
    ] {
        let fault = read(&text).unwrap_err();
        assert!(fault.findings.len() <= 200 && fault.findings.iter().all(|finding| finding.words().len() < 2000));
    }
}

#[test]
fn each_wrong_parameter_is_reported_where_it_stands_and_what_follows_from_it_is_not() {
    let text = object(r#"{"object": "x", "exptime": "10", "dec": 95, "ra": 5, "bin": 99, "guidng": 1}"#);
    let fault = read(&text).unwrap_err();
    let fields: Vec<_> = fault.findings.iter().map(|finding| finding.field.as_deref().unwrap()).collect();
    assert_eq!(fields, ["exptime", "dec", "bin", "guidng", "guiding"], "{fault}");
    let stands = |column: u32| text.chars().skip(column as usize - 1).take(4).collect::<String>();
    let there: Vec<_> = fault.findings.iter().map(|finding| stands(finding.column)).collect();
    assert_eq!(there, ["\"10\"", "95, ", "99, ", "\"gui", "1}, "]);
}

#[test]
fn what_a_row_does_not_give_is_its_cameras_default_and_null_is_as_if_it_were_not_there() {
    let row = |value: &str| {
        format!(
            "{{\"device_name\": \"main\", \"action_type\": \"object\", \"action_value\": {value}, \"start_time\": \"2026-11-21 01:00:00 \
             UTC\", \"end_time\": \"21.11.2026 05:00\"}}\n"
        )
    };
    let toml = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\nelevation_m = 0\n[[camera]]\nname = \"main\"\n\
                server = \"a:1\"\ndefaults.object = { exptime = 7, n = 4 }\n";
    let config = config::parse(toml, std::path::Path::new(".")).unwrap();
    let defaults = crate::fields::defaults_of(&config.camera);
    let text = row(r#"{"object": "x", "ra": 1, "dec": 2, "n": 9, "guiding": null, "pointing": null}"#);
    let of = |defaults| read_with(&text, &cameras(), defaults);
    let reading = of(&defaults);
    assert_eq!(reading.findings, [], "{text}");
    assert_eq!(
        (reading.rows[0].action.frames_wanted(), reading.rows[0].end.to_string().get(..13)),
        (Some(9), Some("2026-11-21T05"))
    );
    let without = of(&Defaults::new());
    assert_eq!(without.findings[0].field.as_deref(), Some("exptime"), "{without:?}");
    // A change of the defaults makes no new row: a row that is done stays done.
    let more = row(r#"{"object": "x", "ra": 1, "dec": 2, "exptime": 3, "n": null}"#);
    let id = |defaults| read_with(&more, &cameras(), defaults).rows[0].id.clone();
    assert_eq!(id(&defaults), id(&Defaults::new()));
    let either_way = more.replace("21.11.2026", "03.04.2026");
    assert!(super::read(&either_way, &cameras()).findings[0].what.contains("either way round"), "{either_way}");
}

#[test]
fn a_row_may_name_its_programme_and_a_wrong_one_is_a_fault() {
    let row = |programme: &str| {
        let row = object(r#"{"object": "x", "exptime": 10, "ra": 1.5, "dec": -2}"#);
        row.replacen('}', &format!("}}, \"programme\": {programme}"), 1)
    };
    let named = read(&row("\" 112.25XK.001 \"")).unwrap();
    assert_eq!(named[0].programme.as_deref(), Some("112.25XK.001"));
    for none in [object(r#"{"object": "x", "exptime": 10, "ra": 1.5, "dec": -2}"#), row("null")] {
        assert_eq!(read(&none).unwrap()[0].programme, None);
    }
    for wrong in ["\"\"", "\"two words\"", "\"Bar\u{e9}\"", &format!("{:?}", "x".repeat(41))] {
        refused(&row(wrong), 1, &["programme", "is no id of a programme: expected 1 to 40"]);
    }
    refused(&row("7"), 1, &["programme", "expected a text, found 7"]);
}

#[test]
fn a_programme_is_one_word_of_signs_that_a_header_has() {
    let action = r#"{"object": "x", "exptime": 10, "ra": 1.5, "dec": -2}"#;
    let row = |programme: &str| object(action).replacen('}', &format!("}}, \"programme\": {programme}"), 1);
    let longest = "x".repeat(40);
    for (written, programme) in [
        ("\"A\"", "A"),
        ("\"60.A-9009(A)\"", "60.A-9009(A)"),
        ("\"o'brien/1#2\"", "o'brien/1#2"),
        ("\"a\\\"b\\\\c\"", "a\"b\\c"),
        ("\"\\t \\u2003X\\n\"", "X"),
        (format!("\"{longest}\"").as_str(), longest.as_str()),
        (format!("\"  {longest}  \"").as_str(), longest.as_str()),
    ] {
        let rows = read(&row(written)).unwrap();
        assert_eq!(rows[0].programme.as_deref(), Some(programme), "{written}");
    }
    for wrong in [
        "\"   \"",
        "\"a\\tb\"",
        "\"a\\nb\"",
        "\"a\\u0000b\"",
        "\"a\\u007fb\"",
        "\"a\\u00a0b\"",
        "\"\\u00e9\"",
        "\"\\ud83d\\ude00\"",
        &format!("\"{longest}y\""),
    ] {
        refused(&row(wrong), 1, &["programme", "is no id of a programme: expected 1 to 40"]);
    }
    for other in ["true", "1.5", "[\"A\"]", "{\"id\": \"A\"}"] {
        refused(&row(other), 1, &["programme", "expected a text, found"]);
    }
    refused(&row("\"A\", \"programme\": \"B\""), 1, &["programme", "stands twice in this row"]);
}

#[test]
fn a_row_for_another_programme_is_another_row_and_its_faults_are_reported_with_the_others() {
    let action = r#"{"object": "x", "exptime": 10, "ra": 1.5, "dec": -2}"#;
    let of = |camera: &str, programme: &str| {
        let named = format!("}}, \"programme\": \"{programme}\"");
        row_text(camera, "object", action, START, END).replacen('}', &named, 1)
    };
    let id = |programme: &str| read(&of("main", programme)).unwrap()[0].id.clone();
    assert_eq!(id("A"), id("A"));
    assert_ne!(id("A"), id("B"));
    let both = read(&format!("{}\n{}", of("main", "A"), of("main", "B"))).unwrap();
    let mut programmes: Vec<_> = both.iter().map(|row| row.programme.clone().unwrap()).collect();
    programmes.sort();
    assert_eq!(programmes, ["A", "B"]);
    let fault = read(&of("nobody", "two words")).unwrap_err();
    let fields: Vec<_> = fault.findings.iter().filter_map(|finding| finding.field.as_deref()).collect();
    assert!(fields.contains(&"device_name") && fields.contains(&"programme"), "{fault}");
}
