//! Single pixels that no star can have made, and what stands in their place.
//!
//! A star of width FWHM, wherever it falls on the pixels, leaves in the brighter of two opposite neighbours at least
//! `q = exp(-4 ln 2 / FWHM^2)` of its brightest pixel, along the rows *and* along the columns. A pixel that stands 6
//! sigma above the median of its neighbours with less than 0.4 q on one of the axes is a defect: a hot pixel, one of a
//! pair, or one of a hot column. A pixel 6 sigma below the sky is one too. To look at the brightest of all four
//! neighbours would not do: a pair of hot pixels passes. (docs/formulae.md, "Single bad pixels".)
//!
//! Defects become NaN and are filled with the median of their good neighbours. No median filter touches the rest.

use crate::background::{Mesh, median_in_place};
use crate::parallel;

/// Pixels nearer to the sky than this many sigma are not looked at.
const STANDS_OUT: f32 = 6.0;
/// Share of the neighbour's due below which it is missing.
const SHARE: f32 = 0.4;
/// The neighbour must be missing by this many sigma, so that faint stars are not lost to noise.
const MISSED: f32 = 2.5;
/// Narrower stars than this cannot be distinguished from defects, px.
pub(crate) const SHARPEST_PX: f32 = 1.5;

/// Pixels that are passed over together when none of them stands out, and rows that share one noise.
const BLOCK: usize = 64;
const NOISE_ROWS: usize = 4;

/// The greatest distance from the sky; in eight lanes, which the compiler keeps in vector registers.
fn furthest(pixels: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; 8];
    let (eights, rest) = pixels.as_chunks::<8>();
    for eight in eights {
        lanes.iter_mut().zip(eight).for_each(|(lane, p)| *lane = if p.abs() > *lane { p.abs() } else { *lane });
    }
    lanes.iter().chain(rest).fold(0.0, |most, p| if p.abs() > most { p.abs() } else { most })
}

/// Positions (`y * width + x`) of the defects in a background-subtracted image, in order.
pub(crate) fn find(image: &[f32], width: usize, noise: &Mesh, fwhm_px: f32) -> Vec<u32> {
    let height = image.len() / width;
    let due = (-4.0 * std::f32::consts::LN_2 / fwhm_px.max(SHARPEST_PX).powi(2)).exp();
    let found = parallel::ranges(height, width, |band| {
        let mut sigma = vec![0.0; width];
        let mut found = Vec::new();
        let mut least = f32::NAN;
        for y in band {
            // the noise hardly changes from row to row
            if least.is_nan() || y % NOISE_ROWS == 0 {
                noise.row(y, &mut sigma);
                least = -parallel::highest(&sigma.iter().map(|s| -s).collect::<Vec<f32>>());
            }
            let line = &image[y * width..(y + 1) * width];
            for (first, (pixels, sigmas)) in line.chunks(BLOCK).zip(sigma.chunks(BLOCK)).enumerate() {
                if furthest(pixels) <= STANDS_OUT * least {
                    continue;
                }
                for (n, (pixel, sigma)) in pixels.iter().zip(sigmas).enumerate() {
                    let x = BLOCK * first + n;
                    if pixel.abs() > STANDS_OUT * sigma && is_defect(image, width, height, (x, y), *sigma, due) {
                        found.push((y * width + x) as u32);
                    }
                }
            }
        }
        found
    });
    found.into_iter().flatten().collect()
}

fn is_defect(image: &[f32], width: usize, height: usize, at: (usize, usize), sigma: f32, due: f32) -> bool {
    let (x, y) = at;
    let pixel = image[y * width + x];
    if pixel < 0.0 {
        return true;
    }
    // f32::max passes over NaN, so that a missing neighbour leaves the word to the opposite one
    let value = |inside: bool, index: usize| if inside { image[index] } else { f32::NAN };
    let here = y * width + x;
    let along_x = value(x > 0, here.wrapping_sub(1)).max(value(x + 1 < width, here + 1));
    let along_y = value(y > 0, here.wrapping_sub(width)).max(value(y + 1 < height, here + width));
    // of a star beyond the edge only the flank is seen: across the edge it may fall by more, along it not
    let (side, end) = (x == 0 || x + 1 == width, y == 0 || y + 1 == height);
    let (neighbour, due) = match (side, end) {
        (true, true) => (along_x.min(along_y), due.powi(3)),
        (true, false) => (along_y, due),
        (false, true) => (along_x, due),
        (false, false) => (along_x.min(along_y), due),
    };
    let is_sharp = neighbour < SHARE * due * pixel && due * pixel - neighbour > MISSED * sigma;
    // the median last: it takes longest, and most pixels above the sky belong to stars
    is_sharp && {
        let (mut around, count) = neighbours(image, width, height, x, y);
        let median = median_in_place(&mut around[..count]).unwrap_or(0.0);
        pixel - median > STANDS_OUT * sigma
    }
}

/// The finite values among the eight neighbours, and their number.
fn neighbours(image: &[f32], width: usize, height: usize, x: usize, y: usize) -> ([f32; 8], usize) {
    let (mut around, mut count) = ([0.0; 8], 0);
    for row in y.saturating_sub(1)..(y + 2).min(height) {
        for column in x.saturating_sub(1)..(x + 2).min(width) {
            let value = image[row * width + column];
            if (row, column) != (y, x) && value.is_finite() {
                around[count] = value;
                count += 1;
            }
        }
    }
    (around, count)
}

/// Fills the given pixels, which are taken as missing, with the median of their good neighbours; the middle of a
/// larger hole follows from its rim, and what three rounds do not reach becomes sky (0).
pub(crate) fn fill(image: &mut [f32], width: usize, missing: &[u32]) {
    let height = image.len() / width;
    missing.iter().for_each(|at| image[*at as usize] = f32::NAN);
    let mut left = missing.to_vec();
    for _ in 0..3 {
        let filled: Vec<Option<f32>> = left
            .iter()
            .map(|at| {
                let (x, y) = (*at as usize % width, *at as usize / width);
                let (mut around, count) = neighbours(image, width, height, x, y);
                // the mean of the two middle values: a defect between a star's flank and the sky is neither
                around[..count].sort_unstable_by(f32::total_cmp);
                (count > 0).then(|| 0.5 * (around[(count - 1) / 2] + around[count / 2]))
            })
            .collect();
        left.iter().zip(&filled).for_each(|(at, value)| {
            if let Some(value) = value {
                image[*at as usize] = *value;
            }
        });
        left = left.iter().zip(filled).filter(|(_, value)| value.is_none()).map(|(at, _)| *at).collect();
        if left.is_empty() {
            return;
        }
    }
    left.iter().for_each(|at| image[*at as usize] = 0.0);
}

#[cfg(test)]
mod tests;
