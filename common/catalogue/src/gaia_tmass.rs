//! The Gaia-2MASS SQLite files that sites have (`gaia_tmass_<J>_jm_cut.db`, Zenodo 18214672): 180 tables, `-90_-89` to
//! `89_90`, one for each degree of declination, without an index; an unknown value is empty text.
//!
//! Those files hold `ra, dec, pmra, pmdec, phot_g_mean_mag, j_m` of Gaia DR2, so their positions are of 2015.5; files
//! that hold BP and RP too were made from Gaia DR3, of 2016.0. `Reading::epoch_year` replaces either.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use imaging::catalogue::Entry;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags, Params};
use units::Angle;

use crate::columns::{Columns, row};
use crate::error::CatalogueError;
use crate::reading::{EPOCH_YEAR, Reading, Tally};

/// Epoch of Gaia DR2, Julian year.
const DR2_EPOCH_YEAR: f64 = 2015.5;
/// Barnard's star moves by 10.4" a year.
const FASTEST_ARCSEC_PER_YEAR: f64 = 10.5;

/// An open file.
#[derive(Debug)]
pub struct GaiaTmass {
    file: PathBuf,
    reading: Reading,
    epoch_year: f64,
    /// Lowest declinations of the tables that are there, degrees.
    shards: Vec<i32>,
    columns: Columns,
    names: Vec<String>,
    inner: Mutex<Inner>,
}

#[derive(Debug)]
struct Inner {
    connection: Connection,
    /// The circle that was read last: a table is read to its end for each question, so the next one inside of the
    /// same circle is answered from memory.
    last: Option<(Circle, Vec<Entry>)>,
}

#[derive(Debug, Clone, Copy)]
struct Circle {
    ra: Angle,
    dec: Angle,
    radius: Angle,
}

impl Circle {
    fn holds(&self, other: &Self) -> bool {
        let apart = imaging::tangent::separation((self.ra, self.dec), (other.ra, other.dec));
        (apart + other.radius).degrees() <= self.radius.degrees() + 1e-12
    }
}

impl GaiaTmass {
    /// Opens a file for reading only.
    ///
    /// # Errors
    /// [`CatalogueError`] when SQLite does not open it, when it has no table of a degree of declination, or when a
    /// column is missing.
    pub fn open(file: &Path, reading: &Reading) -> Result<Self, CatalogueError> {
        let broken = broken(file);
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(file, flags).map_err(&broken)?;
        let tables: Vec<String> = connection
            .prepare("SELECT name FROM sqlite_master WHERE type = 'table'")
            .and_then(|mut query| query.query_map([], |row| row.get(0))?.collect())
            .map_err(&broken)?;
        let mut shards: Vec<i32> = tables.iter().filter_map(|name| shard(name)).collect();
        shards.sort_unstable();
        let Some(first) = shards.first() else {
            let problem = format!(
                "is an SQLite file without tables of one degree of declination each (`-90_-89` to `89_90`), only {}",
                if tables.is_empty() { "none".to_owned() } else { tables.join(", ") }
            );
            return Err(CatalogueError::content(file, problem));
        };
        let names: Vec<String> = connection
            .prepare(&format!("PRAGMA table_info({})", table(*first)))
            .and_then(|mut query| query.query_map([], |row| row.get(1))?.collect())
            .map_err(&broken)?;
        let columns = Columns::find(file, &names, reading)?;
        let is_dr3 = names.iter().any(|name| name.eq_ignore_ascii_case("phot_bp_mean_mag"));
        let epoch_year = reading.epoch_year.unwrap_or(if is_dr3 { EPOCH_YEAR } else { DR2_EPOCH_YEAR });
        let inner = Mutex::new(Inner { connection, last: None });
        Ok(Self { file: file.to_owned(), reading: *reading, epoch_year, shards, columns, names, inner })
    }

    /// Epoch of the positions as the file has them, Julian year.
    pub fn epoch_year(&self) -> f64 {
        self.epoch_year
    }

    /// Calls `take` for each star, at [`EPOCH_YEAR`].
    ///
    /// # Errors
    /// [`CatalogueError`] when SQLite fails, and any error of `take`.
    pub fn each_star(
        &self,
        take: &mut dyn FnMut(Entry) -> Result<(), CatalogueError>,
    ) -> Result<Tally, CatalogueError> {
        let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut tally = Tally::default();
        for shard in &self.shards {
            self.select(&inner.connection, *shard, "1", [], &mut tally, take)?;
        }
        Ok(tally)
    }

