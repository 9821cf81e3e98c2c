//! Writing a catalogue: stars in, bytes of the format out, at once or piece by piece.

use std::ops::Range;

use units::Angle;

use super::record::{MAX_MOTION_MAS, Record};
use super::{HEADER, MAGIC};
use crate::healpix;

/// A star to be written, at the catalogue's epoch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// ICRS right ascension.
    pub ra: Angle,
    /// ICRS declination.
    pub dec: Angle,
    /// Proper motion in right ascension times cos(dec), mas/yr; 0 where unknown.
    pub pm_ra_mas: f64,
    /// Proper motion in declination, mas/yr; 0 where unknown.
    pub pm_dec_mas: f64,
    /// Magnitude; kept to 0.02 within -2 and 18.46.
    pub mag: f64,
}

impl Entry {
    /// The star where it stands `years` (Julian) later, moved along its great circle; its motion then is along the
    /// same circle, so near a pole it points to another east and north.
    #[must_use]
    pub fn after(self, years: f64) -> Self {
        let radians = |mas: f64| Angle::from_arcseconds(mas * 1e-3).radians();
        let speed = radians(self.pm_ra_mas).hypot(radians(self.pm_dec_mas));
        let (sin, cos) = (speed * years).sin_cos();
        if speed == 0.0 || years == 0.0 {
            return self;
        }
        let at = super::unit(self.ra, self.dec);
        let [east, north] = east_and_north(self.ra, self.dec);
        let (share_east, share_north) = (radians(self.pm_ra_mas) / speed, radians(self.pm_dec_mas) / speed);
        let ahead: [f64; 3] = std::array::from_fn(|i| east[i] * share_east + north[i] * share_north);
        let there: [f64; 3] = std::array::from_fn(|i| at[i] * cos + ahead[i] * sin);
        let ahead: [f64; 3] = std::array::from_fn(|i| ahead[i] * cos - at[i] * sin);
        let ra = Angle::from_radians(there[1].atan2(there[0])).wrapped_positive();
        let dec = Angle::from_radians(there[2].atan2(there[0].hypot(there[1])));
        let along = |axis: [f64; 3]| {
            Angle::from_radians(speed * (0..3).map(|i| axis[i] * ahead[i]).sum::<f64>()).arcseconds() * 1e3
        };
        let [east, north] = east_and_north(ra, dec);
        Self { ra, dec, pm_ra_mas: along(east), pm_dec_mas: along(north), mag: self.mag }
    }

    /// The cell of a HEALPix order that this star is kept in.
    pub fn cell(&self, order: u8) -> u64 {
        healpix::cell(order, healpix::face_point(self.ra, self.dec))
    }
}

/// Coarsest order that is chosen: its records hold places to 0.013".
const COARSEST: u8 = 7;
/// Finest order whose index (12 MB) is no burden even for the stars of one field.
const FINEST_OF_FEW: u8 = 9;

/// A HEALPix order for so many stars on a share (0 to 1) of the sky: up to twenty to a cell, so that a small cone reads
/// little besides its stars; but never an index that is much larger than the records of many stars.
pub fn order_for(stars: usize, share_of_sky: f64) -> u8 {
    let share = if share_of_sky > 0.0 { share_of_sky.min(1.0) } else { 1.0 };
    let roomy = |stars: f64| {
        (COARSEST..healpix::MAX_ORDER)
            .find(|order| healpix::cells(*order) as f64 * 20.0 >= stars)
            .unwrap_or(healpix::MAX_ORDER)
    };
    roomy(stars as f64 / share).min(roomy(stars as f64).max(FINEST_OF_FEW))
}

/// Packs stars, all at `epoch_year` (Julian), into the bytes of a catalogue with cells of a HEALPix order.
///
/// The same stars give the same bytes, in whichever order they come. Order 7 suits two million stars, 9 suits
/// twenty ([`order_for`]); `order` is at most [`healpix::MAX_ORDER`].
pub fn build(entries: &[Entry], order: u8, epoch_year: f64) -> Vec<u8> {
    let mut pieces = Pieces::new(order, epoch_year);
    let records = pieces.add(0..healpix::cells(pieces.order), entries);
    let mut bytes = pieces.head();
    bytes.extend(records);
    bytes.extend(pieces.tail());
    bytes
}

