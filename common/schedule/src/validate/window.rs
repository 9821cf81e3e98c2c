//! Finds windows that have passed, and windows for which the sky is not known.

use contract::observatory::{Check, Finding};
use units::Utc;

use crate::fault::{Right as _, warning};
use crate::fields::when;
use crate::row::Row;

/// Nobody observes one row for longer; such a window is a mistake in the year.
const LONGEST_S: f64 = 2.0 * 86_400.0;

/// The findings about the rows' windows.
pub(super) fn check(rows: &[Row], now: Option<Utc>) -> Vec<Finding> {
    let mut findings: Vec<Finding> = rows.iter().filter_map(long).collect();
    let Some(now) = now else { return findings };
    let passed: Vec<&Row> = rows.iter().filter(|row| row.end < now).collect();
    // The schedule of another night is reported once.
    let named = if passed.len() == rows.len() { passed.get(..1).unwrap_or_default() } else { &passed };
    for row in named {
        let what = match passed.len() == rows.len() && rows.len() > 1 {
            true => format!("the windows of all {} rows have passed: nothing will be done", rows.len()),
            false => format!("its window passed at {}: nothing more will be done of it", when(row.end)),
        };
        findings.push(warning(Check::Time, row.written.field("end_time"), Some("end_time"), what));
    }
    findings
}

fn long(row: &Row) -> Option<Finding> {
    let span_s = row.end.seconds_since(row.start);
    let days = span_s / 86_400.0;
    let what = format!("its window lasts {days:.1} days; the sky is checked for the first two");
    let found = warning(Check::Time, row.written.field("end_time"), Some("end_time"), what);
    (span_s > LONGEST_S).then(|| found.right("is the date right?"))
}
