//! A Gaussian of the stars' width, run over the image: where does a star stand out of the noise?
//!
//! Significance `S = (A * g) / (sigma sqrt(sum g^2))` is the signal-to-noise ratio of the best-fitting Gaussian of
//! that width (docs/formulae.md, "Matched filter"). The kernel is separable; the filtered image exists only as three
//! rows per thread. Where noise is correlated from pixel to pixel (mosaics, debayered frames), S scatters by more than
//! 1: its scatter is measured on the frame itself and divided out.

use crate::background::median_in_place;
use crate::clean::Clean;
use crate::parallel;

/// FWHM of a Gaussian in sigma.
pub(crate) const FWHM_PER_SIGMA: f32 = 2.354_82;
/// The kernel ends at this many sigma.
const REACH_SIGMA: f32 = 2.5;
/// Every n-th pixel of every n-th row shows the scatter of S.
const SAMPLE_STEP: usize = 8;

/// Wide kernels are run over sums of 2 x 2 or 4 x 4 px, in which they are at least so wide: that loses less than 1 % of S,
/// and each maximum is looked at in the whole frame again.
const LEAST_SUMMED_PX: f32 = 5.0;
/// Sums along the shorter side at least.
const LEAST_SUMS: usize = 64;

/// Rows for which the noise is evaluated once: an eighth of a cell of the mesh at most.
const NOISE_ROWS: usize = 4;

/// A sampled Gaussian of peak 1.
#[derive(Debug, Clone)]
pub(crate) struct Kernel {
    pub(crate) fwhm_px: f32,
    /// Values at distance 0, 1, 2 ... px along one axis.
    taps: Vec<f32>,
    /// Square root of the sum over all pixels of the squared kernel.
    norm: f32,
}

/// A local maximum of the significance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    /// Highest pixel.
    pub(crate) x: usize,
    pub(crate) y: usize,
    /// How far from its centre the maximum lies, px.
    pub(crate) offset: (f32, f32),
    pub(crate) significance: f32,
}

/// All maxima above a threshold, the most significant first.
#[derive(Debug, Clone)]
pub(crate) struct Peaks {
    pub(crate) peaks: Vec<Peak>,
    /// Scatter of S over the frame, at least 1; already divided out of the peaks.
    pub(crate) scatter: f32,
}

impl Kernel {
    pub(crate) fn new(fwhm_px: f32) -> Self {
        let sigma = fwhm_px / FWHM_PER_SIGMA;
        let reach = (REACH_SIGMA * sigma).round().max(1.0) as usize;
        let taps: Vec<f32> = (0..=reach).map(|d| (-0.5 * (d as f32 / sigma).powi(2)).exp()).collect();
        let norm = taps[0].powi(2) + 2.0 * taps[1..].iter().map(|t| t * t).sum::<f32>();
        Self { fwhm_px, taps, norm }
    }

    /// Share of a star's significance that is left at the pixel's centre when the star stands on its corner: for
    /// stars as wide as the kernel S falls with distance as `exp(-d^2 / 4 sigma^2)`.
    pub(crate) fn sampling_loss(&self) -> f32 {
        (-0.5 / self.fall()).exp()
    }

    /// `4 sigma^2`, px^2.
    fn fall(&self) -> f32 {
        (2.0 * self.fwhm_px / FWHM_PER_SIGMA).powi(2)
    }

    /// How far from the highest pixel (significance `here`) the maximum lies, px, from the pixels before and after.
    fn offset(&self, here: f32, before: f32, after: f32) -> f32 {
        let fall = self.fall();
        let offset = 0.25 * fall * (1.0 / fall).exp() * (after - before) / here;
        if offset.is_finite() { offset.clamp(-0.5, 0.5) } else { 0.0 }
    }

