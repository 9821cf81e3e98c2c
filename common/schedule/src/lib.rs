//! The schedule of a telescope, without devices, bus or clock: the meaning of its rows, their validation, the choice of
//! the next row, and the forecast of a night.
//!
//! - Reading: [`parse()`] returns the rows of a text, or everything that is wrong with it; [`action`] holds the
//!   parameters of each action, from which refusals, documents and forms are made.
//! - Validation: [`validate`] compares the rows with the devices and the sky; [`names`] holds the targets that were
//!   looked up.
//! - Order: [`sequence`] chooses the next row, the same for the observatory node and for a forecast.
//! - Comparison: [`difference`] lists which rows another text adds, removes and changes.
//! - Forecast: [`plan`] works through a schedule on a clock that jumps from event to event.
//! - Decisions of actions that both the forecast and the observatory node need: [`flats`], [`moving_target`],
//!   [`meridian_flip`], [`kept_place`], [`pointing_grid`], [`horizon_limits`], [`slew_limits`].
//!
//! Nothing here knows a device, the bus or a clock; `now` is given. Files are read only where the configuration names
//! them: the schedule itself, horizons, and names that were looked up.
//!
//! # Invariants
//!
//! - `sequence.rs`, which is pure, decides which rows run at the same time:
//!   `no_schedule_opens_under_an_unsafe_sky_or_lets_two_rows_have_one_mount`.
//! - The type of an action describes its parameters once; refusals, page, command line and bus are generated from it
//!   (decision 0026): `the_page_about_the_schedule_is_what_the_actions_declare`.
//! - The state of the sky never refuses a schedule (decision 0027): `what_the_sky_does_is_reported_and_refuses_nothing`
//!   (`starmesh/tests/commands/checks_wrong_schedules.rs`).
//! - A schedule is checked against the same horizon and altitude as a slew (`horizon_limits.rs`, decision 0036):
//!   `nothing_is_observed_behind_the_horizon_or_below_the_least_altitude`. Every slew goes through `Mount::point` and
//!   its limits (`slew_limits.rs`, decision 0030): `no_target_within_reach_stands_beyond_a_limit`.
//! - A forecast has no rule of its own: each action has its steps in `plan/steps` (decision 0032):
//!   `every_golden_plan_is_as_in_its_file`.

pub mod action;
pub mod difference;
pub mod fault;
pub mod fields;
mod file;
pub mod flats;
pub mod focus_meter;
#[cfg(test)]
mod fuzz_tests;
pub mod horizon_limits;
pub mod kept_place;
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
pub use row::{PartOfRow, Row, RowId};
pub use written::{Position, Written};
pub use wrong::Wrong;
