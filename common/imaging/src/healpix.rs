//! HEALPix in the nested scheme: equal-area cells of the sky, and the cells a cone touches.
//!
//! The sphere is cut into twelve faces, each a unit square; a point is a face and `(x, y)` on it, a cell of order
//! `o` is one of `4^o` squares of a face. Formulae: Gorski et al. 2005, ApJ 622, 759, sections 4 and 5.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use units::Angle;

/// Highest order whose cell numbers fit the 32-bit index of a catalogue file.
pub const MAX_ORDER: u8 = 13;

/// A place on one of the twelve faces; `x` grows to the north-east, `y` to the north-west, both in [0, 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FacePoint {
    /// Face number, 0 to 11.
    pub face: u8,
    /// Coordinate along the south-west to north-east edge.
    pub x: f64,
    /// Coordinate along the south-east to north-west edge.
    pub y: f64,
}

/// Number of cells over the whole sky.
pub const fn cells(order: u8) -> u64 {
    12 << (2 * order as u64)
}

/// Where a direction lies on the faces.
pub fn face_point(ra: Angle, dec: Angle) -> FacePoint {
    let quarter = ra.wrapped_positive().degrees() / 90.0;
    let z = dec.sin();
    if z.abs() <= 2.0 / 3.0 {
        let (rising, falling) = (quarter + 0.5 + 0.75 * z, quarter + 0.5 - 0.75 * z);
        let (r, f) = (rising.floor(), falling.floor());
        let face = match (f as i64).cmp(&(r as i64)) {
            std::cmp::Ordering::Equal => 4 + (f as u8 & 3),
            std::cmp::Ordering::Less => f as u8 & 3,
            std::cmp::Ordering::Greater => 8 + (r as u8 & 3),
        };
        return FacePoint { face, x: rising - r, y: below_one(1.0 - (falling - f)) };
    }
    let face = (quarter as u8).min(3);
    let along = quarter - f64::from(face);
    // sqrt(3 (1 - |sin dec|)) without the cancellation near the poles
    let from_pole = 6.0_f64.sqrt() * (FRAC_PI_4 - 0.5 * dec.abs().radians()).sin();
    let (east, west) = (along * from_pole, (1.0 - along) * from_pole);
    if z > 0.0 {
        FacePoint { face, x: below_one(1.0 - west), y: below_one(1.0 - east) }
    } else {
        FacePoint { face: face + 8, x: east, y: west }
    }
}

/// The direction (right ascension, declination) of a place on the faces.
pub fn direction(point: FacePoint) -> (Angle, Angle) {
    let (ring, down) = rings(point);
    let dec = if down < 1.0 {
        FRAC_PI_2 - 2.0 * (down / 6.0_f64.sqrt()).asin()
    } else if down > 3.0 {
        2.0 * ((4.0 - down) / 6.0_f64.sqrt()).asin() - FRAC_PI_2
    } else {
        ((2.0 - down) * 2.0 / 3.0).asin()
    };
    (Angle::from_degrees(eighths(point, ring) * 45.0).wrapped_positive(), Angle::from_radians(dec))
}

/// The same with less trigonometry, as sine and cosine of the right ascension and of the declination.
pub(crate) fn sines(point: FacePoint) -> [f64; 4] {
    let (ring, down) = rings(point);
    let (sin_ra, cos_ra) = (eighths(point, ring) * FRAC_PI_4).sin_cos();
    let (sin_dec, cos_dec) = if ring < 1.0 {
        // 1 - z^2 without the cancellation near the poles
        let from_pole = ring * ring / 3.0;
        ((1.0 - from_pole).copysign(2.0 - down), (from_pole * (2.0 - from_pole)).sqrt())
    } else {
        let z = (2.0 - down) * 2.0 / 3.0;
        (z, (1.0 - z * z).sqrt())
    };
    [sin_ra, cos_ra, sin_dec, cos_dec]
}

/// Length of a place's circle of latitude in units of the equator's, and how far it lies below the north pole, which
/// reaches 4 at the south pole.
fn rings(point: FacePoint) -> (f64, f64) {
    let down = f64::from(2 + point.face / 4) - point.x - point.y;
    (down.min(4.0 - down).min(1.0), down)
}

