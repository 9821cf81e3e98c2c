//! Reads stars from any kind of file, one after the other, all at one epoch.

use std::path::Path;

use imaging::catalogue::Entry;

use crate::error::CatalogueError;
use crate::gaia_tmass::GaiaTmass;
use crate::kind::Kind;
use crate::reading::{Reading, Tally};
use crate::{csv_table, fits_table};

/// Calls `take` for each star of a file, at [`crate::EPOCH_YEAR`], and counts them. Memory does not grow with the file.
///
/// # Errors
/// [`CatalogueError`] when the file cannot be read as a catalogue, and any error of `take`.
pub fn each_star(
    file: &Path,
    reading: &Reading,
    take: &mut dyn FnMut(Entry) -> Result<(), CatalogueError>,
) -> Result<Tally, CatalogueError> {
    match Kind::of(file)? {
        Kind::Packed => Err(CatalogueError::content(
            file,
            "is in Starmesh's own format already; give what it is to be built from, or use it as it is",
        )),
        Kind::Sqlite => GaiaTmass::open(file, reading)?.each_star(take),
        Kind::Fits => fits_table::each_star(file, reading, take),
        Kind::Csv => csv_table::each_star(file, reading, take),
    }
}
