//! The schedule: rows of what is to be done, each within its window of time.
//!
//! [`parse`] says what a file asks for, or all that is wrong with it; [`validate`] holds its rows against the devices and
//! the sky.

mod fault;
mod fields;
mod file;
#[cfg(test)]
mod fuzz_tests;
pub mod nearest;
mod parse;
mod put;
mod row;
pub mod times;
pub mod validate;
pub mod versions;
mod written;

pub use fault::Fault;
pub use fields::{Defaults, defaults_of};
pub use file::{Loaded, keep_reading, read_text};
pub use nearest::meant;
pub use parse::{Reading, parse, read, read_with};
pub use put::put;
pub use row::{Row, RowId};
pub use written::{Position, Written};