/// Right ascension of a place in eighths of a turn.
fn eighths(point: FacePoint, ring: f64) -> f64 {
    let column = f64::from(2 * (point.face % 4) + u8::from(point.face / 4 != 1));
    if ring < 1e-15 { 0.0 } else { column + (point.x - point.y) / ring }
}

/// The cell of this order that holds a place.
pub fn cell(order: u8, point: FacePoint) -> u64 {
    let side = (1_u64 << order) as f64;
    let (x, y) = ((point.x * side) as u64, (point.y * side) as u64);
    (u64::from(point.face) << (2 * order)) | spread(x) | (spread(y) << 1)
}

/// The corner of a cell with the smallest `x` and `y`; the cell reaches `2^-order` further in both.
pub fn corner(order: u8, cell: u64) -> FacePoint {
    let within = cell & ((1 << (2 * order)) - 1);
    let side = (1_u64 << order) as f64;
    FacePoint {
        face: (cell >> (2 * order)) as u8,
        x: gather(within) as f64 / side,
        y: gather(within >> 1) as f64 / side,
    }
}

/// The cells of this order that a cone may touch, ascending; a few of its neighbours too, never one too few.
pub fn cells_in_cone(order: u8, ra: Angle, dec: Angle, radius: Angle) -> Vec<u64> {
    let centre = unit(ra, dec);
    // squared chords
    let limit = |o| (2.0 * (0.5 * (radius.radians() + reach(o as u8))).clamp(0.0, FRAC_PI_2).sin()).powi(2);
    let limits: [f64; MAX_ORDER as usize + 1] = std::array::from_fn(limit);
    let mut found = Vec::new();
    for face in 0..12 {
        descend(0, face, order, centre, &limits, &mut found);
    }
    found
}

fn descend(order: u8, number: u64, last: u8, centre: [f64; 3], limits: &[f64], found: &mut Vec<u64>) {
    let start = corner(order, number);
    let half = 0.5 / (1_u64 << order) as f64;
    let [sin_ra, cos_ra, sin_dec, cos_dec] =
        sines(FacePoint { face: start.face, x: start.x + half, y: start.y + half });
    let middle = [cos_dec * cos_ra, cos_dec * sin_ra, sin_dec];
    if (0..3).map(|i| (centre[i] - middle[i]).powi(2)).sum::<f64>() > limits[usize::from(order)] {
        return;
    }
    if order == last {
        found.push(number);
        return;
    }
    for child in 0..4 {
        descend(order + 1, (number << 2) | child, last, centre, limits, found);
    }
}

/// Greatest distance in radians of a cell's corner from its centre: that of the cell that touches z = 2/3.
fn reach(order: u8) -> f64 {
    let side = (1_u64 << order) as f64;
    let on_border = unit(Angle::from_radians(FRAC_PI_4 / side), Angle::from_radians((2.0_f64 / 3.0).asin()));
    let z = 1.0 - (1.0 - 1.0 / side).powi(2) / 3.0;
    between(on_border, unit(Angle::default(), Angle::from_radians(z.asin())))
}

fn unit(ra: Angle, dec: Angle) -> [f64; 3] {
    [dec.cos() * ra.cos(), dec.cos() * ra.sin(), dec.sin()]
}

/// Angle in radians between two unit vectors, good at any size.
fn between(a: [f64; 3], b: [f64; 3]) -> f64 {
    let chord = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    2.0 * (0.5 * chord).min(1.0).asin()
}

const ONE_BIT: u64 = 0x5555_5555_5555_5555;
const TWO_BITS: u64 = 0x3333_3333_3333_3333;

/// One bit apart: `abc` becomes `0a0b0c`.
fn spread(value: u64) -> u64 {
    [(16, 0x0000_FFFF_0000_FFFF), (8, 0x00FF_00FF_00FF_00FF), (4, 0x0F0F_0F0F_0F0F_0F0F), (2, TWO_BITS), (1, ONE_BIT)]
        .into_iter()
        .fold(value, |bits, (shift, mask)| (bits | bits << shift) & mask)
}

