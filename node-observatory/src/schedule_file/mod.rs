//! The schedule file of the telescope: read when it changes, replaced by order, and its findings published.
//!
//! The crate `schedule` defines what a schedule is.

mod file;
pub mod findings;
mod put;
pub mod versions;

pub use file::{Loaded, keep_reading};
pub use put::put;
