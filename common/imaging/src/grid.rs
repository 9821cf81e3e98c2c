//! Points on the frame, found again by place.

/// A uniform grid of linked lists: no allocation per cell.
pub(crate) struct Grid {
    side: f32,
    columns: usize,
    rows: usize,
    /// Newest point of each cell, or `NONE`.
    newest: Vec<u32>,
    /// Points: place, and the point before it in the same cell.
    points: Vec<(f32, f32, u32)>,
}

const NONE: u32 = u32::MAX;
/// Cells are at least this wide, px, so that a large frame needs few of them.
const SMALLEST_CELL: f32 = 16.0;

impl Grid {
    /// For questions about neighbours within some `reach` px.
    pub(crate) fn new(width: usize, height: usize, reach: f32) -> Self {
        let side = reach.max(SMALLEST_CELL);
        let count = |length: usize| (length as f32 / side) as usize + 1;
        let (columns, rows) = (count(width), count(height));
        Self { side, columns, rows, newest: vec![NONE; columns * rows], points: Vec::new() }
    }

    /// Adds a point; points are numbered in the order in which they are added.
    pub(crate) fn add(&mut self, x: f32, y: f32) {
        let cell = self.cell_of(y, self.rows) * self.columns + self.cell_of(x, self.columns);
        let number = self.points.len() as u32;
        self.points.push((x, y, self.newest[cell]));
        self.newest[cell] = number;
    }

    /// Numbers of the points within `reach` px.
    pub(crate) fn near(&self, x: f32, y: f32, reach: f32) -> impl Iterator<Item = usize> {
        let range = |at: f32, count: usize| self.cell_of(at - reach, count)..=self.cell_of(at + reach, count);
        let columns = range(x, self.columns);
        let cells = range(y, self.rows).flat_map(move |row| columns.clone().map(move |c| row * self.columns + c));
        cells
            .flat_map(move |cell| {
                let next = |number: u32| (number != NONE).then_some(number);
                std::iter::successors(next(self.newest[cell]), move |n| next(self.points[*n as usize].2))
            })
            .map(|number| number as usize)
            .filter(move |number| {
                let (px, py, _) = self.points[*number];
                (px - x).powi(2) + (py - y).powi(2) <= reach * reach
            })
    }

    fn cell_of(&self, at: f32, count: usize) -> usize {
        ((at / self.side).max(0.0) as usize).min(count - 1)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn near_finds_what_a_search_through_all_points_finds(
            points in prop::collection::vec((-5.0_f32..210.0, -5.0_f32..110.0), 0..60),
            x in -10.0_f32..220.0, y in -10.0_f32..120.0, reach in 0.5_f32..40.0, side in 1.0_f32..50.0,
        ) {
            let mut grid = Grid::new(200, 100, side);
            points.iter().for_each(|(x, y)| grid.add(*x, *y));
            let mut found: Vec<usize> = grid.near(x, y, reach).collect();
            found.sort_unstable();
            let apart = |(px, py): &(f32, f32)| (px - x).powi(2) + (py - y).powi(2) <= reach * reach;
            let expected: Vec<usize> = (0..points.len()).filter(|n| apart(&points[*n])).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
