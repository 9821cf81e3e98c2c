//! Rows and columns that stand above or below the rest: bias bands, and lines that are broken as a whole.
//!
//! Each line is cut into eight segments. A segment's offset is the mean of its pixels clamped to +-2 sigma (a
//! one-step M-estimate, Huber 1964), which a few stars hardly move, and the line's offset is the median of its
//! segments, which one large halo does not move at all. Lines are corrected only if one of them is off by more than
//! chance allows.

use crate::background::median_in_place;
use crate::parallel;

/// Lines shorter than this are left alone: their offset would be no better known than a pixel.
const SHORTEST: usize = 128;
const SEGMENTS: usize = 8;
/// Pixels are clamped at this many sigma; of white noise the clamped mean then grows by `SLOPE` per sigma of offset
/// and scatters by `SPREAD` sigma per pixel.
const CLAMP: f32 = 2.0;
const SLOPE: f32 = 0.954_5;
const SPREAD: f32 = 0.96;
/// Efficiency of a median of eight: its scatter is greater than the mean's by this.
const MEDIAN: f32 = 1.18;
/// Offsets beyond this many standard errors are bands.
const SIGNIFICANT: f32 = 6.0;
/// Clamped means above this are no longer linear; the line's true median is taken.
const LINEAR: f32 = 0.7;
/// A whole line quieter or noisier than this (in units of the frame's noise) carries no sky.
const ALIVE: std::ops::Range<f32> = 0.3..2.5;
/// Most bad lines side by side.
const WIDEST_RUN: usize = 3;
/// How much farther off than the lines next to them they are.
const STANDS_OUT: f32 = 3.0;

/// What was wrong with the lines of a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Banding {
    /// Whether offsets were subtracted.
    pub(crate) removed: bool,
    /// Numbers of the columns without sky.
    pub(crate) bad_columns: Vec<usize>,
    /// Numbers of the rows without sky.
    pub(crate) bad_rows: Vec<usize>,
}

/// Removes the offsets of rows and columns from a background-subtracted image whose noise is `sigma` and whose means are
/// `means`, and sets bad lines to NaN.
pub(crate) fn remove(image: &mut [f32], width: usize, sigma: f32, means: BandingMeans) -> Banding {
    let height = image.len() / width;
    let mut banding = Banding::default();
    let mut known = Some(means);
    for _ in 0..3 {
        let BandingMeans { rows, columns } = known.take().unwrap_or_else(|| measure(image, width, sigma));
        let row = |y: usize| image[y * width..(y + 1) * width].iter().copied();
        let rows = Offsets::judge(&rows, width, sigma, row);
        let mut columns = Offsets::judge(&columns, height, sigma, |x| image[x..].iter().copied().step_by(width));
        columns.leave_mean_to_rows();
        banding.bad_rows.extend(&rows.bad);
        banding.bad_columns.extend(&columns.bad);
        if !rows.found() && !columns.found() {
            break;
        }
        banding.removed = true;
        let (rows, columns) = (rows.worth_correcting(), columns.worth_correcting());
        parallel::bands_mut(image, width, |first, band| {
            for (n, line) in band.chunks_mut(width).enumerate() {
                let row = rows[first + n];
                line.iter_mut().zip(&columns).for_each(|(pixel, column)| *pixel -= row + column);
            }
        });
    }
    banding
}

/// Offsets of all lines of one direction, ADU; NaN for a line without sky.
struct Offsets {
    offset: Vec<f32>,
    bad: Vec<usize>,
    /// Whether most of the line has the offset.
    is_band: Vec<bool>,
    /// Greatest offset by chance, ADU.
    limit: f32,
}

impl Offsets {
    fn judge<I: Iterator<Item = f32>>(
        means: &[[f32; SEGMENTS]],
        length: usize,
        sigma: f32,
        line: impl Fn(usize) -> I,
    ) -> Self {
        let lines = means.len();
        let mut all =
            Self { offset: vec![0.0; lines], bad: Vec::new(), is_band: vec![false; lines], limit: f32::INFINITY };
        if length < SHORTEST {
            return all;
        }
        all.limit = sigma * SIGNIFICANT * MEDIAN * SPREAD / (length as f32).sqrt();
        for (n, segments) in means.iter().enumerate() {
            let mut segments = *segments;
            segments.sort_unstable_by(f32::total_cmp);
            let mean = 0.5 * (segments[SEGMENTS / 2 - 1] + segments[SEGMENTS / 2]);
            // nearly all segments of a band share its offset; a halo covers some
            let shared = if mean > 0.0 { segments[2] } else { -segments[SEGMENTS - 3] };
            all.is_band[n] = shared > 0.5 * SIGNIFICANT * MEDIAN * SPREAD / (length as f32).sqrt();
            all.offset[n] = sigma * mean / SLOPE;
            if mean.abs() > LINEAR {
                let mut values: Vec<f32> = line(n).filter(|value| value.is_finite()).collect();
                let Some(median) = median_in_place(&mut values) else { continue };
                values.iter_mut().for_each(|value| *value = (*value - median).abs());
                let noise = 1.4826 * median_in_place(&mut values).unwrap_or(0.0) / sigma;
                all.offset[n] = median;
                if !ALIVE.contains(&noise) {
                    all.bad.push(n);
                }
            }
        }
        all.strike_out_bad(sigma);
        all
    }

