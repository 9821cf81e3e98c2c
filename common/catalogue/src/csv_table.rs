//! Stars of a table in text: a line of names, then a line for each star, with commas between. Lines that begin with
//! `#` are comments; an empty cell, `null` or `nan` is not known.

use std::path::Path;

use csv::{ReaderBuilder, Trim};
use imaging::catalogue::Entry;

use crate::columns::{Columns, row};
use crate::error::CatalogueError;
use crate::kind::text;
use crate::reading::{EPOCH_YEAR, Reading, Tally};

/// Calls `take` for each star.
pub(crate) fn each_star(
    file: &Path,
    reading: &Reading,
    take: &mut dyn FnMut(Entry) -> Result<(), CatalogueError>,
) -> Result<Tally, CatalogueError> {
    let broken = |source| CatalogueError::Csv { file: file.to_owned(), source };
    let mut table = ReaderBuilder::new().comment(Some(b'#')).trim(Trim::All).from_reader(text(file)?);
    let names: Vec<String> = table.headers().map_err(broken)?.iter().map(str::to_owned).collect();
    let columns = Columns::find(file, &names, reading)?;
    let (mut tally, mut record) = (Tally::default(), csv::StringRecord::new());
    while table.read_record(&mut record).map_err(broken)? {
        for column in [Some(columns.ra), Some(columns.dec), columns.pm_ra, columns.pm_dec].into_iter().flatten() {
            let cell = record.get(column).unwrap_or_default();
            if !is_unknown(cell) && number(cell).is_none() {
                let line = record.position().map_or(0, csv::Position::line);
                let problem = format!("has {cell:?} for {} in line {line}; expected a number", names[column]);
                return Err(CatalogueError::content(file, problem));
            }
        }
        let row = row(&columns, reading, |column| number(record.get(column)?));
        if let Some(entry) = tally.entry(&row, reading.epoch_year.unwrap_or(EPOCH_YEAR)) {
            take(entry)?;
        }
    }
    Ok(tally)
}

fn is_unknown(cell: &str) -> bool {
    cell.is_empty() || ["null", "nan", "none"].contains(&cell.to_ascii_lowercase().as_str())
}

fn number(cell: &str) -> Option<f64> {
    match cell.to_ascii_lowercase().as_str() {
        "true" | "t" => Some(1.0),
        "false" | "f" => Some(0.0),
        cell => cell.parse().ok().filter(|number: &f64| number.is_finite()),
    }
}
