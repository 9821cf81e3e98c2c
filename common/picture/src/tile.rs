//! A frame in tiles at several scales, 16 bits a pixel.
//!
//! At the highest level a pixel of a tile is one of the frame; each level below has half as many columns and rows, down to
//! level 0, which is one tile.

use crate::shrink::{Region, shrink};
use crate::{Frame, Pixels};

/// The number of a pixel without a value.
const BLANK: u16 = u16::MAX;

/// A tile.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// From numbers to values.
    pub scaling: Scaling,
    /// The numbers, row by row.
    pub numbers: Vec<u16>,
}

/// A value is `zero + scale * number`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scaling {
    /// The value of number 0.
    pub zero: f64,
    /// The difference between two numbers.
    pub scale: f64,
    /// The number that stands for no value; absent where every number is a value.
    pub blank: Option<u16>,
}

impl Scaling {
    /// Counts as they are; other values so that the whole frame fits, the same for all its tiles.
    pub fn of(pixels: Pixels<'_>) -> Self {
        let Pixels::Values(values) = pixels else { return Self { zero: 0.0, scale: 1.0, blank: None } };
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let (least, most) =
            finite.fold((f32::MAX, f32::MIN), |(least, most), value| (least.min(value), most.max(value)));
        let range = f64::from(most) - f64::from(least);
        let scale = if range > 0.0 { range / f64::from(BLANK - 1) } else { 1.0 };
        let zero = if most >= least { f64::from(least) } else { 0.0 };
        Self { zero, scale, blank: Some(BLANK) }
    }

    fn number(self, value: f32) -> u16 {
        if !value.is_finite() {
            return BLANK;
        }
        // `as` saturates.
        let number = ((f64::from(value) - self.zero) / self.scale).round();
        (number as u16).min(if self.blank.is_some() { BLANK - 1 } else { BLANK })
    }
}

/// The level at which a pixel of a tile is one of the frame.
pub fn highest_level(frame: Frame<'_>, side: usize) -> u32 {
    let tiles = frame.width.max(frame.height).div_ceil(side.max(1));
    tiles.max(1).next_power_of_two().ilog2()
}

/// A tile of at most `side` columns and rows; `None` where the frame has none there.
pub fn tile(frame: Frame<'_>, scaling: Scaling, side: usize, (level, column, row): (u32, u32, u32)) -> Option<Tile> {
    let block = 1_usize << highest_level(frame, side).checked_sub(level)?;
    let step = side.checked_mul(block)?;
    let (x, y) = (step.checked_mul(column as usize)?, step.checked_mul(row as usize)?);
    if x >= frame.width || y >= frame.height {
        return None;
    }
    let region = Region { x, y, width: step.min(frame.width - x), height: step.min(frame.height - y) };
    let small = shrink(frame, region, block);
    let numbers = small.pixels.iter().map(|value| scaling.number(*value)).collect();
    Some(Tile { width: small.width, height: small.height, scaling, numbers })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tiles_of_the_highest_level_are_the_pixels_of_the_frame() {
        let (width, height) = (70, 40);
        let counts: Vec<u16> = (0..width * height).map(|i| (i * 23 % 65_536) as u16).collect();
        let frame = Frame { width, height, pixels: Pixels::Counts(&counts) };
        let (scaling, highest) = (Scaling::of(frame.pixels), highest_level(frame, 32));
        assert_eq!(highest, 2, "3 columns of tiles need 4");
        let mut again = vec![0; width * height];
        for row in 0..2 {
            for column in 0..3 {
                let tile = tile(frame, scaling, 32, (highest, column, row)).unwrap();
                for (i, number) in tile.numbers.iter().enumerate() {
                    let (x, y) = (column as usize * 32 + i % tile.width, row as usize * 32 + i / tile.width);
                    again[y * width + x] = *number;
                }
            }
        }
        assert_eq!(again, counts);
        let whole = tile(frame, scaling, 32, (0, 0, 0)).unwrap();
        assert_eq!((whole.width, whole.height), (18, 10));
        for beyond in [
            (highest, 3, 0),
            (highest, 0, 2),
            (0, 1, 0),
            (0, 0, 1),
            (highest + 1, 0, 0),
            (u32::MAX, 0, 0),
            (2, u32::MAX, u32::MAX),
        ] {
            assert_eq!(tile(frame, scaling, 32, beyond), None, "{beyond:?}");
        }
    }

    #[test]
    fn values_fill_the_numbers_and_what_has_no_value_is_blank() {
        let frame = Frame { width: 4, height: 1, pixels: Pixels::Values(&[-10.0, f32::NAN, 0.0, 90.0]) };
        let scaling = Scaling::of(frame.pixels);
        let tile = tile(frame, scaling, 256, (0, 0, 0)).unwrap();
        assert_eq!(tile.numbers[1], scaling.blank.unwrap());
        let value = |number: u16| scaling.zero + scaling.scale * f64::from(number);
        for (number, expected) in [(tile.numbers[0], -10.0), (tile.numbers[2], 0.0), (tile.numbers[3], 90.0)] {
            assert!((value(number) - expected).abs() < 0.002, "{number} {expected}");
        }
        let empty = Scaling::of(Pixels::Values(&[f32::NAN; 3]));
        assert!(empty.zero.is_finite() && empty.scale.is_finite());
    }
}