    /// Sensors have single bad lines, or two or three side by side, that differ from those next to them; what is
    /// wider or smoother is in the sky and stays.
    fn strike_out_bad(&mut self, sigma: f32) {
        let runs: Vec<Vec<usize>> = self.bad.chunk_by(|a, b| a + 1 == *b).map(<[usize]>::to_vec).collect();
        self.bad.clear();
        for run in runs {
            let beside = |n: Option<usize>| n.and_then(|n| self.offset.get(n)).map_or(0.0, |offset| offset.abs());
            let (first, last) = (run[0], run[run.len() - 1]);
            let around = beside(first.checked_sub(1)).max(beside(Some(last + 1))).max(sigma);
            let stands_out = run.iter().all(|n| self.offset[*n].abs() > STANDS_OUT * around);
            let is_bad = run.len() <= WIDEST_RUN && stands_out;
            for line in &run {
                self.offset[*line] = if is_bad { f32::NAN } else { 0.0 };
                self.is_band[*line] = is_bad;
            }
            if is_bad {
                self.bad.extend(run);
            }
        }
    }

    /// An offset of the whole image would be seen, and taken out, twice.
    fn leave_mean_to_rows(&mut self) {
        let mut known: Vec<f32> = self.offset.iter().copied().filter(|offset| offset.is_finite()).collect();
        let mean = median_in_place(&mut known).unwrap_or(0.0);
        self.offset.iter_mut().for_each(|offset| *offset -= mean);
    }

    /// The offsets, or zeros when none is more than chance.
    fn worth_correcting(self) -> Vec<f32> {
        if self.found() { self.offset } else { vec![0.0; self.offset.len()] }
    }

    /// Whether an offset is more than chance. If none is, correcting would only add noise.
    fn found(&self) -> bool {
        let mut lines = self.offset.iter().zip(&self.is_band);
        lines.any(|(offset, is_band)| offset.is_nan() || (*is_band && offset.abs() > self.limit))
    }
}

/// Mean of the clamped pixels, in sigma, of each segment of each row, and of each column.
pub(crate) struct BandingMeans {
    rows: Vec<[f32; SEGMENTS]>,
    columns: Vec<[f32; SEGMENTS]>,
}

/// The sums behind them, of a band of rows.
pub(crate) struct BandingSums {
    width: usize,
    height: usize,
    per_sigma: f32,
    rows: Vec<[f32; SEGMENTS]>,
    /// By segment of the columns' length, then by column.
    columns: Vec<f32>,
}

/// Where segment number `segment` begins.
fn bound(segment: usize, length: usize) -> usize {
    segment * length / SEGMENTS
}

impl BandingSums {
    /// Of no row yet, of an image whose noise is `sigma`.
    pub(crate) fn new(width: usize, height: usize, sigma: f32) -> Self {
        Self { width, height, per_sigma: 1.0 / sigma, rows: Vec::new(), columns: vec![0.0; SEGMENTS * width] }
    }

    /// Adds row `y`; called with one row of the band after the other.
    pub(crate) fn add(&mut self, y: usize, line: &[f32]) {
        let (width, height, per_sigma) = (self.width, self.height, self.per_sigma);
        // no branch for NaN, which counts as the mean: its bits are masked away
        let clamped = |pixel: f32| {
            let value = pixel * per_sigma;
            let value = if value > -CLAMP { value } else { -CLAMP };
            let value = if value < CLAMP { value } else { CLAMP };
            f32::from_bits(value.to_bits() & 0_u32.wrapping_sub(u32::from(!pixel.is_nan())))
        };
        let segment = (0..SEGMENTS).find(|s| y < bound(s + 1, height)).unwrap_or(SEGMENTS - 1);
        let columns = &mut self.columns[segment * width..(segment + 1) * width];
        self.rows.push(std::array::from_fn(|s| {
            let range = bound(s, width)..bound(s + 1, width);
            let (pixels, rest) = line[range.clone()].as_chunks::<8>();
            let (columns, columns_rest) = columns[range.clone()].as_chunks_mut::<8>();
            // eight running sums, so that the additions need not wait for one another
            let mut sums = [0.0; 8];
            for (columns, pixels) in columns.iter_mut().zip(pixels) {
                for lane in 0..8 {
                    let value = clamped(pixels[lane]);
                    columns[lane] += value;
                    sums[lane] += value;
                }
            }
            let mut sum = 0.0;
            for (column, pixel) in columns_rest.iter_mut().zip(rest) {
                *column += clamped(*pixel);
                sum += clamped(*pixel);
            }
            (sums.iter().sum::<f32>() + sum) / range.len().max(1) as f32
        }));
    }

