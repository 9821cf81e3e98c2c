//! What zenoh logs, in the words of an operator, and only what an operator can act on.
//!
//! zenoh warns of much that it mends by itself within a second: samples that come before their key is declared,
//! addresses of a peer that only its own host can reach, answers that come after their question has ended. A start of a
//! few nodes prints dozens of such lines. `STARMESH_LOG=zenoh=debug` shows all of them as they are.

use std::collections::HashMap;
use std::fmt::{Debug, Write as _};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::layer::{Context, Layer};

/// Each of our sentences is logged again after so long at the earliest.
const PAUSE: Duration = Duration::from_secs(600);
/// The details of zenoh are cut there.
const DETAIL_CHARS: usize = 300;

/// A part of a line of zenoh, and what it means for the site.
const MEANINGS: &[(&str, &str)] = &[
    (
        "increase the system open file limit",
        "the bus cannot accept a connection: this process has too many open files; raise its limit (ulimit -n, or LimitNOFILE \
         of the systemd unit)",
    ),
    (
        "Error treating timestamp",
        "the clock of another host on the bus is ahead of this one by more than half a second; check the time service of both \
         hosts",
    ),
    (
        "Max transports reached",
        "the bus has no room for another program: a thousand are connected; look for one that connects again and again",
    ),
    (
        "Defragmentation buffer full",
        "a program on the bus sent a message that is too large, and was cut off; nodes send at most 4 MB",
    ),
    (
        "Unable to find interface",
        "a network interface that zenoh is configured to use does not exist; check the settings of zenoh",
    ),
    (
        "Unable to join multicast group",
        "nodes cannot be found by multicast on one of the interfaces; where others are not found, name one under [bus] connect",
    ),
    (
        "Unable to bind UDP port",
        "nodes cannot be found by multicast: its port cannot be used; where others are not found, name one under [bus] connect",
    ),
    (
        "Unable to push non droppable network message",
        "a node takes nothing from its link, which begins anew; if this is repeated, look at the load of both hosts",
    ),
];

/// Logs in our words the lines of zenoh that matter.
#[derive(Debug)]
pub struct ZenohLog {
    reported: Mutex<HashMap<&'static str, Instant>>,
    /// A line cannot be logged while another one is: a thread of its own does it.
    lines: SyncSender<(&'static str, String)>,
}

impl ZenohLog {
    /// Starts the thread that logs what is found.
    pub fn start() -> Self {
        let (lines, found) = sync_channel::<(&str, String)>(16);
        std::thread::spawn(move || {
            for (meaning, detail) in found {
                tracing::warn!(target: "bus", detail, "{meaning}");
            }
        });
        Self { reported: Mutex::default(), lines }
    }

    /// The sentence for a line of zenoh, unless it was logged a short time ago.
    fn due(&self, line: &str, now: Instant) -> Option<&'static str> {
        let (_, meaning) = MEANINGS.iter().find(|(part, _)| line.contains(part))?;
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        let is_due = reported.get(meaning).is_none_or(|at| now.duration_since(*at) >= PAUSE);
        if is_due {
            reported.insert(meaning, now);
        }
        is_due.then_some(*meaning)
    }
}

/// Does this line come from zenoh, or from the clock that it stamps samples with?
pub fn is_zenoh(target: &str) -> bool {
    target.starts_with("zenoh") || target.starts_with("uhlc")
}

impl<S: Subscriber> Layer<S> for ZenohLog {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let metadata = event.metadata();
        if *metadata.level() > Level::WARN || !is_zenoh(metadata.target()) {
            return;
        }
        let mut line = LogText::default();
        event.record(&mut line);
        if let Some(meaning) = self.due(&line.0, Instant::now()) {
            let detail: String = line.0.chars().filter(|c| !c.is_control()).take(DETAIL_CHARS).collect();
            // It is full only while the console hangs.
            let _ = self.lines.try_send((meaning, detail));
        }
    }
}

#[derive(Default)]
struct LogText(String);

impl Visit for LogText {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        let _ = match field.name() {
            "message" => write!(self.0, "{value:?}"),
            name => write!(self.0, " {name}={value:?}"),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_zenoh_mends_by_itself_is_not_logged_and_the_rest_in_plain_words_once() {
        let (log, now) = (ZenohLog::start(), Instant::now());
        for noise in [
            "Received Data for unknown key_expr: Received wire expr with unknown scope 17",
            "Unable to connect to any locator of scouted peer 1a2b: [tcp/172.17.0.1:41234]",
            "Received ReplyData for unknown Query: 12",
            "Scouting delay elapsed before start conditions are met.",
        ] {
            assert_eq!(log.due(noise, now), None, "{noise}");
        }
        let full = "Too many open files (os error 24). Hint: increase the system open file limit.";
        assert!(log.due(full, now).is_some_and(|words| words.contains("LimitNOFILE")));
        assert_eq!(log.due(full, now + PAUSE / 2), None);
        assert!(log.due(full, now + PAUSE).is_some());
    }
}
