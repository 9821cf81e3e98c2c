//! Fewer pixels: each is the mean of a block.

use crate::{Frame, Pixels, Small};

/// A part of a frame, px.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// The columns and rows of a block with which the longest side becomes at most `longest`.
pub fn block(width: usize, height: usize, longest: usize) -> usize {
    width.max(height).div_ceil(longest.max(1)).max(1)
}

/// A part of a frame in blocks of `block` columns and rows; the part is cut at the edges of the frame.
pub fn shrink(frame: Frame<'_>, region: Region, block: usize) -> Small {
    let (block, columns) = (block.max(1), frame.width);
    let region = Region {
        width: region.width.min(columns.saturating_sub(region.x)),
        height: region.height.min(frame.height.saturating_sub(region.y)),
        ..region
    };
    let (width, height) = (region.width.div_ceil(block), region.height.div_ceil(block));
    let mut small = Small { width, height, pixels: Vec::with_capacity(width * height) };
    match frame.pixels {
        Pixels::Counts(counts) => add_counts(&mut small.pixels, counts, columns, region, block),
        Pixels::Values(values) => add_values(&mut small.pixels, values, columns, region, block),
    }
    small
}

/// A frame in blocks of `block` columns and rows that comes some rows at a time: `next` puts the next rows into the vector, at
/// most as many as the number that it gets.
///
/// # Errors
/// Those of `next`.
pub fn shrink_rows<E>(
    (width, height): (usize, usize),
    block: usize,
    mut next: impl FnMut(usize, &mut Vec<u16>) -> Result<(), E>,
) -> Result<Small, E> {
    let block = block.max(1);
    let mut small = Small { width: width.div_ceil(block), height: height.div_ceil(block), pixels: Vec::new() };
    small.pixels.reserve(small.width * small.height);
    let mut counts = Vec::new();
    for first in (0..height).step_by(block) {
        let rows = block.min(height - first);
        next(rows, &mut counts)?;
        let region = Region { x: 0, y: 0, width, height: rows };
        add_counts(&mut small.pixels, &counts, width, region, block);
    }
    Ok(small)
}

/// The pixels of one row of the region.
fn row<T>(pixels: &[T], columns: usize, region: Region, y: usize) -> &[T] {
    let row = pixels.get((region.y + y) * columns..).unwrap_or_default();
    let row = row.get(..columns).unwrap_or(row).get(region.x..).unwrap_or_default();
    row.get(..region.width).unwrap_or(row)
}

/// Counts always have a value, so that whole numbers are added.
fn add_counts(into: &mut Vec<f32>, counts: &[u16], columns: usize, region: Region, block: usize) {
    if block == 1 {
        (0..region.height)
            .for_each(|y| into.extend(row(counts, columns, region, y).iter().map(|count| f32::from(*count))));
        return;
    }
    let mut sums = vec![0_u32; region.width];
    for first in (0..region.height).step_by(block) {
        let rows = block.min(region.height - first);
        sums.fill(0);
        for y in first..first + rows {
            // 65,536 rows of the highest count still fit.
            for (sum, count) in sums.iter_mut().zip(row(counts, columns, region, y)) {
                *sum = sum.saturating_add(u32::from(*count));
            }
        }
        let mean = |sums: &[u32]| {
            let sum: u64 = sums.iter().map(|sum| u64::from(*sum)).sum();
            (sum as f64 / (sums.len() * rows) as f64) as f32
        };
        match block {
            // A length that is known makes the loop a third as long.
            2 => into.extend(sums.chunks(2).map(mean)),
            4 => into.extend(sums.chunks(4).map(mean)),
            _ => into.extend(sums.chunks(block).map(mean)),
        }
    }
}

fn add_values(into: &mut Vec<f32>, values: &[f32], columns: usize, region: Region, block: usize) {
    if block == 1 {
        let finite = |value: &f32| if value.is_finite() { *value } else { f32::NAN };
        (0..region.height).for_each(|y| into.extend(row(values, columns, region, y).iter().map(finite)));
        return;
    }
    let mut sums = vec![(0.0_f64, 0_u32); region.width.div_ceil(block)];
    for first in (0..region.height).step_by(block) {
        sums.fill((0.0, 0));
        for y in first..(first + block).min(region.height) {
            for (sum, values) in sums.iter_mut().zip(row(values, columns, region, y).chunks(block)) {
                for value in values.iter().filter(|value| value.is_finite()) {
                    *sum = (sum.0 + f64::from(*value), sum.1 + 1);
                }
            }
        }
        let mean = |(sum, count): &(f64, u32)| if *count == 0 { f32::NAN } else { (sum / f64::from(*count)) as f32 };
        into.extend(sums.iter().map(mean));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(width: usize, height: usize, pixels: Pixels<'_>) -> Frame<'_> {
        Frame { width, height, pixels }
    }

    #[test]
    fn counts_and_values_have_the_same_means_and_the_edge_block_is_smaller() {
        let counts: Vec<u16> = (0..35 * 21).map(|i| (i * 97 % 65_536) as u16).collect();
        let values: Vec<f32> = counts.iter().map(|count| f32::from(*count)).collect();
        let whole = Region { x: 0, y: 0, width: 35, height: 21 };
        let part = Region { x: 3, y: 5, width: 17, height: 9 };
        let beyond = Region { x: 30, y: 20, width: 90, height: 90 };
        for (region, block) in
            [(whole, 1), (whole, 2), (whole, 3), (whole, 4), (whole, 40), (part, 1), (part, 2), (part, 5), (beyond, 2)]
        {
            let of_counts = shrink(frame(35, 21, Pixels::Counts(&counts)), region, block);
            assert_eq!(of_counts, shrink(frame(35, 21, Pixels::Values(&values)), region, block), "{region:?} {block}");
            assert_eq!(of_counts.pixels.len(), of_counts.width * of_counts.height);
        }
        for block in [1, 2, 4, 40] {
            let mut from = counts.as_slice();
            let small = shrink_rows((35, 21), block, |rows, into| -> Result<(), ()> {
                let (now, later) = from.split_at(rows * 35);
                from = later;
                *into = now.to_vec();
                Ok(())
            });
            assert_eq!(small, Ok(shrink(frame(35, 21, Pixels::Counts(&counts)), whole, block)), "{block}");
        }
        assert_eq!(shrink_rows((35, 21), 2, |_, _| Err("cut")), Err("cut"));
        let region = Region { x: 0, y: 0, width: 3, height: 2 };
        let small = shrink(frame(3, 2, Pixels::Counts(&[1, 3, 10, 5, 7, 30])), region, 2);
        assert_eq!(small, Small { width: 2, height: 1, pixels: vec![4.0, 20.0] });
    }

    #[test]
    fn a_pixel_that_is_no_number_does_not_spoil_its_block() {
        let region = Region { x: 0, y: 0, width: 2, height: 1 };
        let of = |pixels: &[f32]| shrink(frame(2, 1, Pixels::Values(pixels)), region, 2).pixels;
        assert_eq!(of(&[f32::NAN, 4.0]), [4.0]);
        assert!(of(&[f32::INFINITY, f32::NAN])[0].is_nan());
    }
}
