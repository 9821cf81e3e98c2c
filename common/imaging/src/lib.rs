//! Pixels in, facts out; and the star lists those facts are compared with.
//!
//! Pure: no files, no clock, no runtime. Pixel `(0, 0)` is the centre of the first pixel,
//! x is the column, y the row; FITS numbers are greater by one. Lengths are px, brightness is ADU.
//!
//! - [`frame`] is what comes in: raw counts or floats with their shape.
//! - [`clean`] takes away sky ([`background`]), bands and defects ([`bad_pixels`]).
//! - `trails` takes those of satellites and aircraft out.
//! - [`mod@measure`] finds the [`star`]s, measures them, and says what the frame is worth ([`quality`]);
//!   [`mosaic`] does so for cameras with colour filters on their pixels.
//! - [`shift`] computes from two star lists how far the field moved; [`projection`] from two cleaned frames.
//! - [`hfd`] measures the size of stars in and out of focus; [`focus`] finds the position where it is least.
//! - [`guide`] holds a field in its place: shifts in, pulses out.
//! - [`pointing`] computes where to send a telescope that misses, and learns how it misses.
//! - [`catalogue`] reads (and builds) the compact all-sky star catalogue from bytes.
//! - [`mod@solve`] finds which piece of the sky a star list shows, as a [`wcs`]; [`tangent`] lays the sky flat.
//! - [`healpix`] divides the sky into equal areas; the catalogue is ordered by it.
//!
//! The work on pixels runs on all cores, in plain loops over rows that the compiler turns into vector instructions.

pub mod background;
mod bad_pixel_votes;
mod bad_pixels;
mod banding;
mod camera;
mod candidates;
pub mod catalogue;
pub mod clean;
mod defect;
pub mod focus;
pub mod frame;
mod grid;
pub mod guide;
pub mod healpix;
pub mod hfd;
mod least_squares;
mod matched_filter;
pub mod measure;
pub mod mosaic;
mod parallel;
pub mod pointing;
mod profile;
pub mod projection;
pub mod quality;
mod raw;
pub mod shift;
pub mod solve;
pub mod star;
pub mod tangent;
mod trails;
pub mod wcs;
mod window;

pub use bad_pixel_votes::BadPixelVotes;
pub use bad_pixels::BadPixelMap;
pub use camera::Camera;
pub use clean::Clean;
pub use frame::{Frame, FrameError, Pixels};
pub use measure::{Measured, StarSearch, measure};
pub use mosaic::{is_mosaic, measure_mosaic};
pub use quality::Quality;
pub use shift::{NoShift, Shift};
pub use solve::{Hint, NoSolution, Solution, solve};
pub use star::{Flags, Star, spread_evenly};
pub use wcs::Wcs;
