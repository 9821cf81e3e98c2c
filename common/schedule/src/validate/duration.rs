//! How long a row takes, and whether its window is long enough.

use config::ScheduleCheck;
use contract::observatory::{Check, Finding};

use super::KnownFacts;
use crate::fault::{Right as _, warning};
use crate::fields::when;
use crate::row::Row;

/// The expected length of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Estimate {
    /// All of it; of a row that exposes until its end, as much as one frame needs. Sky s.
    pub needs_s: f64,
    /// It goes on until its window ends.
    pub until_end: bool,
}

/// By its exposures and the overheads of the configuration.
pub(super) fn estimate(row: &Row, overheads: &ScheduleCheck) -> Estimate {
    let before_s = if row.action.needs().mount { overheads.row_overhead_s } else { 0.0 };
    let (mut needs_s, mut until_end) = (before_s, false);
    for exposures in row.action.exposures() {
        let frame_s = exposures.exposure_s + exposures.extra_s + overheads.frame_overhead_s;
        match exposures.frames {
            Some(frames) => needs_s += f64::from(frames) * frame_s,
            None => {
                needs_s += exposures.exposure_s;
                until_end = true;
            }
        }
    }
    Estimate { needs_s, until_end }
}

/// Rows whose exposures do not fit into their windows.
pub(super) fn check(rows: &[Row], known: &KnownFacts) -> Vec<Finding> {
    rows.iter().filter_map(|row| too_short(row, &known.config.schedule.check)).collect()
}

fn too_short(row: &Row, overheads: &ScheduleCheck) -> Option<Finding> {
    let Estimate { needs_s, until_end } = estimate(row, overheads);
    let exposures = row.action.exposures();
    let longest_s = exposures.iter().filter(|e| e.frames != Some(0)).map(|e| e.exposure_s).fold(0.0, f64::max);
    let window_s = row.end.seconds_since(row.start);
    if exposures.is_empty() || needs_s <= window_s {
        return None;
    }
    let enough = format!("end_time at least {}", when(row.start.plus_seconds(needs_s.ceil())));
    if longest_s > window_s {
        let what = format!("an exposure of {longest_s} s does not fit into the window of {window_s:.0} s");
        return Some(warning(Check::Duration, row.written.parameter("exptime"), Some("exptime"), what).right(enough));
    }
    let needs = length(needs_s);
    let what = match until_end {
        true => format!(
            "the window of {window_s:.0} s leaves no time for one frame, which takes about {needs} with pointing"
        ),
        false => format!("{needs} are needed with overheads, and the window has {}", length(window_s)),
    };
    let field = if until_end { "exptime" } else { "n" };
    let fits = match exposures.as_slice() {
        [only] if !until_end => {
            let frame_s = only.exposure_s + only.extra_s + overheads.frame_overhead_s;
            let before_s = needs_s - frame_s * f64::from(only.frames.unwrap_or(0));
            format!(", or n about {:.0}", ((window_s - before_s) / frame_s).floor().max(0.0))
        }
        _ => String::new(),
    };
    Some(warning(Check::Duration, row.written.parameter(field), Some(field), what).right(enough + fits.as_str()))
}

/// A length of time in the words of people.
pub(super) fn length(span_s: f64) -> String {
    match span_s {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
