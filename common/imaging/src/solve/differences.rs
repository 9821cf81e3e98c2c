//! Level 0: rotation, scale and parity are known, so that one shift takes all catalogue stars to their places.
//!
//! All differences between places in the frame and in the catalogue fall into the cells of a histogram; the true
//! shift is the cell in which they gather.

use super::candidate::{By, Candidate};
use super::field::FrameStars;
use super::similarity::Similarity;
use super::tile::Tile;

/// Smallest cell, px.
const CELL_PX: f64 = 3.0;
/// Greatest number of cells from the middle to the edge.
const MOST_CELLS: f64 = 512.0;
/// Peaks of one turn that are examined before the next turn is looked at, the fullest first.
const AT_ONCE: usize = 3;
/// Peaks of all turns that are examined after that, the fullest first.
const EXAMINED: usize = 24;
/// Fewest differences in 2 x 2 cells.
const FEWEST: u16 = 3;

/// 2 x 2 cells in which differences gather.
#[derive(Debug, Clone, Copy)]
struct DifferencePeak {
    count: u16,
    /// The turn, with the middle of the four cells as its shift.
    start: Similarity,
}

/// The best shift among those that leave the frame's centre within the tile's radius, and the number of cells that
/// were searched. Each of `turns` is a rotation that may be the right one, at the known scale, the most probable first;
/// `is_certain` says of a candidate and the number of cells so far whether to stop.
pub(super) fn best_shift(
    field: &FrameStars,
    tile: &Tile,
    turns: &[Similarity],
    is_certain: impl Fn(&Candidate, u64) -> bool,
) -> (Option<Candidate>, u64) {
    let mut searched = 0;
    let Some(first) = turns.first() else { return (None, searched) };
    let mut histogram = Histogram::new(tile.radius * first.size());
    let cell = histogram.cell;
    let examine = |peak: &DifferencePeak| {
        let start = peak.start;
        let wide = (cell > CELL_PX).then(|| gathered(field, tile, &start, cell)).flatten();
        Candidate::examine(field, tile, wide.unwrap_or(start), By::Shift)
    };
    let better = |best: Option<Candidate>, peak: &DifferencePeak| {
        let found = examine(peak).filter(|new| best.is_none_or(|old| new.chance < old.chance));
        found.or(best)
    };
    let (mut best, mut later) = (None, Vec::new());
    for turn in turns {
        histogram.fill(field, tile, turn);
        searched += histogram.blocks.len() as u64;
        let mut peaks = histogram.peaks(turn);
        let rest = peaks.split_off(peaks.len().min(AT_ONCE));
        best = peaks.iter().fold(best, better);
        if best.is_some_and(|best| is_certain(&best, searched)) {
            return (best, searched);
        }
        later.extend(rest);
    }
    // a stable sort: among peaks that are as full, the most probable turn comes first
    later.sort_by_key(|peak| std::cmp::Reverse(peak.count));
    (later.iter().take(EXAMINED).fold(best, better), searched)
}

/// How many differences fall into each square of 2 x 2 cells: a peak on a border falls into up to four cells.
struct Histogram {
    /// Side of a cell, px.
    cell: f64,
    /// Cells from the middle to the edge.
    half: f64,
    /// Cells along a side.
    side: usize,
    /// Differences in a cell and those after it, to the right and above.
    blocks: Vec<u16>,
    /// The blocks that hold `FEWEST` and more.
    full: Vec<usize>,
}

impl Histogram {
    /// For shifts of up to `window` px in both directions.
    fn new(window: f64) -> Self {
        let cell = (window / MOST_CELLS).max(CELL_PX);
        let half = (window / cell).ceil() + 2.0;
        let side = 2 * half as usize + 1;
        Self { cell, half, side, blocks: vec![0; side * side], full: Vec::new() }
    }

    fn fill(&mut self, field: &FrameStars, tile: &Tile, turn: &Similarity) {
        self.blocks.fill(0);
        self.full.clear();
        let (per_px, end) = (1.0 / self.cell, (self.side - 1) as f64);
        let reach = (self.half * self.cell + 0.5 * field.width, self.half * self.cell + 0.5 * field.height);
        for place in &tile.stars {
            let at = turn.apply(*place);
            if at.0.abs() > reach.0 || at.1.abs() > reach.1 {
                continue;
            }
            for spot in &field.spots {
                // what is no number is outside
                let (x, y) = ((spot.x - at.0) * per_px + self.half, (spot.y - at.1) * per_px + self.half);
                if x >= 1.0 && y >= 1.0 && x < end && y < end {
                    let n = y as usize * self.side + x as usize;
                    [n, n - 1, n - self.side, n - self.side - 1].into_iter().for_each(|block| self.add(block));
                }
            }
        }
    }

    fn add(&mut self, block: usize) {
        let count = &mut self.blocks[block];
        *count = count.saturating_add(1);
        if *count == FEWEST {
            self.full.push(block);
        }
    }

    /// The fullest blocks, the fullest first; not more than are ever examined.
    fn peaks(&self, turn: &Similarity) -> Vec<DifferencePeak> {
        let mut full: Vec<(u16, usize)> = self.full.iter().map(|n| (self.blocks[*n], *n)).collect();
        full.sort_unstable_by(|a, b| b.cmp(a));
        full.truncate(AT_ONCE + EXAMINED);
        // the middle of four cells is the corner of the last one
        let at = |n: usize| (n as f64 - self.half + 1.0) * self.cell;
        let peak = |(count, n): (u16, usize)| {
            let t = (at(n % self.side), at(n / self.side));
            DifferencePeak { count, start: Similarity { t, ..*turn } }
        };
        full.into_iter().map(peak).collect()
    }
}

/// The shift on which most differences within a wide block of cells agree.
fn gathered(field: &FrameStars, tile: &Tile, start: &Similarity, cell: f64) -> Option<Similarity> {
    let mut differences = Vec::new();
    for place in &tile.stars {
        let at = start.apply(*place);
        let inside = |d: &(f64, f64)| d.0.abs() <= cell && d.1.abs() <= cell;
        differences.extend(field.spots.iter().map(|spot| (spot.x - at.0, spot.y - at.1)).filter(inside));
    }
    let agree = |d: &(f64, f64)| differences.iter().filter(|o| (o.0 - d.0).hypot(o.1 - d.1) < CELL_PX).count();
    let best = differences.iter().max_by_key(|d| agree(d))?;
    Some(Similarity { t: (start.t.0 + best.0, start.t.1 + best.1), ..*start })
}
