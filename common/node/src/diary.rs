//! Log lines at level info and above, carried from `tracing` to the bus.

use std::collections::BTreeMap;
use std::fmt;

use contract::node::{DiaryLine, Level};
use contract::printable;
use tokio::sync::mpsc;
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::layer::{Context, Layer};

/// Sends each line into a bounded channel; when nobody takes them, new lines are dropped, the console has them.
pub struct DiaryLayer {
    lines: mpsc::Sender<DiaryLine>,
}

impl DiaryLayer {
    /// The layer and the end where its lines come out.
    pub fn new() -> (Self, mpsc::Receiver<DiaryLine>) {
        let (lines, taken) = mpsc::channel(1000);
        (Self { lines }, taken)
    }
}

impl<S: Subscriber> Layer<S> for DiaryLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let level = match *event.metadata().level() {
            tracing::Level::ERROR => Level::Error,
            tracing::Level::WARN => Level::Warn,
            tracing::Level::INFO => Level::Info,
            _ => return,
        };
        let mut words = Words::default();
        event.record(&mut words);
        let target = event.metadata().target().to_owned();
        let line = DiaryLine { level, target, message: words.message, fields: words.fields };
        // It is full only while the bus is not up or is stuck; the console keeps the line.
        let _ = self.lines.try_send(line);
    }
}

#[derive(Default)]
struct Words {
    message: String,
    fields: BTreeMap<String, String>,
}

impl Visit for Words {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.message = printable(&format!("{value:?}")).into_owned();
        } else {
            self.fields.insert(field.name().to_owned(), printable(&format!("{value:?}")).into_owned());
        }
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "message" {
            self.message = printable(value).into_owned();
        } else {
            self.fields.insert(field.name().to_owned(), printable(value).into_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    #[test]
    fn what_comes_from_outside_stays_within_its_line() {
        let (layer, mut lines) = DiaryLayer::new();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            let object = "M31\n2026-11-22T03:00:00Z ERROR the dome is open\u{1b}[2J";
            tracing::info!(%object, text = object, "row begins: {object}");
        });
        let line = lines.try_recv().unwrap();
        let all = [&line.message, &line.fields["object"], &line.fields["text"]];
        assert!(all.iter().all(|text| !text.contains(char::is_control)), "{all:?}");
        assert!(line.message.starts_with("row begins: M31\\n2026"), "{}", line.message);
    }
}
