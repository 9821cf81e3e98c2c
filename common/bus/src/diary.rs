//! Log lines at level info and above, carried from `tracing` to the bus.

use std::collections::BTreeMap;
use std::fmt;

use contract::node::{DiaryLine, Level};
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
        // full only while the bus is not up or is stuck; the console keeps the line
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
            self.message = format!("{value:?}");
        } else {
            self.fields.insert(field.name().to_owned(), format!("{value:?}"));
        }
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "message" {
            self.message = value.to_owned();
        } else {
            self.fields.insert(field.name().to_owned(), value.to_owned());
        }
    }
}
