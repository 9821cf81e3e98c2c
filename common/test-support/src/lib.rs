//! Support for the tests of several crates: a private bus, nodes, simulated observatories, and ways to wait.
//!
//! Tests name this crate under `[dev-dependencies]` only. There are two ways to run a node:
//!
//! - in the process of the test, as a [`RunningNode`] on a private bus ([`private_bus()`], [`join`]);
//! - as a process of its own, by a [`Harness`]: the simulated observatory, real node processes, and a private bus. A
//!   [`Harness`] is for tests in which a process dies, and asserts on topics, as an operator would see them. Its tests
//!   need `cargo build --workspace` first (`scripts/test` does that).
//!
//! Each test has its own world, folder, loopback bus and ports, so tests run side by side.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test ends by panicking")]

mod browser;
mod dome_node;
mod frame;
mod harness;
mod header;
mod lateness;
mod night;
mod private_bus;
mod running_node;
mod site;
mod wait;
mod web_server;

pub use browser::Browser;
pub use dome_node::{DomeNode, dome_state};
pub use frame::frame;
pub use harness::{Harness, HarnessOptions, SITE, TELESCOPE};
pub use header::header;
pub use lateness::Lateness;
pub use night::{Rows, example, long_row, object, row, schedule_line};
pub use private_bus::{join, private, private_bus};
pub use running_node::RunningNode;
pub use site::{ALPHA, PARANAL, block, section};
pub use wait::{LIMIT, until, within};
pub use web_server::serve;
