//! A catalogue file that answers cones.

use std::cell::RefCell;
use std::fs::File;
use std::path::Path;

use imaging::catalogue::{self as packed, CatalogueStar, Entry, build, order_for};
use imaging::solve::Stars;
use memmap2::Mmap;
use units::Angle;

use crate::each_star::each_star;
use crate::error::CatalogueError;
use crate::gaia_tmass::GaiaTmass;
use crate::kind::Kind;
use crate::reading::{EPOCH_YEAR, Reading};

/// Barnard's star moves by 10.4" a year.
const FASTEST_ARCSEC_PER_YEAR: f64 = 10.5;

/// An open catalogue.
#[derive(Debug)]
pub enum Catalogue {
    /// Our own format, mapped from the disk: only the cells that a cone needs are read.
    Mapped(packed::Catalogue<Mmap>),
    /// The one that is part of the program.
    Embedded(packed::Catalogue<&'static [u8]>),
    /// A Gaia-2MASS SQLite file, asked by bands of declination.
    GaiaTmass(Box<GaiaTmass>),
    /// A FITS or CSV table, packed in memory.
    InMemory(packed::Catalogue<Vec<u8>>),
}

impl Catalogue {
    /// Opens a file by its content. The stars of our own format have the magnitudes and the epoch that it was built
    /// with; `reading` is for all others.
    ///
    /// # Errors
    /// [`CatalogueError`] when it cannot be read, or is no catalogue.
    pub fn open(file: &Path, reading: &Reading) -> Result<Self, CatalogueError> {
        match Kind::of(file)? {
            Kind::Packed => {
                let map = map(file).map_err(CatalogueError::file(file))?;
                let opened = packed::Catalogue::from_bytes(map);
                let broken = |source| CatalogueError::Packed { file: file.to_owned(), source };
                opened.map(Self::Mapped).map_err(broken)
            }
            Kind::Sqlite => GaiaTmass::open(file, reading).map(Box::new).map(Self::GaiaTmass),
            Kind::Fits | Kind::Csv => {
                let mut entries: Vec<Entry> = Vec::new();
                let mut take = |entry| {
                    entries.push(entry);
                    Ok(())
                };
                let tally = each_star(file, reading, &mut take)?;
                if entries.is_empty() {
                    let problem = format!(
                        "holds no star: {} rows without a place, {} without a magnitude",
                        tally.unplaced, tally.without_mag
                    );
                    return Err(CatalogueError::content(file, problem));
                }
                let bytes = build(&entries, order_for(entries.len(), 1.0), EPOCH_YEAR);
                let broken = |source| CatalogueError::Packed { file: file.to_owned(), source };
                packed::Catalogue::from_bytes(bytes).map(Self::InMemory).map_err(broken)
            }
        }
    }

    /// Number of stars; `None` where they are not counted.
    pub fn stars(&self) -> Option<usize> {
        match self {
            Self::Mapped(catalogue) => Some(catalogue.len()),
            Self::Embedded(catalogue) => Some(catalogue.len()),
            Self::InMemory(catalogue) => Some(catalogue.len()),
            Self::GaiaTmass(_) => None,
        }
    }

    /// The stars within `radius` of an ICRS direction, not fainter than `faintest_mag`, where they stand at
    /// `epoch_year` (Julian); in no particular order.
    ///
    /// # Errors
    /// [`CatalogueError`] when an SQLite file cannot be read any more.
    pub fn cone(
        &self,
        ra: Angle,
        dec: Angle,
        radius: Angle,
        faintest_mag: f64,
        epoch_year: f64,
    ) -> Result<Vec<CatalogueStar>, CatalogueError> {
        let file = match self {
            Self::Mapped(catalogue) => return Ok(catalogue.cone(ra, dec, radius, faintest_mag, epoch_year)),
            Self::Embedded(catalogue) => return Ok(catalogue.cone(ra, dec, radius, faintest_mag, epoch_year)),
            Self::InMemory(catalogue) => return Ok(catalogue.cone(ra, dec, radius, faintest_mag, epoch_year)),
            Self::GaiaTmass(file) => file,
        };
        let years = epoch_year - EPOCH_YEAR;
        // A star from outside the circle may have moved into it since.
        let reach = radius + Angle::from_arcseconds(FASTEST_ARCSEC_PER_YEAR * years.abs());
        let near = file.circle(ra, dec, reach)?.into_iter().filter(|entry| entry.mag <= faintest_mag);
        let now = near.map(|entry| entry.after(years));
        let inside = now.filter(|entry| {
            imaging::tangent::separation((entry.ra, entry.dec), (ra, dec)).degrees() <= radius.degrees()
        });
        Ok(inside.map(|Entry { ra, dec, mag, .. }| CatalogueStar { ra, dec, mag }).collect())
    }

    /// The catalogue as the solver asks it: at one epoch, a Julian year.
    pub fn at_epoch(&self, epoch_year: f64) -> At<'_> {
        At { catalogue: self, epoch_year, error: RefCell::new(None) }
    }
}

/// A catalogue at one epoch. The solver's interface has no errors for a failing disk, so the first error is stored
/// here.
#[derive(Debug)]
pub struct At<'a> {
    catalogue: &'a Catalogue,
    epoch_year: f64,
    error: RefCell<Option<CatalogueError>>,
}

impl At<'_> {
    /// The errors of the requests for stars. It has to be called after each solve: an answer without stars means
    /// nothing for the sky.
    ///
    /// # Errors
    /// The first [`CatalogueError`] since it was last asked.
    pub fn checked(&self) -> Result<(), CatalogueError> {
        self.error.borrow_mut().take().map_or(Ok(()), Err)
    }
}

impl Stars for At<'_> {
    fn cone(&self, ra: Angle, dec: Angle, radius: Angle, faintest_mag: f64) -> Vec<CatalogueStar> {
        self.catalogue.cone(ra, dec, radius, faintest_mag, self.epoch_year).unwrap_or_else(|error| {
            self.error.borrow_mut().get_or_insert(error);
            Vec::new()
        })
    }
}

#[allow(unsafe_code, reason = "a memory map is the point of the format")]
fn map(file: &Path) -> std::io::Result<Mmap> {
    let file = File::open(file)?;
    // SAFETY: the map is read only, and bytes that change below it give other stars but break no rule of types. It
    // must not be cut short while it is open: `Sorter` renames a whole file into place and leaves the old one as it is.
    unsafe { Mmap::map(&file) }
}
