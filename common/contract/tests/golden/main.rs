//! The promise to everyone who subscribes: frozen samples of every payload, and what they may and must hold.
//!
//! When a test here fails, change the code. Growing within `v1` adds optional fields to samples and rules.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod places;
mod robust;
mod rules;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use contract::bus_page;
use contract::table::payloads as claims;
use serde_json::Value;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/v1")
}

/// The text of a golden file.
fn golden(name: &str) -> String {
    let path = folder().join(format!("{name}.json"));
    fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The samples in a payload's golden file: the file itself, or each element where it holds an array.
fn samples(name: &str) -> Vec<Value> {
    match serde_json::from_str(&golden(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
        Value::Array(samples) => samples,
        sample => vec![sample],
    }
}

/// File that holds what is not a payload's sample.
const RULES: &str = "rules";

#[test]
fn every_sample_reads_and_writes_itself_again() {
    for claim in claims() {
        let samples = samples(claim.name);
        assert!(!samples.is_empty() || claim.name == "safetymonitor.command", "{} has no sample", claim.name);
        for sample in samples {
            let text = serde_json::to_vec(&sample).unwrap();
            let again =
                (claim.again)(&text).unwrap_or_else(|e| panic!("{} does not read: {e}\n{sample:#}", claim.name));
            assert_eq!(again, sample, "{} changed", claim.name);
        }
    }
}

#[test]
fn every_golden_file_is_claimed_by_a_payload_and_every_payload_has_one() {
    let files: BTreeSet<String> = fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        .filter(|name| name != RULES)
        .collect();
    let claimed: BTreeSet<String> = claims().iter().map(|claim| claim.name.to_owned()).collect();
    let in_table: BTreeSet<String> = bus_page::patterns().into_iter().flat_map(|pattern| pattern.names).collect();
    assert_eq!(claimed.len(), claims().len(), "a name is claimed twice");
    assert_eq!(files, claimed);
    assert_eq!(in_table, claimed);
}

#[test]
fn every_payload_in_the_source_is_claimed() {
    fn names(folder: &Path, found: &mut BTreeSet<String>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                names(&path, found);
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let after = text.split("const NAME: &'static str = \"").skip(1);
            found.extend(after.map(|rest| rest.split('"').next().unwrap().to_owned()));
        }
    }
    let mut found = BTreeSet::new();
    names(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
    assert!(found.remove("any"), "the payload that readers of all kinds use is gone");
    let claimed: BTreeSet<String> = claims().iter().map(|claim| claim.name.to_owned()).collect();
    assert_eq!(found, claimed);
}

#[test]
fn every_variant_that_can_be_asked_has_a_sample() {
    let rules: Value = serde_json::from_str(&golden(RULES)).unwrap();
    for (name, place) in [
        ("order", "do"),
        ("reply", "answer"),
        ("archive.question", "ask"),
        ("archive.answer", "rows.*"),
        ("frame.question", "ask"),
        ("frame.answer", "gives"),
        ("report.answer", "gives"),
    ] {
        every_word_is_shown(&rules, name, place);
    }
    for kind in contract::Kind::ALL.into_iter().filter(|kind| *kind != contract::Kind::SafetyMonitor) {
        every_word_is_shown(&rules, &format!("{kind}.command"), "do");
    }
}

/// Does each word of this place stand in some sample, bare or as the only key of an object?
fn every_word_is_shown(rules: &Value, name: &str, place: &str) {
    let mut shown = BTreeSet::new();
    for sample in samples(name) {
        for found in places::places(&sample).into_iter().filter(|found| found.pattern(name) == place) {
            match found.get(&sample) {
                Value::String(word) => shown.insert(word.clone()),
                Value::Object(variant) => shown.insert(variant.keys().next().unwrap().clone()),
                other => panic!("{name} {place}: {other}"),
            };
        }
    }
    let promised = rules["words"][name][place].as_array().unwrap_or_else(|| panic!("no words for {name} {place}"));
    let promised: BTreeSet<String> = promised.iter().map(|word| word.as_str().unwrap().to_owned()).collect();
    assert_eq!(shown, promised, "{name} {place}");
}
