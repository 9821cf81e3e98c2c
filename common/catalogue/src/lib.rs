//! Star catalogues in files: opens them by their content, returns the stars of a cone, and converts them to our own
//! format.
//!
//! ```no_run
//! use catalogue::{Catalogue, Reading};
//! use units::Angle;
//!
//! let catalogue = Catalogue::open("gaia_tmass_12_jm_cut.db".as_ref(), &Reading::default())?;
//! let (ra, dec, radius) = (Angle::from_degrees(83.8), Angle::from_degrees(-5.4), Angle::from_degrees(0.5));
//! let stars = catalogue.cone(ra, dec, radius, 15.0, 2026.9)?;
//! # Ok::<(), catalogue::CatalogueError>(())
//! ```
//!
//! - [`Catalogue`] is a file that answers cones: our format (memory-mapped, `imaging::catalogue`), a Gaia-2MASS SQLite
//!   file ([`gaia_tmass`]), or a table in memory.
//! - [`each_star()`] reads any of the sources star by star; [`columns`] finds the columns of a table.
//! - [`Sorter`] makes our format of any number of stars, with bounded memory.
//!
//! Positions are ICRS, degrees; proper motions mas/yr, that in right ascension with cos(dec); epochs Julian years. A
//! star without proper motion is kept, with none: stars must not vanish because something about them is not known.

mod band;
pub mod columns;
mod csv_table;
mod each_star;
mod error;
mod fits_table;
pub mod gaia_tmass;
mod kind;
mod open;
mod reading;
mod shipped;
mod sort;

pub use band::Band;
pub use each_star::each_star;
pub use error::CatalogueError;
pub use kind::Kind;
pub use open::{At, Catalogue};
pub use reading::{EPOCH_YEAR, Reading, Row, Tally};
pub use shipped::shipped;
pub use sort::{Built, Sorter};
