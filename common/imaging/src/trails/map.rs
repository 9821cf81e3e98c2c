//! The frame in coarse pixels, as significance over the sky.

use crate::background::median_in_place;
use crate::clean::Clean;
use crate::parallel;

/// The finest map is no longer than this, px.
const LONGEST: usize = 768;
/// The coarsest map is no shorter than this, px.
const SHORTEST: usize = 48;

/// Significance of the mean of `bin` x `bin` px, row by row.
pub(super) struct Map {
    pub(super) bin: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    values: Vec<f32>,
}

impl Map {
    /// The finest map of a frame.
    pub(super) fn new(clean: &Clean) -> Self {
        let longer = clean.width.max(clean.height);
        let bin = (0..).map(|power| 1_usize << power).find(|bin| longer / bin <= LONGEST).unwrap_or(1);
        let (width, height) = (clean.width / bin, clean.height / bin);
        let bands = parallel::ranges(height, bin * clean.width, |rows| {
            let mut noise = vec![0.0; clean.width];
            let mut values = Vec::with_capacity(rows.len() * width);
            for row in rows {
                let first = row * bin * clean.width;
                clean.background.noise.row(row * bin, &mut noise);
                let mut sums = vec![0.0_f32; width];
                for line in clean.pixels[first..first + bin * clean.width].chunks(clean.width) {
                    add_bins(&mut sums, line, bin);
                }
                values.extend(sums.iter().zip(noise.chunks(bin)).map(|(sum, noise)| sum / (bin as f32 * noise[0])));
            }
            values
        });
        Self { bin, width, height, values: bands.concat() }.with_scatter_of_one()
    }

    /// The map in pixels of twice the side; None below a size at which nothing is recognised any more.
    pub(super) fn coarser(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width.min(height) < SHORTEST {
            return None;
        }
        let at = |x: usize, y: usize| self.values[y * self.width + x];
        let four = |n: usize| {
            let (x, y) = (2 * (n % width), 2 * (n / width));
            0.5 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
        };
        let values = (0..width * height).map(four).collect();
        Some(Self { bin: 2 * self.bin, width, height, values }.with_scatter_of_one())
    }

    /// Significance at a place; lower than any outside of the map.
    pub(super) fn at(&self, x: isize, y: isize) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside { self.values[y as usize * self.width + x as usize] } else { f32::NEG_INFINITY }
    }

    /// Places above a threshold, of too many each so manyth.
    pub(super) fn above(&self, threshold: f32, most: usize) -> Vec<(usize, usize)> {
        let lit: Vec<usize> = (0..self.values.len()).filter(|n| self.values[*n] > threshold).collect();
        let step = lit.len().div_ceil(most).max(1);
        lit.iter().step_by(step).map(|n| (n % self.width, n / self.width)).collect()
    }

    /// Noise that is correlated from pixel to pixel scatters by more; what scatters by less is left.
    fn with_scatter_of_one(mut self) -> Self {
        let mut sample: Vec<f32> = self.values.iter().copied().step_by(self.values.len() / 20_000 + 1).collect();
        let rank = (0.158_655 * sample.len() as f64) as usize;
        if rank == 0 {
            return self;
        }
        let low = *sample.select_nth_unstable_by(rank, f32::total_cmp).1;
        let scatter = median_in_place(&mut sample).map_or(1.0, |median| median - low);
        if scatter > 1.0 {
            self.values.iter_mut().for_each(|value| *value /= scatter);
        }
        self
    }
}

/// Adds the pixels of a row to the sums of their coarse pixels.
fn add_bins(sums: &mut [f32], line: &[f32], bin: usize) {
    match bin {
        1 => sums.iter_mut().zip(line).for_each(|(sum, pixel)| *sum += pixel),
        2 => sums.iter_mut().zip(line.as_chunks::<2>().0).for_each(|(sum, [a, b])| *sum += a + b),
        4 => sums.iter_mut().zip(line.as_chunks::<4>().0).for_each(|(sum, [a, b, c, d])| *sum += (a + b) + (c + d)),
        _ => sums.iter_mut().zip(line.chunks(bin)).for_each(|(sum, pixels)| *sum += pixels.iter().sum::<f32>()),
    }
}
