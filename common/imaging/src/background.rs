//! Sky level and noise as two coarse meshes that are evaluated row by row.
//!
//! The frame is divided into nearly equal cells of about 64 px (32 px where the shorter side is under 1500 px),
//! so that no narrow cell is left over at an edge. Each cell gives the clipped median and 1.4826 MAD of its pixels
//! ([`cell`]); cells with less than half of their pixels in use are filled from their neighbours, and the mesh is
//! smoothed and interpolated ([`mesh`]). No full-size map is made.
//! Sources: docs/formulae.md, "Sky level and noise".

mod cell;
mod mesh;

use crate::parallel;

pub(crate) use cell::median_in_place;
pub use mesh::Mesh;

/// Side of a cell, px, on large frames and on frames whose shorter side is below [`SMALL_FRAME`].
const CELL: (usize, usize) = (64, 32);
const SMALL_FRAME: usize = 1500;

/// A cell is at least this many FWHM wide, or it would take the light of faint stars for sky ...
const CELL_FWHM: f32 = 10.0;
/// ... but there are at least this many along the shorter side.
const FEWEST_CELLS: usize = 4;

/// Side of the cells, px, for stars of a known width.
pub(crate) fn side(width: usize, height: usize, fwhm_px: Option<f32>) -> usize {
    let shorter = width.min(height);
    let usual = if shorter < SMALL_FRAME { CELL.1 } else { CELL.0 };
    let wide = fwhm_px.map_or(0, |fwhm| (CELL_FWHM * fwhm) as usize);
    usual.max(wide.min(shorter / FEWEST_CELLS)).max(1)
}

/// Of cells with so many pixels every second row is looked at: it shows the level to 0.03 sigma, and takes half of the
/// time. Larger cells are made for wide stars, which need the level to 0.01 sigma.
const HALVED: std::ops::Range<usize> = 2400..6000;

/// Sky level and noise of a frame.
#[derive(Debug, Clone)]
pub struct Background {
    /// Sky level, ADU.
    pub level: Mesh,
    /// Standard deviation of a pixel's noise on empty sky, ADU; greater than zero.
    pub noise: Mesh,
}

impl Background {
    /// Measures an image; `quantum` is the step of the digitisation (1 for raw counts, 0 for continuous values).
    /// Cells whose level is not below `saturation` are not sky. None when no cell is sky.
    pub(crate) fn measure(
        image: &[f32],
        width: usize,
        quantum: f32,
        saturation: f32,
        fwhm_px: Option<f32>,
    ) -> Option<Self> {
        let read = |y: usize, to: &mut [f32]| to.copy_from_slice(&image[y * width..(y + 1) * width]);
        Self::of_rows((width, image.len() / width), read, quantum, saturation, fwhm_px)
    }

    /// The same of an image of `(width, height)` px that need not exist as a whole: `read` writes row `y`. Each row is
    /// asked for once at most.
    pub(crate) fn of_rows(
        (width, height): (usize, usize),
        read: impl Fn(usize, &mut [f32]) + Sync,
        quantum: f32,
        saturation: f32,
        fwhm_px: Option<f32>,
    ) -> Option<Self> {
        let side = side(width, height, fwhm_px);
        let count = |length: usize| ((length + side / 2) / side).max(1);
        let (columns, rows) = (count(width), count(height));
        // rounded, not cut off: else all cells would stand half a pixel lower than the mesh believes
        let bound = |n: usize, of: usize, length: usize| (2 * n * length + of) / (2 * of);
        let across = |column: usize| bound(column, columns, width)..bound(column + 1, columns, width);
        let per_band = parallel::ranges(rows, width * side, |band| {
            let mut scratch = cell::Scratch::default();
            let mut cells = Vec::with_capacity(band.len() * columns);
            let mut lines = Vec::new();
            for row in band {
                let ys = bound(row, rows, height)..bound(row + 1, rows, height);
                let step = |column: usize| if HALVED.contains(&(ys.len() * across(column).len())) { 2 } else { 1 };
                let rows_apart = (0..columns).map(step).min().unwrap_or(1);
                lines.resize(ys.len().div_ceil(rows_apart) * width, 0.0);
                ys.clone().step_by(rows_apart).zip(lines.chunks_mut(width)).for_each(|(y, line)| read(y, line));
                // a cell looks much like the one before it in its row
                let mut before = None;
                for column in 0..columns {
                    let of_cell =
                        lines.chunks(width).step_by(step(column) / rows_apart).map(|line| &line[across(column)]);
                    let sky = scratch.measure(of_cell, quantum, before);
                    before = sky;
                    cells.push(sky.filter(|sky| sky.level < saturation));
                }
            }
            cells
        });
        let cells: Vec<Option<cell::SkyLevel>> = per_band.into_iter().flatten().collect();
        let mesh = |of: fn(&cell::SkyLevel) -> f32| {
            let values: Vec<Option<f32>> = cells.iter().map(|sky| sky.as_ref().map(of)).collect();
            Mesh::new(columns, rows, width, height, values)
        };
        Some(Self { level: mesh(|sky| sky.level)?, noise: mesh(|sky| sky.noise)? })
    }
}

#[cfg(test)]
mod tests;
