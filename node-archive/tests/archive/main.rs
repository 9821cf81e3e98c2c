//! Archive nodes on a real bus.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test ends by panicking")]

mod hands_over;
mod keeps_a_night;
mod keeps_focus_runs;
mod keeps_the_audit;
mod keeps_the_facts;
mod keeps_years;
mod writes_parquet;
