//! Finds windows that have passed, and windows for which the sky is not known.

use contract::observatory::{Check, Finding};
use units::Utc;

use crate::fault::{Right as _, warning};
use crate::fields::when;
use crate::row::{PartOfRow, Row};
use crate::written::Written;

/// Nobody observes one row for longer; such a window is a mistake in the year.
const LONGEST_S: f64 = 2.0 * 86_400.0;

/// Where a row stands, its earliest start and its latest end.
type RowWindow<'a> = (&'a Written, Utc, Utc);

/// The findings about the rows' windows.
pub(super) fn check(rows: &[Row], parts: &[PartOfRow], now: Option<Utc>) -> Vec<Finding> {
    let of_rows = rows.iter().map(|row| (&*row.written, row.start, row.end));
    let of_parts = parts.iter().filter_map(|part| part.window.map(|(start, end)| (&*part.written, start, end)));
    let windows: Vec<RowWindow<'_>> = of_rows.chain(of_parts).collect();
    let mut findings: Vec<Finding> = windows.iter().filter_map(long).collect();
    let Some(now) = now else { return findings };
    let passed: Vec<&RowWindow<'_>> = windows.iter().filter(|(_, _, end)| *end < now).collect();
    // The schedule of another night is reported once.
    let named = if passed.len() == windows.len() { passed.get(..1).unwrap_or_default() } else { &passed };
    for (written, _, end) in named {
        let what = match passed.len() == windows.len() && windows.len() > 1 {
            true => format!("the windows of all {} rows have passed: nothing will be done", windows.len()),
            false => format!("its window passed at {}: nothing more will be done of it", when(*end)),
        };
        findings.push(warning(Check::Time, written.field("end_time"), Some("end_time"), what));
    }
    findings
}

fn long((written, start, end): &RowWindow<'_>) -> Option<Finding> {
    let span_s = end.seconds_since(*start);
    let days = span_s / 86_400.0;
    let what = format!("its window lasts {days:.1} days; the sky is checked for the first two");
    let found = warning(Check::Time, written.field("end_time"), Some("end_time"), what);
    (span_s > LONGEST_S).then(|| found.right("is the date right?"))
}
