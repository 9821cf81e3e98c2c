//! The schedule of a telescope, without devices, bus or clock: what its rows ask for, whether that makes sense, which row is next,
//! and how a night would go.
//!
//! - Reading: [`parse`] says what a text asks for, or everything that is wrong with it; [`action`] holds the parameters of
//!   each action, from which refusals, documents and forms are made.
//! - Validation: [`validate`] compares the rows with the devices and the sky; [`names`] holds the targets that were looked up.
//! - Order: [`sequence`] chooses the next row, the same for the observatory node and for a forecast.
//! - Forecast: [`plan`] works through a schedule on a clock that jumps from event to event.
//! - Decisions of actions that both need: [`flats`], [`moving_target`], [`meridian_flip`], [`pointing_grid`],
//!   [`horizon_limits`], [`slew_limits`].
//!
//! Nothing here knows a device, the bus or a clock; `now` is given. Files are read only where the configuration names them: the
//! schedule itself, horizons, and names that were looked up.

pub mod action;
pub mod fault;
pub mod fields;
mod file;
pub mod flats;
pub mod focus_meter;
#[cfg(test)]
mod fuzz_tests;
pub mod horizon_limits;
pub mod meridian_flip;
pub mod moving_target;
pub mod names;
pub mod parse;
pub mod pick;
pub mod plan;
pub mod pointing_grid;
pub mod rests;
pub mod row;
pub mod sequence;
pub mod shot;
pub mod slew_limits;
pub mod times;
pub mod validate;
pub mod written;
pub mod wrong;

pub use config::meant;
pub use fault::Fault;
pub use fields::{Defaults, defaults_of};
pub use file::read_text;
pub use parse::{Reading, parse, read, read_with};
pub use row::{Row, RowId};
pub use written::{Position, Written};
pub use wrong::Wrong;