/// A catalogue made of pieces of the sky, so that no more than one of them need be in memory: the file is
/// [`Pieces::head`] (whose length is known before), what [`Pieces::add`] answered in turn, and [`Pieces::tail`].
#[derive(Debug, Clone)]
pub struct Pieces {
    order: u8,
    epoch_year: f64,
    /// Number of the first star of each cell so far.
    first: Vec<u32>,
    stars: u32,
    fast: Vec<(u32, [i32; 2])>,
}

impl Pieces {
    /// Nothing yet. `order` is at most [`healpix::MAX_ORDER`], the epoch a Julian year.
    pub fn new(order: u8, epoch_year: f64) -> Self {
        let order = order.min(healpix::MAX_ORDER);
        Self { order, epoch_year, first: Vec::new(), stars: 0, fast: Vec::new() }
    }

    /// The HEALPix order of the cells.
    pub fn order(&self) -> u8 {
        self.order
    }

    /// Stars so far.
    pub fn stars(&self) -> u32 {
        self.stars
    }

    /// Packs all stars of a range of cells, which begins where the last one ended; stars of other cells are left out.
    /// A star that is given twice in the same words is kept once.
    pub fn add(&mut self, cells: Range<u64>, entries: &[Entry]) -> Vec<u8> {
        let mut packed: Vec<(u64, Record, [i32; 2])> =
            entries.iter().map(|entry| pack(entry, self.order)).filter(|(cell, ..)| cells.contains(cell)).collect();
        packed
            .sort_unstable_by_key(|(cell, record, motion)| (*cell, record.words()[1] & 0x3FF, record.words(), *motion));
        packed.dedup();
        let mut of_piece = packed.as_slice();
        for cell in cells {
            self.first.push(self.stars);
            let here = of_piece.partition_point(|(of, ..)| *of <= cell);
            let (stars, rest) = of_piece.split_at(here);
            for (number, (_, record, motion)) in (self.stars..).zip(stars) {
                if record.motion_mas().is_none() {
                    self.fast.push((number, *motion));
                }
            }
            self.stars = self.stars.saturating_add(here as u32);
            of_piece = rest;
        }
        packed.iter().flat_map(|(_, record, _)| record.words()).flat_map(u32::to_le_bytes).collect()
    }

    /// Bytes of [`Pieces::head`].
    pub fn head_length(&self) -> usize {
        HEADER + 4 * (healpix::cells(self.order) as usize + 1)
    }

    /// Header and index; cells that never came are empty.
    pub fn head(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.head_length());
        bytes.extend(MAGIC);
        for word in [u32::from(self.order), self.stars, self.fast.len() as u32, 0] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(self.epoch_year.to_le_bytes());
        bytes.extend(self.first.iter().flat_map(|first| first.to_le_bytes()));
        while bytes.len() < self.head_length() {
            bytes.extend(self.stars.to_le_bytes());
        }
        bytes
    }

    /// The fast movers.
    pub fn tail(&self) -> Vec<u8> {
        let words = |(number, [pm_ra, pm_dec]): &(u32, [i32; 2])| {
            [*number, pm_ra.cast_unsigned(), pm_dec.cast_unsigned()].into_iter().flat_map(u32::to_le_bytes)
        };
        self.fast.iter().flat_map(words).collect()
    }
}

fn east_and_north(ra: Angle, dec: Angle) -> [[f64; 3]; 2] {
    let ((sin_ra, cos_ra), (sin_dec, cos_dec)) = (ra.radians().sin_cos(), dec.radians().sin_cos());
    [[-sin_ra, cos_ra, 0.0], [-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec]]
}

fn pack(entry: &Entry, order: u8) -> (u64, Record, [i32; 2]) {
    let motion = [entry.pm_ra_mas.round() as i32, entry.pm_dec_mas.round() as i32];
    let slow = motion.iter().all(|pm| pm.abs() <= MAX_MOTION_MAS).then_some((motion[0], motion[1]));
    let (cell, record) = Record::pack(order, entry.ra, entry.dec, entry.mag, slow);
    (cell, record, motion)
}
