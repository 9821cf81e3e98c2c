//! Stars of a FITS binary table.

use std::path::Path;

use fits::Table;
use imaging::catalogue::Entry;

use crate::columns::{Columns, row};
use crate::error::CatalogueError;
use crate::reading::{EPOCH_YEAR, Reading, Tally};

/// Calls `take` for each star.
pub(crate) fn each_star(
    file: &Path,
    reading: &Reading,
    take: &mut dyn FnMut(Entry) -> Result<(), CatalogueError>,
) -> Result<Tally, CatalogueError> {
    let mut table = Table::open(file)?;
    let cells = table.columns().to_vec();
    let names: Vec<String> = cells.iter().map(|column| column.name.clone()).collect();
    let columns = Columns::find(file, &names, reading)?;
    let motions = [columns.pm_ra, columns.pm_dec];
    let degrees = [Some(columns.ra), Some(columns.dec)];
    for (column, expected) in degrees.iter().map(|c| (c, "deg")).chain(motions.iter().map(|c| (c, "mas/yr"))) {
        let Some(column) = column.map(|column| &cells[column]) else { continue };
        if let Some(unit) = column.unit.as_deref().filter(|unit| !is_unit(unit, expected)) {
            let problem = format!("has {} in {unit}, expected {expected}; convert the column", column.name);
            return Err(CatalogueError::content(file, problem));
        }
    }
    let mut tally = Tally::default();
    while let Some(bytes) = table.next_row()? {
        let row = row(&columns, reading, |column| cells[column].value(bytes));
        if let Some(entry) = tally.entry(&row, reading.epoch_year.unwrap_or(EPOCH_YEAR)) {
            take(entry)?;
        }
    }
    Ok(tally)
}

/// Units as they are written: `mas/yr`, `mas.yr-1`, `mas yr**-1`, `degree`.
fn is_unit(unit: &str, expected: &str) -> bool {
    let plain: String = unit.to_lowercase().chars().filter(|c| c.is_alphabetic()).collect();
    match expected {
        "deg" => ["", "deg", "degree", "degrees"].contains(&plain.as_str()),
        _ => ["", "masyr", "masyear", "masa"].contains(&plain.as_str()),
    }
}