/// Every other bit: `xaybzc` becomes `abc`.
fn gather(value: u64) -> u64 {
    [
        (1, TWO_BITS),
        (2, 0x0F0F_0F0F_0F0F_0F0F),
        (4, 0x00FF_00FF_00FF_00FF),
        (8, 0x0000_FFFF_0000_FFFF),
        (16, u64::MAX >> 32),
    ]
    .into_iter()
    .fold(value & ONE_BIT, |bits, (shift, mask)| (bits | bits >> shift) & mask)
}

/// Keeps a coordinate that rounded up to 1.0 on its own face.
fn below_one(value: f64) -> f64 {
    value.min(1.0 - f64::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deg(d: f64) -> Angle {
        Angle::from_degrees(d)
    }

    #[test]
    fn known_directions_fall_into_their_cells() {
        // nested numbers at order 3 from astropy-healpix 1.1: HEALPix(8, "nested").lonlat_to_healpix
        for (ra, dec, expected) in [
            (45.0, 89.9, 63),
            (45.0, 0.1, 0),
            (0.1, 0.1, 304),
            (10.0, 20.0, 310),
            (200.0, -35.0, 684),
            (300.0, -75.0, 706),
            (123.4, 56.7, 114),
        ] {
            assert_eq!(cell(3, face_point(deg(ra), deg(dec))), expected, "{ra} {dec}");
        }
    }

    #[test]
    fn a_direction_survives_the_way_there_and_back() {
        for i in 0..20_000 {
            let ra = f64::from(i) * 137.507_764 % 360.0;
            let dec = (1.0 - 2.0 * (f64::from(i) + 0.5) / 20_000.0_f64).asin().to_degrees();
            let point = face_point(deg(ra), deg(dec));
            assert!((0.0..1.0).contains(&point.x) && (0.0..1.0).contains(&point.y), "{point:?}");
            let (ra2, dec2) = direction(point);
            assert!(between(unit(deg(ra), deg(dec)), unit(ra2, dec2)) < 1e-13, "{ra} {dec}");
            let [sin_ra, cos_ra, sin_dec, cos_dec] = sines(point);
            let at = [cos_dec * cos_ra, cos_dec * sin_ra, sin_dec];
            assert!(between(unit(deg(ra), deg(dec)), at) < 1e-13, "{ra} {dec}");
            let number = cell(7, point);
            let start = corner(7, number);
            assert!(start.face == point.face && (0.0..1.0 / 128.0).contains(&(point.x - start.x)));
        }
    }

    #[test]
    fn cells_have_equal_areas() {
        let mut counts = vec![0_u32; cells(2) as usize];
        for i in 0..192_000 {
            let ra = f64::from(i) * 137.507_764_05 % 360.0;
            let dec = (1.0 - 2.0 * (f64::from(i) + 0.5) / 192_000.0_f64).asin().to_degrees();
            counts[cell(2, face_point(deg(ra), deg(dec))) as usize] += 1;
        }
        assert!(counts.iter().all(|&n| (960..=1040).contains(&n)), "{counts:?}");
    }

    #[test]
    fn no_cell_of_a_cone_is_missed() {
        for (ra, dec, radius) in [(0.0, 0.0, 1.0), (10.0, 89.5, 2.0), (359.9, -41.8, 0.1), (123.0, -90.0, 5.0)] {
            let found = cells_in_cone(7, deg(ra), deg(dec), deg(radius));
            assert!(found.is_sorted());
            for i in 0..2000 {
                let (bearing, distance) = (f64::from(i) * 2.4, radius.to_radians() * (f64::from(i) / 2000.0).sqrt());
                let (sd, cd) = deg(dec).radians().sin_cos();
                let d = (sd * distance.cos() + cd * distance.sin() * bearing.cos()).clamp(-1.0, 1.0).asin();
                let a = (bearing.sin() * distance.sin() * cd).atan2(distance.cos() - sd * d.sin());
                let (ra, dec) = (deg(ra) + Angle::from_radians(a), Angle::from_radians(d));
                assert!(found.contains(&cell(7, face_point(ra, dec))));
            }
        }
    }
}
