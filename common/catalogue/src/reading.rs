//! How a file is read, and the values that it has for one star.

use imaging::catalogue::Entry;
use units::Angle;

use crate::band::Band;

/// Epoch that stars are brought to, Julian year: that of Gaia DR3.
pub const EPOCH_YEAR: f64 = 2016.0;

/// How a file is to be read.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Reading {
    /// The magnitude; none: the column `mag`, else Gaia G.
    pub band: Option<Band>,
    /// Epoch of positions whose epoch the file does not contain, Julian year; none: the usual one of each kind of file.
    pub epoch_year: Option<f64>,
}

/// The values that a file has for one star.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Row {
    /// ICRS right ascension, degrees.
    pub ra_deg: Option<f64>,
    /// ICRS declination, degrees.
    pub dec_deg: Option<f64>,
    /// Proper motion in right ascension times cos(dec), mas/yr.
    pub pm_ra_mas: Option<f64>,
    /// Proper motion in declination, mas/yr.
    pub pm_dec_mas: Option<f64>,
    /// Magnitude.
    pub mag: Option<f64>,
    /// Epoch of the position, Julian year.
    pub epoch_year: Option<f64>,
}

/// How many stars a file gave.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Stars taken.
    pub stars: u64,
    /// Of these, stars without a known proper motion.
    pub unmoving: u64,
    /// Rows without a place on the sky: no star could be made of them.
    pub unplaced: u64,
    /// Rows without any magnitude: a catalogue sorted by brightness has no place for them.
    pub without_mag: u64,
}

impl Tally {
    /// Adds the counts of another file.
    pub fn add(&mut self, other: Self) {
        self.stars += other.stars;
        self.unmoving += other.unmoving;
        self.unplaced += other.unplaced;
        self.without_mag += other.without_mag;
    }

    /// The star of a row at [`EPOCH_YEAR`], counted; `epoch_year` is for rows without an epoch.
    pub(crate) fn entry(&mut self, row: &Row, epoch_year: f64) -> Option<Entry> {
        let ra = row.ra_deg.filter(|ra| ra.is_finite() && ra.abs() <= 720.0);
        let dec = row.dec_deg.filter(|dec| dec.abs() <= 90.0);
        let Some((ra, dec)) = ra.zip(dec) else {
            self.unplaced += 1;
            return None;
        };
        let Some(mag) = row.mag.filter(|mag| mag.is_finite()) else {
            self.without_mag += 1;
            return None;
        };
        // Gaia's own fits have both or none; half a motion is no motion.
        let motion = row.pm_ra_mas.zip(row.pm_dec_mas).filter(|(a, d)| a.abs().max(d.abs()) <= FASTEST_MAS);
        self.unmoving += u64::from(motion.is_none());
        let (pm_ra_mas, pm_dec_mas) = motion.unwrap_or_default();
        let (ra, dec) = (Angle::from_degrees(ra).wrapped_positive(), Angle::from_degrees(dec));
        self.stars += 1;
        let from = row.epoch_year.filter(|year| (1800.0..2200.0).contains(year)).unwrap_or(epoch_year);
        Some(Entry { ra, dec, pm_ra_mas, pm_dec_mas, mag }.after(EPOCH_YEAR - from))
    }
}

/// No star moves faster than Barnard's, 10.4" a year; in some files greater numbers mean "unknown".
const FASTEST_MAS: f64 = 11_000.0;
