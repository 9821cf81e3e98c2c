//! Waiting for what a test expects.

use std::time::{Duration, Instant};

/// Only what hangs takes longer, also on a machine that is ten times as busy as it should be.
pub const LIMIT: Duration = Duration::from_secs(240);
/// How often a test looks.
const PERIOD: Duration = Duration::from_millis(10);

/// Looks until something is there; `None` after `limit`.
pub async fn within<T>(limit: Duration, mut look: impl FnMut() -> Option<T>) -> Option<T> {
    let began = Instant::now();
    loop {
        let found = look();
        if found.is_some() || began.elapsed() > limit {
            return found;
        }
        tokio::time::sleep(PERIOD).await;
    }
}

/// Waits until something holds.
///
/// # Panics
/// When it does not hold within [`LIMIT`].
pub async fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let held = within(LIMIT, || holds().then_some(())).await;
    assert!(held.is_some(), "not within {LIMIT:?}: {what}");
}