    /// Significance of a Gaussian whose middle lies (dx, dy) px off a pixel's centre.
    fn significance_beside(&self, clean: &Clean, x: usize, y: usize, dx: f32, dy: f32) -> f32 {
        let (reach, per_sigma) = (self.reach(), FWHM_PER_SIGMA / self.fwhm_px);
        let taps = |offset: f32| -> Vec<f32> {
            let at = (0..=2 * reach).map(|n| n as f32 - reach as f32 - offset);
            at.map(|d| (-0.5 * (d * per_sigma).powi(2)).exp()).collect()
        };
        let (along_x, along_y) = (taps(dx), taps(dy));
        let squared = |taps: &[f32]| taps.iter().map(|tap| tap * tap).sum::<f32>();
        let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(clean.width));
        let mut sum = 0.0;
        for row in y.saturating_sub(reach)..(y + reach + 1).min(clean.height) {
            let line = &clean.pixels[row * clean.width + left..row * clean.width + right];
            let taps = &along_x[left + reach - x..];
            sum += along_y[row + reach - y] * line.iter().zip(taps).map(|(pixel, tap)| pixel * tap).sum::<f32>();
        }
        sum / (clean.background.noise.at(x, y) * (squared(&along_x) * squared(&along_y)).sqrt())
    }

    /// Half width, px.
    pub(crate) fn reach(&self) -> usize {
        self.taps.len() - 1
    }

    /// Significance at one pixel, without the frame's scatter.
    pub(crate) fn significance(&self, clean: &Clean, x: usize, y: usize) -> f32 {
        let reach = self.reach();
        let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(clean.width));
        let mut sum = 0.0;
        for row in y.saturating_sub(reach)..(y + reach + 1).min(clean.height) {
            let line = &clean.pixels[row * clean.width + left..row * clean.width + right];
            let along: f32 = line.iter().enumerate().map(|(n, pixel)| pixel * self.taps[(left + n).abs_diff(x)]).sum();
            sum += along * self.taps[row.abs_diff(y)];
        }
        sum / (clean.background.noise.at(x, y) * self.norm)
    }

    /// Local maxima of the significance above `threshold`, each at its height between the pixels.
    pub(crate) fn peaks(&self, clean: &Clean, threshold: f32) -> Peaks {
        let plane = Plane::of(clean, self.fwhm_px);
        let (by, coarse) = (plane.by, Self::new(self.fwhm_px / plane.by as f32));
        let sample_step = SAMPLE_STEP / by;
        // a place in the sums, as the nearest pixel and how far from its centre
        let whole = |at: usize, offset: f32, length: usize| {
            if by == 1 {
                return (at, offset);
            }
            let place = by as f32 * (at as f32 + offset) + 0.5 * (by as f32 - 1.0);
            let pixel = (place.round().max(0.0) as usize).min(length - 1);
            (pixel, place - pixel as f32)
        };
        let bands = parallel::ranges(plane.height, plane.width * by * by, |rows| {
            let mut filter = Rows::new(&coarse, &plane, rows.start);
            let (mut peaks, mut sample) = (Vec::new(), Vec::<f32>::new());
            for y in rows {
                filter.advance(y);
                let [above, here, below] = &filter.significance;
                local_maxima(above, here, below, threshold * coarse.sampling_loss(), |x| {
                    let dx = coarse.offset(here[x], at(here, x.wrapping_sub(1)), at(here, x + 1));
                    let dy = coarse.offset(here[x], above[x], below[x]);
                    let ((x, dx), (y, dy), here) = (whole(x, dx, clean.width), whole(y, dy, clean.height), here[x]);
                    let beside = self.significance_beside(clean, x, y, dx, dy);
                    let significance = if by == 1 { beside.max(here) } else { beside };
                    peaks.push(Peak { x, y, offset: (dx, dy), significance });
                });
                if y % sample_step == sample_step / 2 {
                    sample.extend(here.iter().skip(sample_step / 2).step_by(sample_step));
                }
            }
            (peaks, sample)
        });
        let (mut peaks, mut sample): (Vec<Peak>, Vec<f32>) = (Vec::new(), Vec::new());
        for (band_peaks, band_sample) in bands {
            peaks.extend(band_peaks);
            sample.extend(band_sample);
        }
        let scatter = lower_scatter(&mut sample).max(1.0);
        peaks.iter_mut().for_each(|peak| peak.significance /= scatter);
        peaks.retain(|peak| peak.significance > threshold);
        peaks.sort_unstable_by(|a, b| b.significance.total_cmp(&a.significance).then((a.y, a.x).cmp(&(b.y, b.x))));
        Peaks { peaks, scatter }
    }
}

