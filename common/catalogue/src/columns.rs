//! Finds the columns of a table by their names.

use std::path::Path;

use crate::band::Band;
use crate::error::CatalogueError;
use crate::reading::{EPOCH_YEAR, Reading, Row};

const RA: &[&str] = &["ra", "ra_deg", "ra_icrs", "raj2000", "ra_j2000", "_ra"];
const DEC: &[&str] = &["dec", "dec_deg", "de_icrs", "dec_icrs", "dej2000", "decj2000", "dec_j2000", "_de"];
const PM_RA: &[&str] = &["pmra", "pm_ra", "pmra_mas", "pmra_cosdec"];
const PM_DEC: &[&str] = &["pmdec", "pm_dec", "pmde", "pmdec_mas"];
const EPOCH: &[&str] = &["epoch", "ref_epoch", "epoch_year"];
const MAG: &[&str] = &["mag", "magnitude", "vmag", "vtmag"];

/// The numbers of the columns of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Columns {
    /// Right ascension, degrees.
    pub ra: usize,
    /// Declination, degrees.
    pub dec: usize,
    /// Proper motion in right ascension times cos(dec), mas/yr.
    pub pm_ra: Option<usize>,
    /// Proper motion in declination, mas/yr.
    pub pm_dec: Option<usize>,
    /// Magnitude, and the others that replace it where a star has none of it.
    pub mags: Vec<usize>,
    /// Epoch of the position, Julian year.
    pub epoch: Option<usize>,
    /// Whether its proper motion is known, where there is such a column.
    pub pm_known: Option<usize>,
    /// Whether the star is Gaia's (epoch 2016.0) or not (2000.0), where no column contains the epoch.
    pub gaia: Option<usize>,
}

impl Columns {
    /// Finds the columns by their names, whatever their case.
    ///
    /// # Errors
    /// [`CatalogueError::Content`] when there is no position or no magnitude, naming what there is.
    pub fn find(file: &Path, names: &[String], reading: &Reading) -> Result<Self, CatalogueError> {
        let first = |wanted: &[&str]| {
            wanted.iter().find_map(|word| names.iter().position(|name| name.trim().eq_ignore_ascii_case(word)))
        };
        let refuse = |what: String| {
            CatalogueError::content(file, format!("has no {what} among its columns {}", names.join(", ")))
        };
        let needed = |what: &str, wanted: &[&str]| {
            first(wanted).ok_or_else(|| refuse(format!("{what} (degrees; called {})", wanted.join(", "))))
        };
        let band = match reading.band {
            Some(band) => Some(
                first(band.names())
                    .ok_or_else(|| refuse(format!("magnitude {band:?} (called {})", band.names().join(", "))))?,
            ),
            None => first(MAG),
        };
        let stand_in = Band::ALL.iter().filter_map(|band| first(band.names()));
        let mut mags: Vec<usize> = Vec::new();
        for column in band.into_iter().chain(stand_in).chain(first(MAG)) {
            if !mags.contains(&column) {
                mags.push(column);
            }
        }
        if mags.is_empty() {
            return Err(refuse("magnitude (called mag, or as Gaia and 2MASS do)".to_owned()));
        }
        let columns = Self {
            ra: needed("right ascension", RA)?,
            dec: needed("declination", DEC)?,
            pm_ra: first(PM_RA),
            pm_dec: first(PM_DEC),
            mags,
            epoch: first(EPOCH),
            pm_known: first(&["pm_known"]),
            gaia: first(&["gaia"]),
        };
        if columns.pm_ra.is_some() != columns.pm_dec.is_some() {
            return Err(refuse("pair of proper motions: one of pmra and pmdec is missing".to_owned()));
        }
        Ok(columns)
    }
}

/// The row of a table; `cell` returns its cells.
pub(crate) fn row(columns: &Columns, reading: &Reading, cell: impl Fn(usize) -> Option<f64>) -> Row {
    let stated = columns.epoch.and_then(&cell);
    // The table from which Starmesh's own catalogue is made: Gaia's stars at 2016.0, Tycho's at 2000.0.
    let by_source = columns.gaia.and_then(&cell).map(|gaia| if gaia > 0.0 { EPOCH_YEAR } else { 2000.0 });
    let moves = columns.pm_known.and_then(&cell).is_none_or(|known| known > 0.0);
    let motion = |column: Option<usize>| column.filter(|_| moves).and_then(&cell);
    Row {
        ra_deg: cell(columns.ra),
        dec_deg: cell(columns.dec),
        pm_ra_mas: motion(columns.pm_ra),
        pm_dec_mas: motion(columns.pm_dec),
        mag: columns.mags.iter().find_map(|column| cell(*column)),
        epoch_year: stated.or(reading.epoch_year).or(by_source),
    }
}
