//! Patterns of four bright stars all over the sky, found again by their shape.
//!
//! A table holds the patterns of one size: the longest side between one and two times the table's. They are made of the
//! brightest stars around points some way apart, so that a frame of about twice that size anywhere holds several.

use units::Angle;

use super::pattern::{Code, shapes};
use super::similarity::Place;
use super::source::{Stars, brightest};
use crate::healpix::{self, FacePoint};
use crate::parallel;
use crate::tangent::TangentPlane;

/// HEALPix orders of the pieces that are laid flat: at 3 deg from its middle a plane stretches by 0.14 %; the wide tables
/// do with larger ones.
const PIECES: (u8, u8) = (3, 4);
/// Stars around a point that form patterns, the brightest ones.
const STARS: usize = 12;
/// Patterns of a point, and in how many of them one star may be: it may be missing in a frame.
const PATTERNS: usize = 8;
const USES: u8 = 4;
/// Stars of a piece for those that its points need on average: the sky is uneven.
const SPARE: f64 = 3.0;
/// Width of a cell of codes, lengths of AB.
const CELL: f64 = 0.02;
/// Codes lie within 1 of both ends; they are stored as shares of this.
const WIDEST: f64 = 1.05;

/// Four stars of the sky.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pattern {
    /// ICRS right ascension and declination of A and of B, deg: to 0.06".
    ends_deg: [[f32; 2]; 2],
    /// Length of AB, rad.
    length: f32,
    /// The code, and in the lowest bit of its first number whether the shape was flipped.
    code: [u16; 4],
}

impl Pattern {
    fn new(ends: [(Angle, Angle); 2], length: f64, code: Code, flipped: bool) -> Self {
        let end = |(ra, dec): (Angle, Angle)| [ra.degrees() as f32, dec.degrees() as f32];
        let mut stored = code.map(|v| ((v / WIDEST * 0.5 + 0.5).clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16);
        stored[0] = (stored[0] & !1) | u16::from(flipped);
        Self { ends_deg: ends.map(end), length: length as f32, code: stored }
    }

    pub(super) fn code(&self) -> Code {
        self.code.map(|v| (f64::from(v) / f64::from(u16::MAX) * 2.0 - 1.0) * WIDEST)
    }

    /// Whether the code is that of the shape seen from behind (east to the right).
    pub(super) fn flipped(&self) -> bool {
        self.code[0] & 1 != 0
    }

    /// Length of AB, rad.
    pub(super) fn length(&self) -> f64 {
        f64::from(self.length)
    }

    /// The directions of A, B, C and D.
    pub(super) fn directions(&self) -> [(Angle, Angle); 4] {
        let [a, b] = self.ends_deg.map(|[ra, dec]| (Angle::from_degrees(ra.into()), Angle::from_degrees(dec.into())));
        // the plane on which the shape was taken touched nearby; around A it differs by less than the code's tolerance
        let plane = TangentPlane::new(a.0, a.1);
        let base = plane.project(b.0, b.1).unwrap_or((self.length(), 0.0));
        let [cx, cy, dx, dy] = self.code();
        let side = if self.flipped() { -1.0 } else { 1.0 };
        let at = |x: f64, y: f64| {
            let (x, y) = (x * base.0 - side * y * base.1, x * base.1 + side * y * base.0);
            plane.direction(x, y)
        };
        [a, b, at(cx, cy), at(dx, dy)]
    }
}

/// The patterns of one size.
#[derive(Debug)]
pub(super) struct Table {
    /// First pattern of each bucket; one more than there are buckets.
    starts: Vec<u32>,
    patterns: Vec<Pattern>,
}

/// Size of a HEALPix cell, rad.
pub(super) fn cell_size(order: u8) -> f64 {
    (std::f64::consts::PI / 3.0).sqrt() / f64::from(1_u32 << order)
}

/// Lengths of AB of the table of an order, rad.
pub(super) fn lengths(order: u8) -> (f64, f64) {
    (0.6 * cell_size(order), 1.2 * cell_size(order))
}

impl Table {
    /// The patterns whose size belongs to HEALPix cells of this order.
    pub(super) fn new(source: &(impl Stars + Sync), order: u8) -> Self {
        // a piece is worth a thread
        let pieces = healpix::cells(piece_order(order)) as usize;
        let parts = parallel::ranges(pieces, 1 << 12, |pieces| {
            let mut patterns = Vec::new();
            pieces.for_each(|piece| of_piece(source, order, piece as u64, &mut patterns));
            patterns
        });
        let count: usize = parts.iter().map(Vec::len).sum();
        let buckets = (count / 2).next_power_of_two();
        let mut starts = vec![0_u32; buckets + 1];
        for pattern in parts.iter().flatten() {
            starts[bucket(cell(&pattern.code()), buckets) + 1] += 1;
        }
        for n in 1..=buckets {
            starts[n] += starts[n - 1];
        }
        let mut next = starts.clone();
        let none = Pattern { ends_deg: [[0.0; 2]; 2], length: 0.0, code: [0; 4] };
        let mut patterns = vec![none; count];
        for pattern in parts.into_iter().flatten() {
            let place = &mut next[bucket(cell(&pattern.code()), buckets)];
            patterns[*place as usize] = pattern;
            *place += 1;
        }
        Self { starts, patterns }
    }

