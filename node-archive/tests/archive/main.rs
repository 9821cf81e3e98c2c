//! Archive nodes on a real bus.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test ends by panicking")]

mod hands_over;
mod keeps_a_night;
mod keeps_focus_runs;
mod keeps_the_audit;
mod keeps_the_facts;
mod keeps_years;
mod writes_parquet;

/// A clock that says 02:30 UTC, far from the noon at which a night of Paranal ends: no test meets the change of nights.
fn in_the_night() -> bus::Clock {
    bus::Clock::simulated("2026-11-21T02:30:00Z".parse().unwrap(), 1.0)
}
