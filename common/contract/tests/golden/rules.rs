//! What the samples alone cannot say, found by trying it on the decoders and frozen in `rules.json`:
//! the payloads of each key, which fields may be absent, which values may be `{"no_data": …}`, which objects have
//! free keys, which values may be any scalar, and the words of each enumeration.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use contract::bus_page;
use contract::device::vendor::VendorCommand;
use contract::device::{camera, cover_calibrator, dome, telescope};
use contract::table::payloads as claims;
use contract::{
    CommandOutcome, Kind, Link, OrderKind, Reason, Reply, Role, archive, archived_frame, audit, node, observatory,
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::places::{Place, has_free_keys, is_any_json, places};
use crate::{RULES, golden, samples};

type Places = BTreeMap<String, BTreeSet<String>>;

#[test]
fn the_rules_are_what_the_decoders_do() {
    let mut optional = Places::new();
    let mut missing = Places::new();
    let mut scalars = Places::new();
    let mut maps = Places::new();
    let words = words();
    // a mixed list is nothing but a scalar; serde reads a short one as a struct's fields in order
    let any_list = json!([true, 1, 2.5, "x", [1], false, "y"]);
    for claim in claims() {
        let reads = |value: &Value| (claim.again)(&serde_json::to_vec(value).unwrap()).is_ok();
        let mut required = BTreeSet::new();
        for sample in samples(claim.name) {
            for place in places(&sample) {
                let pattern = place.pattern(claim.name);
                let here = place.get(&sample);
                let note = |list: &mut Places| list.entry(claim.name.to_owned()).or_default().insert(pattern.clone());
                if here.is_object() && has_free_keys(claim.name, &pattern) {
                    note(&mut maps);
                }
                if let Some(without) = place.removed(&sample).filter(|_| !place.is_free(claim.name)) {
                    if reads(&without) {
                        note(&mut optional);
                    } else {
                        required.insert(pattern.clone());
                    }
                }
                if is_any_json(claim.name, &pattern) {
                    continue;
                }
                if !here.is_object() && reads(&place.replaced(&sample, json!({"no_data": "timeout: 2 s"}))) {
                    note(&mut missing);
                }
                if reads(&place.replaced(&sample, any_list.clone())) {
                    note(&mut scalars);
                }
                if here.is_string() && !reads(&place.replaced(&sample, json!("no_such_word"))) {
                    let known = words.get(claim.name).is_some_and(|words| words.contains_key(&pattern));
                    // times, and bytes as base64, are no words
                    let is_no_word = pattern.trim_end_matches(".*").ends_with("_utc") || pattern.ends_with(".bytes");
                    assert!(known || is_no_word, "{} {pattern}: no words are listed", claim.name);
                }
            }
        }
        if let Some(optional) = optional.get(claim.name) {
            assert!(optional.is_disjoint(&required), "{}: optional here and required there", claim.name);
        }
    }
    let keys: BTreeMap<_, _> = bus_page::patterns().into_iter().map(|pattern| (pattern.text, pattern.names)).collect();
    let found = json!({
        "keys": keys, "optional": optional, "may_be_missing": missing, "scalars": scalars, "free_keys": maps,
        "words": words,
    });
    let promised: Value = serde_json::from_str(&golden(RULES)).unwrap_or_default();
    if found != promised {
        let draft = Path::new(env!("CARGO_TARGET_TMPDIR")).join("rules.json");
        std::fs::write(&draft, page(&found)).unwrap();
        panic!("golden/v1/rules.json promises something else than {}: only additions are allowed", draft.display());
    }
}

/// The rules as their file has them, one line per payload.
fn page(rules: &Value) -> String {
    let list = |part: &Value| -> Vec<String> {
        part.as_object().unwrap().iter().map(|(name, rule)| format!("    {name:?}: {rule}")).collect()
    };
    let parts = rules.as_object().unwrap().iter();
    let parts: Vec<String> =
        parts.map(|(part, rules)| format!("  {part:?}: {{\n{}\n  }}", list(rules).join(",\n"))).collect();
    format!("{{\n{}\n}}\n", parts.join(",\n"))
}

/// The words of every enumeration, by payload and place; each is asked from the type itself.
fn words() -> BTreeMap<String, BTreeMap<String, Vec<String>>> {
    let mut all: BTreeMap<String, BTreeMap<String, Vec<String>>> = BTreeMap::new();
    let mut put = |name: &str, place: &str, words: Vec<String>| {
        all.entry(name.to_owned()).or_default().insert(place.to_owned(), words);
    };
    for kind in Kind::ALL {
        let state = format!("{kind}.state");
        put(&state, "link.is", words_of::<Link>(json!({"is": "?"})));
        if kind != Kind::SafetyMonitor {
            put(&state, "last_command.outcome.is", words_of::<CommandOutcome>(json!({"is": "?"})));
            put(&format!("{kind}.command"), "do", verbs(kind));
        }
    }
    put("telescope.capabilities", "can.equatorial_system", words_of::<telescope::EquatorialSystem>(json!("?")));
    put("telescope.state", "fields.pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("observatory.pointing", "models.*.pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("telescope.command", "do.pulse_guide.direction", words_of::<telescope::Direction>(json!("?")));
    for kind in ["telescope", "dome"] {
        put(&format!("{kind}.command"), "do.vendor", words_of::<VendorCommand>(json!("?")));
    }
    put("camera.state", "fields.activity", words_of::<camera::Activity>(json!("?")));
    put("camera.frame", "pixel", words_of::<camera::Pixel>(json!("?")));
    put("dome.state", "fields.shutter", words_of::<dome::Shutter>(json!("?")));
    put("dome.guard", "action", words_of::<dome::GuardAction>(json!("?")));
    put("covercalibrator.state", "fields.cover", words_of::<cover_calibrator::Cover>(json!("?")));
    put("covercalibrator.state", "fields.calibrator", words_of::<cover_calibrator::Calibrator>(json!("?")));
    for record in ["safetymonitor.record", "observingconditions.record", "switch.record"] {
        for entries in ["earlier.*.entries", "entries"] {
            put(record, &format!("{entries}.*.link.is"), words_of::<Link>(json!({"is": "?"})));
        }
    }
    put("schedule.plan", "rows.*.status", words_of::<observatory::RowStatus>(json!("?")));
    put("schedule.plan", "findings.*.severity", words_of::<observatory::Severity>(json!("?")));
    put("schedule.plan", "findings.*.check", words_of::<observatory::Check>(json!("?")));
    put("reply", "answer", words_of::<Reply>(json!({"answer": "?"})));
    put("reply", "reason", words_of::<Reason>(json!("?")));
    put("order", "do", words_of::<OrderKind>(json!("?")));
    put("observatory.safety", "verdict", words_of::<observatory::Verdict>(json!("?")));
    put("observatory.safety", "intervals.*.verdict", words_of::<observatory::Verdict>(json!("?")));
    put("observatory.permit", "verdict", words_of::<observatory::Verdict>(json!("?")));
    put("observatory.night", "posture", words_of::<observatory::Posture>(json!("?")));
    put("observatory.night", "triggers.*.kind", words_of::<observatory::TriggerKind>(json!("?")));
    for (name, at) in [("observatory.focus", "run."), ("observatory.focus_run", "")] {
        put(name, &format!("{at}outcome"), words_of::<observatory::FocusOutcome>(json!("?")));
        put(name, &format!("{at}points.*.pass"), words_of::<observatory::FocusPass>(json!("?")));
    }
    put("observatory.facts", "unsolved.class", words_of::<observatory::UnsolvedClass>(json!("?")));
    put("observatory.facts", "pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("observatory.optics", "optics.*.pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("observatory.schedule", "rows.*.status", words_of::<observatory::RowStatus>(json!("?")));
    for name in ["observatory.schedule", "schedule.findings"] {
        put(name, "findings.*.severity", words_of::<observatory::Severity>(json!("?")));
        put(name, "findings.*.check", words_of::<observatory::Check>(json!("?")));
    }
    for (name, place) in
        [("observatory.correction", ""), ("archive.answer", "rows.*.correction."), ("observatory.guiding", "last.")]
    {
        put(name, &format!("{place}stage"), words_of::<observatory::GuideStage>(json!("?")));
        put(name, &format!("{place}method"), words_of::<observatory::GuideMethod>(json!("?")));
        put(name, &format!("{place}pier_side"), words_of::<telescope::PierSide>(json!("?")));
        for axis in ["east", "north"] {
            put(name, &format!("{place}{axis}.why"), words_of::<observatory::PulseWhy>(json!("?")));
        }
    }
    put("observatory.guiding", "stage", words_of::<observatory::GuideStage>(json!("?")));
    put("observatory.guiding", "calibration.source", words_of::<observatory::CalibrationSource>(json!("?")));
    put("observatory.guiding", "calibration.pier_side", words_of::<telescope::PierSide>(json!("?")));
    let each = "calibrations.*.calibration";
    put("observatory.guiding", &format!("{each}.source"), words_of::<observatory::CalibrationSource>(json!("?")));
    put("observatory.guiding", &format!("{each}.pier_side"), words_of::<telescope::PierSide>(json!("?")));
    put("observatory.guide_reference", "field.pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("alerts", "alerts.*.priority", words_of::<observatory::Priority>(json!("?")));
    put("alerts", "notifications.*.event", words_of::<observatory::AlertEvent>(json!("?")));
    for (name, place) in [("node.audit", "record"), ("audit.answer", "records.*"), ("archive.answer", "rows.*.audit")] {
        put(name, &format!("{place}.outcome.is"), words_of::<audit::AuditOutcome>(json!({"is": "?"})));
        put(name, &format!("{place}.outcome.reason"), words_of::<Reason>(json!("?")));
    }
    put("archive.question", "ask", words_of::<archive::Ask>(json!("?")));
    put("archive.question", "ask.readings.kind", words_of::<Kind>(json!("?")));
    put("archive.question", "ask.series.properties.*.kind", words_of::<Kind>(json!("?")));
    put("schedule.plan_question", "begun.rows.*.status", words_of::<observatory::RowStatus>(json!("?")));
    put("archive.question", "ask.find_log.level", words_of::<node::Level>(json!("?")));
    put("archive.answer", "rows.*.series.kind", words_of::<Kind>(json!("?")));
    put("archive.answer", "rows.*", words_of::<archive::ArchiveRow>(json!("?")));
    put("archive.answer", "rows.*.alert.priority", words_of::<observatory::Priority>(json!("?")));
    let calibrates = words_of::<contract::frame_search::CalibrationFrame>(json!("?"));
    put("archive.answer", "rows.*.found_frame.calibrates", calibrates);
    put("archive.answer", "rows.*.log.level", words_of::<node::Level>(json!("?")));
    put("frame.question", "ask", words_of::<archived_frame::FrameAsk>(json!("?")));
    put("frame.question", "ask.picture.stretch", words_of::<archived_frame::Stretch>(json!("?")));
    put("frame.answer", "gives", words_of::<archived_frame::FrameGiven>(json!("?")));
    put("frame.answer", "gives.about.facts.unsolved.class", words_of::<observatory::UnsolvedClass>(json!("?")));
    put("frame.answer", "gives.about.facts.pier_side", words_of::<telescope::PierSide>(json!("?")));
    put("report.question", "form", words_of::<archived_frame::ReportForm>(json!("?")));
    put("report.answer", "gives", words_of::<archived_frame::ReportGiven>(json!("?")));
    for name in ["frame.answer", "report.answer"] {
        put(name, "gives.refused.reason", words_of::<archived_frame::NotGiven>(json!("?")));
    }
    put("node.state", "role", words_of::<Role>(json!("?")));
    put("node.diary", "level", words_of::<node::Level>(json!("?")));
    all
}

fn verbs(kind: Kind) -> Vec<String> {
    use contract::device::{filter_wheel, focuser, observing_conditions, rotator, safety_monitor, switch};
    let unknown = json!("?");
    match kind {
        Kind::Telescope => words_of::<telescope::Command>(unknown),
        Kind::Camera => words_of::<camera::Command>(unknown),
        Kind::FilterWheel => words_of::<filter_wheel::Command>(unknown),
        Kind::Focuser => words_of::<focuser::Command>(unknown),
        Kind::Dome => words_of::<dome::Command>(unknown),
        Kind::SafetyMonitor => words_of::<safety_monitor::Command>(unknown),
        Kind::ObservingConditions => words_of::<observing_conditions::Command>(unknown),
        Kind::CoverCalibrator => words_of::<cover_calibrator::Command>(unknown),
        Kind::Switch => words_of::<switch::Command>(unknown),
        Kind::Rotator => words_of::<rotator::Command>(unknown),
    }
}

/// The variants of an enumeration, as serde lists them when it meets one that it does not know.
fn words_of<T: DeserializeOwned>(unknown: Value) -> Vec<String> {
    let complaint = serde_json::from_value::<T>(unknown).map(|_| ()).unwrap_err().to_string();
    let listed = complaint.split_once("expected").unwrap_or_else(|| panic!("{complaint}")).1;
    let words: Vec<String> = listed.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    assert!(!words.is_empty(), "{complaint}");
    words
}

#[test]
fn fields_that_nobody_knows_yet_are_ignored() {
    let words = words();
    for claim in claims() {
        for sample in samples(claim.name) {
            for place in places(&sample) {
                let pattern = place.pattern(claim.name);
                // a variant's object has one key, its name; the rest of the words are tags next to other fields
                let is_variant = words.get(claim.name).is_some_and(|words| words.contains_key(&pattern));
                if !place.get(&sample).is_object() || is_variant {
                    continue;
                }
                for news in [json!(7), json!({"no_data": "x"})] {
                    let grown = with_news(&place, &sample, news);
                    let again = (claim.again)(&serde_json::to_vec(&grown).unwrap());
                    if has_free_keys(claim.name, &pattern) {
                        continue;
                    }
                    assert_eq!(again.unwrap(), sample, "{} {pattern}", claim.name);
                }
            }
        }
    }
}

fn with_news(place: &Place, sample: &Value, news: Value) -> Value {
    let mut grown = sample.clone();
    if let Some(map) = place.get_mut(&mut grown).as_object_mut() {
        map.insert("from_the_future".to_owned(), news);
    }
    grown
}

#[test]
fn free_keys_stay_as_they_are() {
    for claim in claims() {
        for sample in samples(claim.name) {
            for place in places(&sample).into_iter().filter(|place| place.get(&sample).is_object()) {
                if !has_free_keys(claim.name, &place.pattern(claim.name)) {
                    continue;
                }
                let copy = place.get(&sample).as_object().unwrap().values().next().unwrap().clone();
                let grown = with_news(&place, &sample, copy);
                assert_eq!((claim.again)(&serde_json::to_vec(&grown).unwrap()).unwrap(), grown, "{}", claim.name);
            }
        }
    }
}
