//! The simulator over real HTTP, as a node sees it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod client;
mod devices;
mod faults;
mod guiding;
mod images;
mod motion;