/// Median less the 16th percentile, which stars do not reach: one sigma of a Gaussian. 0 when there are too few.
fn lower_scatter(sample: &mut [f32]) -> f32 {
    if sample.len() < 100 {
        return 0.0;
    }
    let rank = (0.158_655 * sample.len() as f64) as usize;
    let low = *sample.select_nth_unstable_by(rank, f32::total_cmp).1;
    median_in_place(sample).map_or(0.0, |median| median - low)
}

/// Significance at a column; lower than any outside of the image.
fn at(line: &[f32], x: usize) -> f32 {
    line.get(x).copied().unwrap_or(f32::NEG_INFINITY)
}

fn local_maxima(above: &[f32], here: &[f32], below: &[f32], threshold: f32, mut found: impl FnMut(usize)) {
    for (chunk, values) in here.chunks(64).enumerate() {
        if parallel::highest(values) <= threshold {
            continue;
        }
        for (n, value) in values.iter().enumerate().filter(|(_, value)| **value > threshold) {
            let x = 64 * chunk + n;
            let (left, right) = (x.wrapping_sub(1), x + 1);
            // of equal neighbours the first one is the maximum
            let later = [at(here, right), at(below, left), at(below, x), at(below, right)];
            let earlier = [at(here, left), at(above, left), at(above, x), at(above, right)];
            if later.iter().all(|other| value >= other) && earlier.iter().all(|other| value > other) {
                found(x);
            }
        }
    }
}

/// What the filter runs over: the frame, or sums of `by` x `by` of its pixels.
struct Plane<'a> {
    clean: &'a Clean,
    by: usize,
    width: usize,
    height: usize,
    sums: Option<Vec<f32>>,
}

impl<'a> Plane<'a> {
    fn of(clean: &'a Clean, fwhm_px: f32) -> Self {
        let shorter = clean.width.min(clean.height);
        let fits = |by: &usize| fwhm_px >= LEAST_SUMMED_PX * *by as f32 && shorter / by >= LEAST_SUMS;
        let by = [4, 2].into_iter().find(fits).unwrap_or(1);
        let (width, height) = (clean.width / by, clean.height / by);
        let sums = (by > 1).then(|| {
            let mut sums = vec![0.0; width * height];
            parallel::bands_mut(&mut sums, width, |first, band| {
                for (n, out) in band.chunks_mut(width).enumerate() {
                    let rows = clean.pixels.chunks(clean.width).skip(by * (first + n)).take(by);
                    for line in rows {
                        out.iter_mut()
                            .zip(line.chunks_exact(by))
                            .for_each(|(out, few)| *out += few.iter().sum::<f32>());
                    }
                }
            });
            sums
        });
        Self { clean, by, width, height, sums }
    }

    fn row(&self, y: usize) -> &[f32] {
        let pixels = self.sums.as_deref().unwrap_or(&self.clean.pixels);
        &pixels[y * self.width..(y + 1) * self.width]
    }

    /// Noise of each sum of a row.
    fn noise(&self, y: usize, out: &mut [f32]) {
        if self.by == 1 {
            return self.clean.background.noise.row(y, out);
        }
        let mut noise = vec![0.0; self.clean.width];
        self.clean.background.noise.row(y * self.by + self.by / 2, &mut noise);
        let middles = noise.iter().skip(self.by / 2).step_by(self.by);
        out.iter_mut().zip(middles).for_each(|(out, noise)| *out = self.by as f32 * noise);
    }
}

/// The filter as it moves down a band of rows.
struct Rows<'a> {
    kernel: &'a Kernel,
    plane: &'a Plane<'a>,
    /// Rows filtered along x, row `y` in place `y % (2 reach + 1)`.
    along_x: Vec<Vec<f32>>,
    /// First row that is not in `along_x` yet.
    next: usize,
    /// What lies outside of the image.
    zeros: Vec<f32>,
    /// 1 / (noise x norm of the kernel), and the row it was evaluated for.
    per_noise: Vec<f32>,
    per_noise_of: Option<usize>,
    /// Rows `y - 1`, `y`, `y + 1`.
    significance: [Vec<f32>; 3],
}

