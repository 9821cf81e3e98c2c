//! The log of a process: lines on the console, and the diary on the bus.

use std::io::IsTerminal as _;

use bus::zenoh_log::{ZenohLog, is_zenoh};
use contract::node::DiaryLine;
use tokio::sync::mpsc;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{FilterExt as _, filter_fn};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::console;
use crate::diary::DiaryLayer;
use crate::flood::Flood;
use crate::lines::LogLine;

/// Log lines on the console, for a process that is no node.
pub fn log_to_console() {
    // A second subscriber is not needed.
    let _ = console_at("info").try_init();
}

/// Console at the level of `STARMESH_LOG` (default info), and the diary; `None` where a subscriber is set already.
pub(crate) fn init_tracing() -> Option<mpsc::Receiver<DiaryLine>> {
    let (diary, lines) = DiaryLayer::new();
    // The bus's own complaints stay off the bus: it would complain of them, too.
    let diary_filter = tracing_subscriber::EnvFilter::new("info,zenoh=off,uhlc=off").and(Flood::default());
    let set = on_console().with(diary.with_filter(diary_filter)).try_init();
    set.is_ok().then_some(lines)
}

/// Shows what a command does on the console, at the level of `STARMESH_LOG` (default warnings).
pub fn show_log() {
    // A second subscriber is not needed.
    let _ = console_at("warn").try_init();
}

fn on_console() -> impl tracing::Subscriber + for<'a> LookupSpan<'a> + Send + Sync {
    console_at("info")
}

/// The console. zenoh's own lines are printed only if `STARMESH_LOG` names zenoh; our own lines report what they mean.
fn console_at(level: &str) -> impl tracing::Subscriber + for<'a> LookupSpan<'a> + Send + Sync {
    let mut words = std::env::var("STARMESH_LOG").unwrap_or_else(|_| level.to_owned());
    if !words.contains("zenoh") {
        words.push_str(",zenoh=off,uhlc=off");
    }
    let filter = tracing_subscriber::EnvFilter::new(words).and(Flood::default());
    let colour = std::io::stderr().is_terminal();
    let console = tracing_subscriber::fmt::layer().fmt_fields(console::fields()).with_writer(|| LogLine);
    let console = console.with_ansi(colour).with_filter(filter);
    let of_zenoh = filter_fn(|metadata| is_zenoh(metadata.target()) && *metadata.level() <= tracing::Level::WARN);
    tracing_subscriber::registry().with(console).with(ZenohLog::start().with_filter(of_zenoh))
}
