//! Pixels in, facts out; and the star lists those facts are compared with.
//!
//! Pure: no files, no clock, no runtime. Pixel `(0, 0)` is the centre of the first pixel,
//! x is the column, y the row; FITS numbers are greater by one. Lengths are px, brightness is ADU.
//!
//! - [`frame`] is what comes in: raw counts or floats with their shape.
//! - [`clean`] takes away sky ([`background`]), bands and defects ([`bad_pixels`]).
//! - [`measure`] finds the [`star`]s, measures them, and says what the frame is worth ([`quality`]).
//! - [`shift`] tells from two star lists how far the field moved; [`projection`] from two cleaned frames.
//! - [`catalogue`] reads (and builds) the compact all-sky star catalogue from bytes.
//! - [`healpix`] divides the sky into equal areas; the catalogue is ordered by it.
//!
//! The work on pixels runs on all cores, in plain loops over rows that the compiler turns into vector instructions.

pub mod background;
pub mod bad_pixels;
mod banding;
mod candidates;
pub mod catalogue;
pub mod clean;
mod defect;
pub mod frame;
mod grid;
pub mod healpix;
mod matched_filter;
pub mod measure;
mod parallel;
mod profile;
pub mod projection;
pub mod quality;
pub mod shift;
pub mod star;
mod window;

pub use clean::{Camera, Clean};
pub use frame::{Frame, FrameError, Pixels};
pub use measure::{Measured, Search, measure};
pub use quality::Quality;
pub use shift::{NoShift, Shift};
pub use star::{Flags, Star, spread_evenly};
