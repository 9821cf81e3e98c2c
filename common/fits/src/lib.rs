//! Opens any FITS image: its header and its pixels.
//!
//! ```no_run
//! let image = fits::read("m31.fits.fz".as_ref())?;
//! let exposure_s = image.header.number("EXPTIME")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Plain files and those packed by gzip or bzip2 are recognized by their first bytes, not by their names; images that
//! are compressed in tiles (`.fz`) are decoded by cfitsio. The first image with pixels is taken, or that of an HDU. An
//! error contains the file's name, the fault and what to do ([`FitsError`], [`KeywordError`]); nothing panics, for any
//! bytes.
//!
//! - [`image`] is the result: header, size, pixels.
//! - [`header`] answers keywords with the type that was asked for; [`card`] reads one line of it.
//! - [`cards`] is every card of a file with its comment.
//! - [`hdu`] finds the parts of a file, [`decode`] turns bytes into pixels, [`tiles`] asks cfitsio to do so where
//!   [`tiling`] makes sense, [`unpack`] unpacks gzip and bzip2 as far as headers require, [`planes`] makes one plane of
//!   three.
//! - [`restore`] gives the plain file of an image in tiles, as `funpack` does.
//! - [`rows`] reads the counts of a plain image some rows at a time.
//! - [`rewrite`] changes a header in its file, whole or not at all.
//! - [`cube`] makes one file of many frames.
//! - [`profile`] is what archives want of a file: profiles, checks, delivered copies; [`checksum`] the sums of an HDU.
//! - [`table`] reads the rows of binary tables, of any length.
//! - [`cfitsio`] is the part that all users of that library share: its lock and its messages.
//!
//! Pixel `(0, 0)` is the first of the file, x the column (axis 1), y the row; FITS numbers are greater by one.
//! The format is that of the FITS Standard 4.0 (IAU FITS Working Group, 2018), cited by section.

pub mod card;
pub mod cards;
pub mod cfitsio;
pub mod checksum;
pub mod cube;
mod decode;
pub mod error;
pub mod hdu;
pub mod header;
pub mod image;
mod part;
mod pixels;
mod planes;
pub mod profile;
pub mod restore;
pub mod rewrite;
pub mod rows;
pub mod table;
mod tiles;
mod tiling;
mod unpack;

pub use error::{Fault, FitsError};
pub use header::{Header, KeywordError};
pub use image::{Image, Part, parse, read, read_part};
pub use pixels::Pixels;
pub use table::Table;
