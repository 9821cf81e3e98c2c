//! Rows that want the mount, or the camera, at the same time.
//!
//! Windows may overlap: rows wait for each other, as `pick` decides. A row that is expected to lose its window to
//! others is reported. The length of a row is estimated; the order is that of the observatory node.

use contract::observatory::{Check, Finding};
use units::Utc;

use super::KnownFacts;
use super::duration::{Estimate, estimate, length};
use crate::action::Needs;
use crate::fault::{Right as _, warning};
use crate::fields::when;
use crate::row::Row;

/// A row that loses more of its window to others than this is reported, s.
const SLACK_S: f64 = 60.0;

/// A row that is expected to run, and until when.
struct Run<'a> {
    row: &'a Row,
    needs: Needs,
    end: Utc,
}

/// Rows to which others leave too little of their window.
pub(super) fn check(rows: &[Row], known: &KnownFacts) -> Vec<Finding> {
    let mut runs: Vec<Run<'_>> = Vec::new();
    let mut findings = Vec::new();
    for row in rows {
        let needs = row.action.needs();
        if needs.all_before {
            continue;
        }
        runs.retain(|run| run.end > row.start);
        let Estimate { needs_s, until_end } = estimate(row, &known.config.schedule.check);
        // As in `pick`: nothing runs at the same time as a row that is not parallel. Otherwise two rows may run
        // together if they have different cameras and do not both need the mount.
        let stops =
            |run: &&Run<'_>| !run.needs.parallel || run.row.camera == row.camera || (run.needs.mount && needs.mount);
        let before = runs.iter().filter(stops).max_by_key(|run| run.end);
        let begin = before.map_or(row.start, |run| run.end);
        if let Some(run) = before {
            findings.extend(finding(row, run, known, needs_s, until_end));
        }
        if begin < row.end {
            let end = if until_end { row.end } else { begin.plus_seconds(needs_s).min(row.end) };
            runs.push(Run { row, needs, end });
        }
    }
    findings
}

/// The window that a row loses to the one before it, if it has to be reported.
fn finding(row: &Row, before: &Run<'_>, known: &KnownFacts, needs_s: f64, until_end: bool) -> Option<Finding> {
    let window_s = row.end.seconds_since(row.start);
    let (left_s, lost_s) = (row.end.seconds_since(before.end), before.end.seconds_since(row.start));
    let (line, until) = (before.row.line, when(before.end));
    let what = if left_s <= 0.0 {
        format!("it will not run: the row of line {line} goes on until {until}, after this window")
    } else if until_end && lost_s > SLACK_S {
        format!("it loses {} of its window: the row of line {line} goes on until {until}", length(lost_s))
    } else if !until_end && left_s < needs_s && window_s >= needs_s {
        let (left, needs) = (length(left_s), length(needs_s));
        format!("the row of line {line} goes on until about {until}, which leaves {left} for the {needs} that it takes")
    } else {
        return None;
    };
    let found = warning(Check::Overlap, row.written.field("start_time"), Some("start_time"), what);
    Some(found.right(way_out(row, before, known)))
}

fn way_out(row: &Row, before: &Run<'_>, known: &KnownFacts) -> String {
    let mount = |row| known.mount(row).map(|mount| &mount.common.name);
    let later = format!("start_time at least {}", when(before.end));
    if before.row.camera == row.camera {
        return later;
    }
    let mut needed = Vec::new();
    if !before.needs.parallel {
        needed.push(format!("execute_parallel on line {}", before.row.line));
    }
    if before.needs.mount && row.action.needs().mount {
        match mount(row) == mount(before.row) {
            true => needed.push("disable_telescope_movement on this one".to_owned()),
            // Two mounts of one file do not move at once.
            false => return later,
        }
    }
    format!("{later}, or to run alongside it {}", needed.join(" and "))
}
