//! Finds observations that are made twice: a row that is twice in the file, or one field on two mounts at once.

use std::collections::HashMap;

use contract::observatory::{Check, Finding};

use super::KnownFacts;
use super::sky_table::{SkyTable, angle_deg, chord};
use super::visibility::target;
use crate::fault::{Right as _, warning};
use crate::row::Row;

/// Fields nearer to each other than this are one, degrees.
const SAME_FIELD_DEG: f64 = 0.05;

/// Rows that repeat another one.
pub(super) fn check(rows: &[Row], known: &KnownFacts, sky: &mut SkyTable) -> Vec<Finding> {
    let mut findings = doubled(rows);
    if known.config.telescope.len() > 1 {
        findings.extend(on_two_mounts(rows, known, sky));
    }
    findings
}

fn doubled(rows: &[Row]) -> Vec<Finding> {
    let mut first: HashMap<&str, usize> = HashMap::new();
    let mut by_line: Vec<&Row> = rows.iter().collect();
    by_line.sort_by_key(|row| row.written.begin);
    let mut findings = Vec::new();
    for row in by_line {
        // Twins of a row have its name and a number.
        let name = row.id.0.split('-').next().unwrap_or_default();
        match first.get(name) {
            Some(line) => {
                let what = format!("the same row stands on line {line}: it is done twice");
                let found = warning(Check::Twice, row.written.begin, None, what).right("leave one, or change n");
                findings.push(found.fix(Some(row.written.without())));
            }
            None => drop(first.insert(name, row.line)),
        }
    }
    findings
}

fn on_two_mounts(rows: &[Row], known: &KnownFacts, sky: &mut SkyTable) -> Vec<Finding> {
    let aimed = |row| Some((row, known.mount(row)?.common.name.clone(), target(row, known, sky)?));
    let aimed: Vec<(&Row, _, _)> = rows.iter().filter_map(aimed).collect();
    let mut findings = Vec::new();
    for (index, (row, mount, place)) in aimed.iter().enumerate() {
        // Rows are in order of their start.
        let before = aimed.iter().take(index).filter(|(other, on, _)| other.end > row.start && on != mount);
        let same = |(_, _, other): &&(&Row, _, [f64; 3])| angle_deg(chord(other, place)) < SAME_FIELD_DEG;
        if let Some((other, on, _)) = before.into_iter().find(same) {
            let what = format!("{on} observes the same field at the same time, by the row of line {}", other.line);
            let at = row.written.parameter("ra");
            findings.push(warning(Check::Twice, at, Some("ra"), what).right("give one of them another field or time"));
        }
    }
    findings
}
