//! Pixels in, facts out; and the star lists those facts are compared with.
//!
//! Pure: no files, no clock, no runtime. Pixel `(0, 0)` is the centre of the first pixel,
//! x is the column, y the row.
//!
//! - [`catalogue`] reads (and builds) the compact all-sky star catalogue from bytes.
//! - [`healpix`] divides the sky into equal areas; the catalogue is ordered by it.

pub mod catalogue;
pub mod healpix;
