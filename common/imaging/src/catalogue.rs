//! The compact all-sky star catalogue: a reader that works on bytes, wherever they are kept.
//!
//! File format `SMCAT` 1, little-endian, made to be memory-mapped and asked without being unpacked:
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `SMCAT`, 0, 0, version 1 |
//! | 4, 4, 4, 4 | HEALPix order `o`, number of stars, number of fast movers, 0 |
//! | 8 | epoch of the positions, Julian year (f64) |
//! | 4 x (12 x 4^o + 1) | index: number of the first star of each nested cell, and the number of stars |
//! | 8 x stars | records, by cell, brightest first within a cell ([`record`]) |
//! | 12 x fast movers | record number (u32), proper motion in RA cos(dec) and in Dec (i32, mas/yr), by record number |
//!
//! A record says where in its cell the star lies with 16 bits in each direction: 0.013" at order 7.

mod build;
mod record;

use units::Angle;

use crate::healpix;
pub use build::{Entry, Pieces, build, order_for};
use record::Record;

const MAGIC: [u8; 8] = *b"SMCAT\0\0\x01";
const HEADER: usize = 32;
/// No star moves faster than Barnard's, 10.4" a year.
const FASTEST_ARCSEC_PER_YEAR: f64 = 10.5;

/// A star as a catalogue gives it for one epoch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CatalogueStar {
    /// ICRS right ascension at the epoch asked for.
    pub ra: Angle,
    /// ICRS declination at the epoch asked for.
    pub dec: Angle,
    /// Magnitude (Gaia G, or Tycho VT where Gaia has none), to 0.02.
    pub mag: f64,
}

/// Bytes that are no catalogue.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CatalogueError {
    /// Another kind of file, or a later version.
    #[error("not a star catalogue of format SMCAT 1")]
    Format,
    /// Cut short, or damaged.
    #[error("star catalogue is damaged: {0}")]
    Damaged(&'static str),
}

/// A star catalogue in bytes `B`: a `Vec`, a static array or a memory map.
#[derive(Debug, Clone)]
pub struct Catalogue<B> {
    bytes: B,
    order: u8,
    stars: usize,
    fast: usize,
    epoch_year: f64,
}

impl<B: AsRef<[u8]>> Catalogue<B> {
    /// Checks the header and the index; the records are read when asked for.
    ///
    /// # Errors
    /// [`CatalogueError`] when the bytes are no catalogue, or do not have the length that their header states.
    pub fn from_bytes(bytes: B) -> Result<Self, CatalogueError> {
        let all = bytes.as_ref();
        if all.len() < HEADER || all[..8] != MAGIC {
            return Err(CatalogueError::Format);
        }
        let order = u8::try_from(u32_at(all, 8)).ok().filter(|o| *o <= healpix::MAX_ORDER);
        let order = order.ok_or(CatalogueError::Damaged("HEALPix order out of range"))?;
        let (stars, fast) = (u32_at(all, 12) as usize, u32_at(all, 16) as usize);
        let epoch_year = f64::from_le_bytes(std::array::from_fn(|i| all[24 + i]));
        let catalogue = Self { order, stars, fast, epoch_year, bytes };
        let all = catalogue.bytes.as_ref();
        if all.len() as u64 != catalogue.fast_start() as u64 + 12 * fast as u64 {
            return Err(CatalogueError::Damaged("length does not match the header"));
        }
        let index = (0..=healpix::cells(order)).map(|c| catalogue.first_of(c));
        if !index.is_sorted() || catalogue.first_of(healpix::cells(order)) != stars || catalogue.first_of(0) != 0 {
            return Err(CatalogueError::Damaged("cell index is not in order"));
        }
        Ok(catalogue)
    }

    /// Number of stars.
    pub fn len(&self) -> usize {
        self.stars
    }

    /// Whether there is no star at all.
    pub fn is_empty(&self) -> bool {
        self.stars == 0
    }

    /// Epoch of the stored positions, Julian year.
    pub fn epoch_year(&self) -> f64 {
        self.epoch_year
    }

