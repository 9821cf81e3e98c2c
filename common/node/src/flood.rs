//! Keeps a flood of log lines from filling a disk or the bus: each place in the code may log only so much at a time.
//!
//! zenoh complains about each sample of a peer whose clock is off, thousands of times an hour; and a diary that carries
//! complaints about its own transport would feed itself.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tracing::callsite::Identifier;
use tracing::{Event, Metadata};
use tracing_subscriber::layer::{Context, Filter};

/// Lines that each place of our own code may log in one window.
const OWN: Allowance = Allowance { lines: 300, window: Duration::from_secs(10) };
/// Those of libraries.
const FOREIGN: Allowance = Allowance { lines: 10, window: Duration::from_secs(60) };
/// What our libraries call themselves; `log` is any library that logs by that crate.
const LIBRARIES: [&str; 5] = ["zenoh", "log", "uhlc", "hyper", "rustls"];

static LEFT_OUT: AtomicU64 = AtomicU64::new(0);

/// Lines left out since the start.
pub fn left_out() -> u64 {
    LEFT_OUT.load(Ordering::Relaxed)
}

#[derive(Debug, Clone, Copy)]
struct Allowance {
    lines: u32,
    window: Duration,
}

/// The filter; one for each place where lines go.
#[derive(Debug, Default)]
pub struct Flood {
    places: Mutex<HashMap<Identifier, Count>>,
}

/// How much one place has logged in its window.
#[derive(Debug)]
struct Count {
    since: Instant,
    lines: u32,
}

impl Count {
    fn allows(&mut self, now: Instant, allowance: Allowance) -> bool {
        if now.duration_since(self.since) > allowance.window {
            *self = Self { since: now, lines: 0 };
        }
        self.lines += 1;
        self.lines <= allowance.lines
    }
}

impl<S> Filter<S> for Flood {
    fn enabled(&self, _: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        true
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        let is_foreign = LIBRARIES.iter().any(|library| metadata.target().starts_with(library));
        let now = Instant::now();
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let count = places.entry(metadata.callsite()).or_insert(Count { since: now, lines: 0 });
        let allowed = count.allows(now, if is_foreign { FOREIGN } else { OWN });
        if !allowed {
            LEFT_OUT.fetch_add(1, Ordering::Relaxed);
        }
        allowed
    }
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;
    use tracing_subscriber::{Layer, fmt};

    use super::*;

    #[derive(Clone, Default)]
    struct Page(std::sync::Arc<Mutex<Vec<u8>>>);

    impl std::io::Write for Page {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_library_that_repeats_itself_is_cut_short_and_others_still_speak() {
        let page = Page::default();
        let writer = page.clone();
        let layer = fmt::layer().with_writer(move || writer.clone()).with_filter(Flood::default());
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            for _ in 0..1000 {
                tracing::error!(target: "zenoh::net", "unknown scope");
            }
            tracing::info!("the sky is safe");
        });
        let text = String::from_utf8(page.0.lock().unwrap().clone()).unwrap();
        assert_eq!(text.matches("unknown scope").count(), 10);
        assert_eq!(text.matches("the sky is safe").count(), 1);
        assert!(left_out() >= 990);
    }

    #[test]
    fn a_place_of_our_own_code_has_its_own_larger_share() {
        let page = Page::default();
        let writer = page.clone();
        let layer = fmt::layer().with_writer(move || writer.clone()).with_filter(Flood::default());
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            for number in 0..1000 {
                tracing::info!("poll {number}.");
                tracing::info!("answer {number}.");
            }
        });
        let text = String::from_utf8(page.0.lock().unwrap().clone()).unwrap();
        for place in ["poll", "answer"] {
            assert_eq!(text.matches(place).count(), 300, "{place}");
            assert!(text.contains(&format!("{place} 299.")), "the first lines, which show how it began");
        }
    }

    #[test]
    fn after_its_window_a_place_may_speak_again() {
        let began = Instant::now();
        let mut count = Count { since: began, lines: 0 };
        let allowed = (0..100).filter(|_| count.allows(began, FOREIGN)).count();
        assert_eq!(allowed, 10);
        assert!(!count.allows(began + Duration::from_secs(60), FOREIGN));
        assert!(count.allows(began + Duration::from_secs(61), FOREIGN));
    }
}