    /// The stars whose place at [`EPOCH_YEAR`] is within a circle, at that epoch, of any magnitude.
    ///
    /// # Errors
    /// [`CatalogueError`] when SQLite fails.
    pub(crate) fn circle(&self, ra: Angle, dec: Angle, radius: Angle) -> Result<Vec<Entry>, CatalogueError> {
        let wanted = Circle { ra, dec, radius };
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let is_there = inner.last.as_ref().is_some_and(|(circle, _)| circle.holds(&wanted));
        if !is_there {
            let found = self.read(&inner.connection, &wanted)?;
            inner.last = Some((wanted, found));
        }
        let inside = |entry: &&Entry| {
            imaging::tangent::separation((entry.ra, entry.dec), (ra, dec)).degrees() <= radius.degrees()
        };
        Ok(inner.last.iter().flat_map(|(_, stars)| stars.iter().filter(inside)).copied().collect())
    }

    fn read(&self, connection: &Connection, circle: &Circle) -> Result<Vec<Entry>, CatalogueError> {
        // The positions in the file are of its own epoch.
        let moved = FASTEST_ARCSEC_PER_YEAR * (self.epoch_year - EPOCH_YEAR).abs() / 3600.0;
        let (ra, dec) = (circle.ra.wrapped_positive().degrees(), circle.dec.degrees());
        let radius = circle.radius.degrees() + moved;
        let (low, high) = ((dec - radius).max(-90.0), (dec + radius).min(90.0));
        // Greatest distance in right ascension of a point of the circle; beyond the pole there is none.
        let half = if dec.abs() + radius < 90.0 {
            (radius.to_radians().sin() / dec.to_radians().cos()).min(1.0).asin().to_degrees() + 1e-9
        } else {
            180.0
        };
        let (west, east) = (ra - half, ra + half);
        let (dec_name, ra_name) = (quoted(&self.names[self.columns.dec]), quoted(&self.names[self.columns.ra]));
        let across = match (west < 0.0, east >= 360.0) {
            _ if half >= 180.0 => "1 OR ?3 OR ?4".to_owned(),
            (true, _) => format!("{ra_name} >= ?3 + 360.0 OR {ra_name} <= ?4"),
            (_, true) => format!("{ra_name} >= ?3 OR {ra_name} <= ?4 - 360.0"),
            _ => format!("{ra_name} BETWEEN ?3 AND ?4"),
        };
        let condition = format!("{dec_name} BETWEEN ?1 AND ?2 AND ({across})");
        let mut stars = Vec::new();
        let mut take = |entry| {
            stars.push(entry);
            Ok(())
        };
        for shard in &self.shards {
            // A star at a whole degree may stand in either table.
            let (bottom, top) = (f64::from(*shard), f64::from(*shard) + 1.0);
            if top >= low && bottom <= high {
                let bounds = [low, high, west, east];
                self.select(connection, *shard, &condition, bounds, &mut Tally::default(), &mut take)?;
            }
        }
        Ok(stars)
    }

    fn select(
        &self,
        connection: &Connection,
        shard: i32,
        condition: &str,
        bounds: impl Params,
        tally: &mut Tally,
        take: &mut dyn FnMut(Entry) -> Result<(), CatalogueError>,
    ) -> Result<(), CatalogueError> {
        let broken = broken(&self.file);
        let names: Vec<String> = self.names.iter().map(|name| quoted(name)).collect();
        let text = format!("SELECT {} FROM {} WHERE {condition}", names.join(", "), table(shard));
        let mut query = connection.prepare(&text).map_err(&broken)?;
        let mut rows = query.query(bounds).map_err(&broken)?;
        while let Some(found) = rows.next().map_err(&broken)? {
            let row = row(&self.columns, &self.reading, |column| number(found.get_ref(column).ok()?));
            if let Some(entry) = tally.entry(&row, self.epoch_year) {
                take(entry)?;
            }
        }
        Ok(())
    }
}

/// The lowest declination of a table called `d_d+1`, degrees.
fn shard(name: &str) -> Option<i32> {
    let (low, high) = name.split_once('_')?;
    let (low, high): (i32, i32) = (low.parse().ok()?, high.parse().ok()?);
    (high == low + 1 && (-90..90).contains(&low)).then_some(low)
}

fn table(shard: i32) -> String {
    quoted(&format!("{shard}_{}", shard + 1))
}

fn quoted(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

/// A number; empty text and NULL are none.
fn number(value: ValueRef<'_>) -> Option<f64> {
    match value {
        ValueRef::Real(number) => Some(number),
        ValueRef::Integer(number) => Some(number as f64),
        ValueRef::Text(text) => std::str::from_utf8(text).ok()?.trim().parse().ok(),
        ValueRef::Null | ValueRef::Blob(_) => None,
    }
    .filter(|number: &f64| number.is_finite())
}

fn broken(file: &Path) -> impl Fn(rusqlite::Error) -> CatalogueError + use<> {
    let file = file.to_owned();
    move |source| CatalogueError::Sqlite { file: file.clone(), source }
}