    /// The stars within `radius` of an ICRS direction, not fainter than `limit_mag`, where they stood or will
    /// stand at `epoch_year` (Julian year, such as 2026.89); in no particular order.
    pub fn cone(&self, ra: Angle, dec: Angle, radius: Angle, limit_mag: f64, epoch_year: f64) -> Vec<CatalogueStar> {
        let years = epoch_year - self.epoch_year;
        let reach = radius + Angle::from_arcseconds(FASTEST_ARCSEC_PER_YEAR * years.abs());
        let axis = unit(ra, dec);
        // squared chords: exact for small radii, where a cosine is not
        let chord2 = (2.0 * (0.5 * radius.degrees().clamp(0.0, 180.0)).to_radians().sin()).powi(2);
        let mut stars = Vec::new();
        for cell in healpix::cells_in_cone(self.order, ra, dec, reach) {
            for number in self.first_of(cell)..self.first_of(cell + 1) {
                let record = self.record(number);
                if record.mag() > limit_mag {
                    break;
                }
                let at = self.moved(number, record, cell, years);
                if (0..3).map(|i| (at[i] - axis[i]).powi(2)).sum::<f64>() <= chord2 {
                    let ra = Angle::from_radians(at[1].atan2(at[0])).wrapped_positive();
                    let dec = Angle::from_radians(at[2].atan2(at[0].hypot(at[1])));
                    stars.push(CatalogueStar { ra, dec, mag: record.mag() });
                }
            }
        }
        stars
    }

    /// The direction of a star as a unit vector, moved along its great circle; right ascension itself would
    /// run away near the poles.
    fn moved(&self, number: usize, record: Record, cell: u64, years: f64) -> [f64; 3] {
        let sines = healpix::sines(record.position(self.order, cell));
        let (pm_ra, pm_dec) = record.motion_mas().unwrap_or_else(|| self.fast_motion_mas(number));
        moved(sines, pm_ra * years, pm_dec * years)
    }

    fn record(&self, number: usize) -> Record {
        let at = self.records_start() + 8 * number;
        let bytes = self.bytes.as_ref();
        Record::from_words(u32_at(bytes, at), u32_at(bytes, at + 4))
    }

    fn fast_motion_mas(&self, number: usize) -> (f64, f64) {
        let (bytes, start) = (self.bytes.as_ref(), self.fast_start());
        let (mut low, mut high) = (0, self.fast);
        while low < high {
            let middle = usize::midpoint(low, high);
            let at = start + 12 * middle;
            match (u32_at(bytes, at) as usize).cmp(&number) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Greater => high = middle,
                std::cmp::Ordering::Equal => {
                    let motion = |at| f64::from(u32_at(bytes, at).cast_signed());
                    return (motion(at + 4), motion(at + 8));
                }
            }
        }
        (0.0, 0.0)
    }

    fn first_of(&self, cell: u64) -> usize {
        u32_at(self.bytes.as_ref(), HEADER + 4 * cell as usize) as usize
    }

    fn records_start(&self) -> usize {
        HEADER + 4 * (healpix::cells(self.order) as usize + 1)
    }

    fn fast_start(&self) -> usize {
        self.records_start() + 8 * self.stars
    }
}

/// A little-endian word; 0 beyond the end, which a checked length rules out.
fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

fn unit(ra: Angle, dec: Angle) -> [f64; 3] {
    [dec.cos() * ra.cos(), dec.cos() * ra.sin(), dec.sin()]
}

/// A direction, given by its sines and cosines, after a motion in milliarcseconds to the east and to the north.
fn moved([sin_ra, cos_ra, sin_dec, cos_dec]: [f64; 4], east_mas: f64, north_mas: f64) -> [f64; 3] {
    let east = Angle::from_arcseconds(east_mas * 1e-3).radians();
    let north = Angle::from_arcseconds(north_mas * 1e-3).radians();
    let x = cos_dec * cos_ra - north * sin_dec * cos_ra - east * sin_ra;
    let y = cos_dec * sin_ra - north * sin_dec * sin_ra + east * cos_ra;
    let z = sin_dec + north * cos_dec;
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

#[cfg(test)]
mod tests;
