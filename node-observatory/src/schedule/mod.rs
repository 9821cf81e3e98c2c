//! The schedule: rows of what is to be done, each within its window of time.

mod file;
mod nearest;
mod parse;
mod row;

pub use file::{Loaded, keep_reading};
pub use parse::{Fault, parse};
pub use row::{Row, RowId};