    /// Number of patterns.
    pub(super) fn len(&self) -> usize {
        self.patterns.len()
    }

    /// The patterns whose code is nowhere further than `reach` from this one.
    pub(super) fn near(&self, code: &Code, reach: f64, mut found: impl FnMut(&Pattern)) {
        let (low, high) = (cell(&code.map(|v| v - reach)), cell(&code.map(|v| v + reach)));
        let buckets = self.starts.len() - 1;
        for a in low[0]..=high[0] {
            for b in low[1]..=high[1] {
                for c in low[2]..=high[2] {
                    for d in low[3]..=high[3] {
                        let here = [a, b, c, d];
                        let n = bucket(here, buckets);
                        for pattern in &self.patterns[self.starts[n] as usize..self.starts[n + 1] as usize] {
                            let own = pattern.code();
                            // other cells share the bucket
                            if (0..4).all(|i| (own[i] - code[i]).abs() <= reach) && cell(&own) == here {
                                found(pattern);
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Order of the pieces in which the table of an order is made.
fn piece_order(order: u8) -> u8 {
    order.clamp(PIECES.0, PIECES.1)
}

/// The cell of a code.
fn cell(code: &Code) -> [i16; 4] {
    code.map(|v| (v / CELL).floor() as i16)
}

fn bucket(cell: [i16; 4], buckets: usize) -> usize {
    let key = cell.iter().fold(0_u64, |key, n| key << 16 | u64::from(n.cast_unsigned()));
    // multiplicative hashing (Knuth, The Art of Computer Programming 3, 6.4)
    let mixed = key.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (mixed ^ mixed >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9) as usize >> 20 & (buckets - 1)
}

/// The patterns of one piece of the sky.
fn of_piece(source: &impl Stars, order: u8, piece: u64, patterns: &mut Vec<Pattern>) {
    let middle = |order: u8, number: u64| {
        let (corner, half) = (healpix::corner(order, number), 0.5 / f64::from(1_u32 << order));
        healpix::direction(FacePoint { face: corner.face, x: corner.x + half, y: corner.y + half })
    };
    let pieces = piece_order(order);
    let grid = order.max(pieces);
    let reach = 0.6 * (cell_size(order) + cell_size(grid));
    let centre = middle(pieces, piece);
    let plane = TangentPlane::new(centre.0, centre.1);
    // the points of a piece lie within 0.8 of its size
    let radius = reach + if grid > pieces { 0.8 * cell_size(pieces) } else { 0.0 };
    let count = SPARE * STARS as f64 * (radius / reach).powi(2);
    let stars = brightest(source, centre.0, centre.1, Angle::from_radians(radius), count as usize);
    let flat: Vec<((Angle, Angle), Place)> = stars
        .iter()
        .filter_map(|star| plane.project(star.ra, star.dec).map(|place| ((star.ra, star.dec), place)))
        .collect();
    let fine = 2 * (grid - pieces);
    for point in piece << fine..(piece + 1) << fine {
        let (ra, dec) = middle(grid, point);
        let Some(around) = plane.project(ra, dec) else { continue };
        let near = |place: &Place| (place.0 - around.0).powi(2) + (place.1 - around.1).powi(2) <= reach * reach;
        let chosen: Vec<_> = flat.iter().filter(|(_, place)| near(place)).take(STARS).copied().collect();
        of_point(&chosen, around, (0.6 * cell_size(grid)).powi(2), lengths(order), patterns);
    }
}

/// The patterns of the stars around a point, the brightest first, whose middle is near the point.
fn of_point(
    stars: &[((Angle, Angle), Place)],
    around: Place,
    near_squared: f64,
    (shortest, longest): (f64, f64),
    patterns: &mut Vec<Pattern>,
) {
    let mut uses = [0_u8; STARS];
    let mut left = PATTERNS;
    let mut squared = [[0.0; STARS]; STARS];
    for (p, one) in stars.iter().enumerate() {
        for (q, other) in stars.iter().enumerate() {
            squared[p][q] = (one.1.0 - other.1.0).powi(2) + (one.1.1 - other.1.1).powi(2);
        }
    }
    // A pair that lies too far apart is in none: most fours are passed over without a look.
    let are_near = |p: usize, q: usize| squared[p][q] < longest * longest;
    for four in near_fours(stars.len(), are_near) {
        if four.iter().any(|n| uses[*n] >= USES) {
            continue;
        }
        let [a, b, c, d] = four;
        let sides = [(a, b), (a, c), (a, d), (b, c), (b, d), (c, d)];
        let (most, (p, q)) = sides
            .into_iter()
            .map(|(p, q)| (squared[p][q], (p, q)))
            .fold((0.0, (a, b)), |most, side| if side.0 > most.0 { side } else { most });
        let mid = (0.5 * (stars[p].1.0 + stars[q].1.0), 0.5 * (stars[p].1.1 + stars[q].1.1));
        let off = (mid.0 - around.0).powi(2) + (mid.1 - around.1).powi(2);
        if most < shortest * shortest || off > near_squared {
            continue;
        }
        shapes(&four.map(|n| stars[n].1), 0.0, |shape| {
            let end = |n: usize| stars[four[shape.order[n]]].0;
            patterns.push(Pattern::new([end(0), end(1)], most.sqrt(), shape.code, shape.flipped));
        });
        four.into_iter().for_each(|n| uses[n] += 1);
        left -= 1;
        if left == 0 {
            return;
        }
    }
}

/// All fours of so many stars; those without the later ones first.
pub(super) fn fours(stars: usize) -> impl Iterator<Item = [usize; 4]> {
    (3..stars).flat_map(|d| (2..d).flat_map(move |c| (1..c).flat_map(move |b| (0..b).map(move |a| [a, b, c, d]))))
}

/// Those of [`fours`] in which any two are near each other, in the same order.
fn near_fours(stars: usize, are_near: impl Fn(usize, usize) -> bool + Copy) -> impl Iterator<Item = [usize; 4]> {
    let pairs = move |d: usize| (2..d).filter(move |c| are_near(*c, d)).map(move |c| (c, d));
    let threes = move |(c, d): (usize, usize)| {
        (1..c).filter(move |b| are_near(*b, c) && are_near(*b, d)).map(move |b| (b, c, d))
    };
    let whole = move |(b, c, d): (usize, usize, usize)| {
        (0..b).filter(move |a| are_near(*a, b) && are_near(*a, c) && are_near(*a, d)).map(move |a| [a, b, c, d])
    };
    (3..stars).flat_map(pairs).flat_map(threes).flat_map(whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_fours_are_those_fours_whose_pairs_are_near() {
        let are_near = |p: usize, q: usize| p.abs_diff(q) < 6;
        let all_near =
            |four: &[usize; 4]| four.iter().enumerate().all(|(n, p)| four[n + 1..].iter().all(|q| are_near(*p, *q)));
        let expected: Vec<_> = fours(STARS).filter(all_near).collect();
        assert!(expected.len() > 50 && expected.len() < fours(STARS).count() / 2, "{}", expected.len());
        assert_eq!(near_fours(STARS, are_near).collect::<Vec<_>>(), expected);
    }
}
