//! One type per quantity, so that a unit is visible where a value is made and where it is read.
//!
//! [`Angle`], [`Celsius`] and [`Utc`] cross every boundary of the house. [`MachineTime`] and [`SkyTime`] are monotonic; only
//! `bus::Clock` reads the clocks behind them. Other numbers are plain `f64`
//! with the unit as the suffix of their name (`wind_mps`, `exposure_s`).

mod angle;
mod duration;
mod machine_time;
mod sky_time;
mod temperature;
mod utc;

pub use angle::Angle;
pub use duration::seconds;
pub use machine_time::MachineTime;
pub use sky_time::SkyTime;
pub use temperature::Celsius;
pub use utc::{BadTime, Utc};
