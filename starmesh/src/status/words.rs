//! Words for the lines of the table.

use std::fmt::Display;

use contract::observatory::{Alert, NightState, Unsafe};
use overview::length;

/// So many alerts of a telescope are shown: those that need somebody first, and of these the most urgent ones.
const MOST_ALERTS: usize = 5;

/// A line for each of the first alerts, and one that says how to see `all`.
pub fn alert_lines(alerts: &[Alert], all: impl Display) -> Vec<String> {
    let more = alerts.len().checked_sub(MOST_ALERTS).filter(|more| *more > 0);
    let more = more.map(|more| format!("    {more} more alerts: starmesh tail '{all}'"));
    alerts.iter().take(MOST_ALERTS).map(alert_words).chain(more).collect()
}

/// The event and what a person should do.
fn alert_words(alert: &Alert) -> String {
    let who = alert.acknowledged_by.as_ref().map(|who| format!(" ({who} sees to it)")).unwrap_or_default();
    let gone = if alert.returned_utc.is_some() { " (its cause is gone)" } else { "" };
    let shelved = match (&alert.shelved_by, alert.shelved_until_utc) {
        (Some(who), Some(until)) => format!(" (shelved by {who} until {})", until.to_second()),
        _ => String::new(),
    };
    format!("    {} {}: {}{gone}{who}{shelved}; {}", alert.priority.word(), alert.id, alert.cause, alert.action)
}

/// A reason with the time at which it can end.
pub fn reason_words(reason: &Unsafe) -> String {
    let clears = match reason.clears_in_s {
        Some(left) => format!("; can clear in {}", length(left)),
        None => "; when it clears cannot be known".to_owned(),
    };
    format!("{}: {}{clears}", reason.input, reason.why)
}

/// Whether the sky is simulated, and how fast it turns.
pub fn sky_word(night: &NightState) -> String {
    match (night.simulated, night.speed) {
        (false, _) => "real".to_owned(),
        (true, 1.0) => "simulated".to_owned(),
        (true, speed) => format!("simulated x{speed:.0}"),
    }
}