impl<'a> Rows<'a> {
    /// Ready to `advance` to row `first`.
    fn new(kernel: &'a Kernel, plane: &'a Plane<'a>, first: usize) -> Self {
        let (reach, width) = (kernel.reach(), plane.width);
        let mut rows = Self {
            kernel,
            plane,
            along_x: vec![vec![0.0; width]; 2 * reach + 1],
            next: first.saturating_sub(reach + 1),
            zeros: vec![0.0; width],
            per_noise: vec![0.0; width],
            per_noise_of: None,
            significance: std::array::from_fn(|_| vec![f32::NEG_INFINITY; width]),
        };
        for y in [first.wrapping_sub(1), first] {
            rows.push(y);
        }
        rows
    }

    /// Makes `y` the middle row; called with one row after the other.
    fn advance(&mut self, y: usize) {
        self.push(y + 1);
    }

    /// Moves the three rows up and filters row `y` into the last; a row outside of the image is lower than any.
    fn push(&mut self, y: usize) {
        self.significance.rotate_left(1);
        if y >= self.plane.height {
            self.significance[2].fill(f32::NEG_INFINITY);
            return;
        }
        let (reach, height) = (self.kernel.reach(), self.plane.height);
        while self.next <= (y + reach).min(height - 1) {
            self.filter_along_x(self.next);
            self.next += 1;
        }
        let row = |row: Option<usize>| row.map_or(&self.zeros[..], |row| &self.along_x[row % (2 * reach + 1)]);
        let taps = self.kernel.taps.iter().enumerate().skip(1);
        let pairs: Vec<TapLines> =
            taps.map(|(d, tap)| (*tap, row(y.checked_sub(d)), row((y + d < height).then_some(y + d)))).collect();
        let out = &mut self.significance[2];
        weigh(out, row(Some(y)), &pairs);
        // the noise hardly changes from row to row
        if self.per_noise_of.is_none_or(|of| y.abs_diff(of) >= NOISE_ROWS) {
            self.plane.noise(y, &mut self.per_noise);
            self.per_noise.iter_mut().for_each(|noise| *noise = 1.0 / (*noise * self.kernel.norm));
            self.per_noise_of = Some(y);
        }
        out.iter_mut().zip(&self.per_noise).for_each(|(out, per_noise)| *out *= per_noise);
    }

    fn filter_along_x(&mut self, y: usize) {
        let (reach, width) = (self.kernel.reach(), self.plane.width);
        let line = self.plane.row(y);
        let out = &mut self.along_x[y % (2 * reach + 1)];
        let inner = reach.min(width)..width.saturating_sub(reach).max(reach.min(width));
        let taps = || self.kernel.taps.iter().enumerate().skip(1);
        let at = |x: Option<usize>| x.and_then(|x| line.get(x)).copied().unwrap_or(0.0);
        for x in (0..inner.start).chain(inner.end..width) {
            let beside = taps().map(|(d, tap)| tap * (at(x.checked_sub(d)) + at(Some(x + d))));
            out[x] = line[x] + beside.sum::<f32>();
        }
        if !inner.is_empty() {
            let shifted = |from: usize| &line[from..from + inner.len()];
            let pairs: Vec<TapLines> = taps().map(|(d, tap)| (*tap, shifted(reach - d), shifted(reach + d))).collect();
            weigh(&mut out[inner.clone()], shifted(reach), &pairs);
        }
    }
}

/// A tap of the kernel and the two lines at its distance on either side.
type TapLines<'a> = (f32, &'a [f32], &'a [f32]);

/// `out = middle + sum of tap * (before + after)`; 16 sums at a time, which stay in vector registers.
fn weigh(out: &mut [f32], middle: &[f32], pairs: &[TapLines]) {
    const BLOCK: usize = 16;
    let length = out.len();
    let block = |line: &[f32], at: usize| -> [f32; BLOCK] {
        line.get(at..at + BLOCK).and_then(|line| line.try_into().ok()).unwrap_or([0.0; BLOCK])
    };
    let mut at = 0;
    while at + BLOCK <= length {
        let mut sums = block(middle, at);
        for (tap, before, after) in pairs {
            let (before, after) = (block(before, at), block(after, at));
            for lane in 0..BLOCK {
                sums[lane] += tap * (before[lane] + after[lane]);
            }
        }
        out[at..at + BLOCK].copy_from_slice(&sums);
        at += BLOCK;
    }
    for at in at..length {
        out[at] = middle[at] + pairs.iter().map(|(tap, before, after)| tap * (before[at] + after[at])).sum::<f32>();
    }
}

#[cfg(test)]
mod tests;
