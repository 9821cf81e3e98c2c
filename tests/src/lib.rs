//! A telescope for end-to-end tests: the simulated observatory, real node processes, and a private bus.
//!
//! Each test has its own [`Rig`]: its own world, folder, loopback bus and ports, so tests run side by side. Nodes
//! are processes, because a death is often the point; faults are caused through the world, and what happens is
//! asserted on topics, as an operator would see it. Run `cargo build --workspace` first (scripts/test does).

mod header;
#[path = "../support/lateness.rs"]
mod lateness;
mod night;
mod rig;

pub use header::header;
pub use lateness::Lateness;
pub use night::{Rows, example, long_row, object, row};
pub use rig::{Rig, RigOptions, SITE, TELESCOPE};
