//! One type per quantity, so that a unit is visible where a value is made and where it is read.
//!
//! [`Angle`], [`Celsius`] and [`Utc`] cross every boundary of the house. Other numbers are plain `f64`
//! with the unit as the suffix of their name (`wind_mps`, `exposure_s`).

mod angle;
mod duration;
mod monotonic;
mod temperature;
mod utc;

pub use angle::Angle;
pub use duration::seconds;
pub use monotonic::{MachineTime, SkyTime};
pub use temperature::Celsius;
pub use utc::{BadTime, Utc};
