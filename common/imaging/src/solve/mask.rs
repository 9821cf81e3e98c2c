//! Where the catalogue has stars, one bit per cell: the quick test of a hypothesis.

use super::similarity::Place;
use super::tile::Tile;

/// Smallest cell, px.
const CELL_PX: f64 = 3.0;
/// Greatest number of cells from the middle to the edge.
const MOST_CELLS: f64 = 1500.0;

/// A mask together with the way from the frame to it: what the inner loop of the search needs.
pub(super) struct View<'a> {
    mask: &'a Mask,
    /// Cells per px of x and of y in the frame, and that of the frame's centre.
    column: [f64; 3],
    row: [f64; 3],
}

impl View<'_> {
    /// Whether a place in the frame (px from its centre) falls near a star.
    pub(super) fn is_set(&self, x: f64, y: f64) -> bool {
        // adding 1.5 x 2^52 rounds to a whole number, which then stands in the lowest bits; what is far off, or no
        // number, becomes a cell outside or a harmless one
        const WHOLE: f64 = 6_755_399_441_055_744.0;
        let cell = |[per_x, per_y, zero]: [f64; 3]| (per_x * x + per_y * y + zero + WHOLE).to_bits() as u32;
        let (column, row) = (cell(self.column), cell(self.row));
        let side = self.mask.side as u32;
        let n = row.wrapping_mul(side).wrapping_add(column) as usize;
        column < side && row < side && self.mask.bits.get(n / 64).is_some_and(|word| word >> (n % 64) & 1 != 0)
    }
}

/// Cells of a tile that hold a star or touch one that does.
pub(super) struct Mask {
    bits: Vec<u64>,
    side: i32,
    half: f64,
    per_px: f64,
    /// Share of the tile's disc that is set.
    pub(super) filled: f64,
}

impl Mask {
    pub(super) fn new(tile: &Tile) -> Self {
        let cell = (tile.reach / MOST_CELLS).max(CELL_PX);
        let half = (tile.reach / cell).ceil() + 2.0;
        let side = 2 * half as i32;
        let mut mask =
            Self { bits: vec![0; (side as usize).pow(2).div_ceil(64)], side, half, per_px: 1.0 / cell, filled: 0.0 };
        let mut set = 0_u64;
        for star in &tile.stars {
            let (column, row) = mask.cell(*star);
            for (dx, dy) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)] {
                if let Some((word, bit)) = mask.bit(column.saturating_add(dx), row.saturating_add(dy)) {
                    set += u64::from(mask.bits[word] & bit == 0);
                    mask.bits[word] |= bit;
                }
            }
        }
        mask.filled = (set as f64 * cell * cell / (std::f64::consts::PI * tile.reach * tile.reach)).min(1.0);
        mask
    }

    /// The mask as it is seen from the frame, where `w = back z + centre` and x is turned about if `mirrored`.
    pub(super) fn seen_from(&self, back: Place, centre: Place, mirrored: bool) -> View<'_> {
        let (along_x, along_y) = (if mirrored { -self.per_px } else { self.per_px }, self.per_px);
        // half a cell less: a view rounds where `cell` cuts off
        let middle = self.half - 0.5;
        View {
            mask: self,
            column: [along_x * back.0, -along_x * back.1, along_x * centre.0 + middle],
            row: [along_y * back.1, along_y * back.0, along_y * centre.1 + middle],
        }
    }

    fn cell(&self, (x, y): (f64, f64)) -> (i32, i32) {
        // casts saturate: what is far off, or no number, is a cell outside or a harmless one
        ((x * self.per_px + self.half) as i32, (y * self.per_px + self.half) as i32)
    }

    /// The word of a cell and its bit there; None at the edge and outside.
    fn bit(&self, column: i32, row: i32) -> Option<(usize, u64)> {
        let inside = column > 0 && row > 0 && column < self.side && row < self.side;
        let n = (row.wrapping_mul(self.side)).wrapping_add(column) as usize;
        inside.then_some((n / 64, 1 << (n % 64)))
    }
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;
    use crate::tangent::TangentPlane;

    #[test]
    fn a_star_that_is_nowhere_near_is_no_part_of_the_mask() {
        let plane = TangentPlane::new(Angle::default(), Angle::default());
        let tile = |stars| Tile { plane, stars, radius: 200.0, reach: 500.0, scale: 1e-6 };
        let near = vec![(100.0, -40.0)];
        let far = [(1e300, 0.0), (0.0, -1e300), (f64::INFINITY, f64::NEG_INFINITY), (1e12, 1e12)];
        let filled = |stars| Mask::new(&tile(stars)).filled;
        assert_eq!(filled(far.into_iter().chain(near.clone()).collect()), filled(near));
        assert_eq!(filled(far.to_vec()), 0.0);
    }

    #[test]
    fn a_star_is_seen_from_where_it_is_and_from_nowhere_else() {
        let stars = vec![(100.0, -40.0), (-310.0, 222.0)];
        let plane = TangentPlane::new(Angle::default(), Angle::default());
        let tile = Tile { plane, stars, radius: 200.0, reach: 500.0, scale: 1e-6 };
        let mask = Mask::new(&tile);
        let (back, centre) = ((0.8, 0.6), (20.0, -7.0));
        for mirrored in [false, true] {
            let view = mask.seen_from(back, centre, mirrored);
            for star in &tile.stars {
                // z = (w - centre) / back, and back is of length 1
                let w = (if mirrored { -star.0 } else { star.0 } - centre.0, star.1 - centre.1);
                let z = (0.8 * w.0 + 0.6 * w.1, 0.8 * w.1 - 0.6 * w.0);
                for n in 0..12 {
                    let (sin, cos) = f64::from(n).sin_cos();
                    assert!(view.is_set(z.0 + 2.9 * cos, z.1 + 2.9 * sin), "{star:?} {mirrored} {n}");
                    assert!(!view.is_set(z.0 + 9.0 * cos, z.1 + 9.0 * sin), "{star:?} {mirrored} {n}");
                }
            }
            for far in [600.0, -600.0, 1e6, -1e12, 1e300, f64::INFINITY, f64::NAN] {
                assert!(!view.is_set(far, 0.0) && !view.is_set(0.0, far) && !view.is_set(far, far), "{far}");
            }
        }
    }
}