    /// The means of all bands, given from the first row to the last.
    pub(crate) fn means(bands: Vec<Self>, width: usize, height: usize) -> BandingMeans {
        let mut means = BandingMeans { rows: Vec::with_capacity(height), columns: vec![[0.0; SEGMENTS]; width] };
        for band in bands {
            means.rows.extend(band.rows);
            for (segment, sums) in band.columns.chunks(width).enumerate() {
                let pixels = (bound(segment + 1, height) - bound(segment, height)).max(1) as f32;
                means.columns.iter_mut().zip(sums).for_each(|(column, sum)| column[segment] += sum / pixels);
            }
        }
        means
    }
}

fn measure(image: &[f32], width: usize, sigma: f32) -> BandingMeans {
    let height = image.len() / width;
    let bands = parallel::ranges(height, width, |band| {
        let mut sums = BandingSums::new(width, height, sigma);
        band.for_each(|y| sums.add(y, &image[y * width..(y + 1) * width]));
        sums
    });
    BandingSums::means(bands, width, height)
}

#[cfg(test)]
mod tests {
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn noise(width: usize, height: usize, seed: u64) -> Vec<f32> {
        let mut rng = StdRng::seed_from_u64(seed);
        (0..width * height).map(|_| 4.0 * Distribution::<f32>::sample(&StandardNormal, &mut rng)).collect()
    }

    fn remove(image: &mut [f32], width: usize, sigma: f32) -> Banding {
        let means = measure(image, width, sigma);
        super::remove(image, width, sigma, means)
    }

    fn rms(image: &[f32]) -> f32 {
        (image.iter().filter(|p| p.is_finite()).map(|p| p * p).sum::<f32>() / image.len() as f32).sqrt()
    }

    #[test]
    fn white_noise_is_left_alone() {
        for seed in 0..20 {
            let before = noise(512, 300, seed);
            let mut after = before.clone();
            assert_eq!(remove(&mut after, 512, 4.0), Banding::default(), "seed {seed}");
            assert!(before == after);
        }
    }

    #[test]
    fn bands_of_rows_and_columns_are_taken_out() {
        let mut image = noise(512, 512, 1);
        for (n, pixel) in image.iter_mut().enumerate() {
            let (x, y) = (n % 512, n / 512);
            *pixel += if y / 40 % 2 == 0 { 3.0 } else { -3.0 } + if x % 7 == 0 { 14.0 } else { 0.0 };
        }
        assert!(rms(&image) > 5.5);
        let banding = remove(&mut image, 512, 4.0);
        assert!(banding.removed && banding.bad_columns.is_empty() && banding.bad_rows.is_empty(), "{banding:?}");
        assert!((rms(&image) / 4.0 - 1.0).abs() < 0.01, "{}", rms(&image));
    }

    #[test]
    fn a_large_halo_is_no_band() {
        let mut image = noise(1024, 1024, 2);
        for (n, pixel) in image.iter_mut().enumerate() {
            let (x, y) = ((n % 1024) as f32 - 400.0, (n / 1024) as f32 - 700.0);
            *pixel += 300.0 * (-x.hypot(y) / 20.0).exp();
        }
        let before = image.clone();
        remove(&mut image, 1024, 4.0);
        let moved = image.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(moved < 0.4 * 4.0, "{moved}");
    }

    #[test]
    fn dead_and_hot_lines_become_missing() {
        let mut image = noise(300, 400, 3);
        for y in 0..400 {
            image[y * 300 + 50] = -200.0;
            image[y * 300 + 51] = -200.0;
            image[y * 300 + 222] = 900.0 + 70.0 * image[y * 300 + 222];
        }
        image[100 * 300..101 * 300].fill(-200.0);
        let banding = remove(&mut image, 300, 4.0);
        assert_eq!((banding.bad_columns, banding.bad_rows), (vec![50, 51, 222], vec![100]));
        assert!(image[7 * 300 + 51].is_nan() && image[100 * 300 + 9].is_nan());
        assert!(image[7 * 300 + 60].is_finite());
    }
}
