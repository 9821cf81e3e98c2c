//! Writing a catalogue: stars in, bytes of the format out.

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

/// Packs stars, all at `epoch_year` (Julian), into the bytes of a catalogue with cells of a HEALPix order.
///
/// The same stars give the same bytes, in whichever order they come. Order 7 suits two million stars, 9 suits
/// twenty; `order` is at most [`healpix::MAX_ORDER`].
pub fn build(entries: &[Entry], order: u8, epoch_year: f64) -> Vec<u8> {
    let order = order.min(healpix::MAX_ORDER);
    let mut packed: Vec<(u64, Record, [i32; 2])> = entries.iter().map(|entry| pack(entry, order)).collect();
    packed.sort_by_key(|(cell, record, motion)| (*cell, record.words()[1] & 0x3FF, record.words(), *motion));

    let cells = healpix::cells(order);
    let fast: Vec<(usize, [i32; 2])> = packed
        .iter()
        .enumerate()
        .filter(|(_, (_, record, _))| record.motion_mas().is_none())
        .map(|(number, (_, _, motion))| (number, *motion))
        .collect();

    let mut bytes = Vec::with_capacity(HEADER + 4 * (cells as usize + 1) + 8 * packed.len() + 12 * fast.len());
    bytes.extend(MAGIC);
    for word in [u32::from(order), packed.len() as u32, fast.len() as u32, 0] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(epoch_year.to_le_bytes());
    for cell in 0..=cells {
        let first = packed.partition_point(|(of, _, _)| *of < cell) as u32;
        bytes.extend(first.to_le_bytes());
    }
    bytes.extend(packed.iter().flat_map(|(_, record, _)| record.words()).flat_map(u32::to_le_bytes));
    for (number, [pm_ra, pm_dec]) in fast {
        bytes.extend((number as u32).to_le_bytes());
        bytes.extend(pm_ra.to_le_bytes());
        bytes.extend(pm_dec.to_le_bytes());
    }
    bytes
}

fn pack(entry: &Entry, order: u8) -> (u64, Record, [i32; 2]) {
    let motion = [entry.pm_ra_mas.round() as i32, entry.pm_dec_mas.round() as i32];
    let slow = motion.iter().all(|pm| pm.abs() <= MAX_MOTION_MAS).then_some((motion[0], motion[1]));
    let (cell, record) = Record::pack(order, entry.ra, entry.dec, entry.mag, slow);
    (cell, record, motion)
}
