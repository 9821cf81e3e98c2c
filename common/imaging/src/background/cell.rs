//! Clipped median and MAD of one cell, from a histogram around a first guess.
//!
//! A sample of some 250 pixels gives median and MAD; a histogram of 1/12 sigma bins over +-8 sigma then holds the
//! whole cell, and all clipping passes run on its cumulative counts. Raw counts are taken as evenly spread over
//! their digitisation step, so that the median of a quiet camera is not rounded to whole ADU.

/// 1.4826 MAD is the standard deviation of a Gaussian.
const MAD_TO_SIGMA: f32 = 1.482_602_2;
/// Pixels in the first sample.
const SAMPLE: usize = 251;
/// Bins on either side of the middle, and per sigma.
const HALF: usize = 96;
const BINS: usize = 2 * HALF;
const BINS_PER_SIGMA: f32 = 12.0;
/// Two cells whose levels are nearer than this, in sigma, and whose noises differ by no more, are alike enough that the
/// bins of one hold the other: they reach over 8 sigma, and clipping needs 3.
const ALIKE_SIGMA: f32 = 1.5;
const ALIKE_NOISE: std::ops::Range<f32> = 0.7..1.4;
/// Cells with less than so many times the least noise there can be are not handed on: in a constant image the levels of
/// neighbours would differ by their rounding, which is all the noise it has.
const NOISY: f32 = 3.0;
/// Pixels whose bins are found together.
const PART: usize = 64;
/// Clipping at 3 sigma, at most 5 times (the predecessor's numbers).
const CLIP_SIGMA: f32 = 3.0;
const CLIP_PASSES: usize = 5;
/// Share of a Gaussian below +1 sigma.
const UP_TO_SIGMA: f32 = 0.841_345;
/// With more than this share of the pixels at one value the camera has cut off what lies below it.
const CUT_OFF: f32 = 0.35;
/// Variance of rounding to whole steps is step^2 / 12: no digitised noise is smaller.
const ROUNDING: f32 = 0.288_675_13;

/// Sky of a cell, ADU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SkyLevel {
    pub(super) level: f32,
    pub(super) noise: f32,
}

/// Memory used again for each cell.
pub(super) struct Scratch {
    sample: Vec<f32>,
    /// What lies below the bins, the bins, what lies above; 256 so that no index can be out of bounds.
    counts: [[u32; 256]; 2],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { sample: Vec::with_capacity(2 * SAMPLE), counts: [[0; 256]; 2] }
    }
}

impl Scratch {
    /// Level and noise of the pixels in `lines`; None when fewer than half of them are finite and within 3 sigma.
    /// The cell next to this one, if it is known, saves the sample where the bins that fit it fit this one too.
    pub(super) fn measure<'a>(
        &mut self,
        lines: impl Iterator<Item = &'a [f32]> + Clone,
        quantum: f32,
        neighbour: Option<SkyLevel>,
    ) -> Option<SkyLevel> {
        let total: usize = lines.clone().map(<[f32]>::len).sum();
        if let Some(neighbour) = neighbour.filter(|sky| sky.noise > NOISY * least_noise(sky.level, quantum))
            && let Some(sky) = self.measure_with(lines.clone(), total, quantum, (neighbour.level, neighbour.noise))
            && (sky.level - neighbour.level).abs() < ALIKE_SIGMA * neighbour.noise
            && ALIKE_NOISE.contains(&(sky.noise / neighbour.noise))
        {
            return Some(sky);
        }
        let guess = self.guess(lines.clone(), total)?;
        self.measure_with(lines, total, quantum, guess)
    }

    /// Level and noise from bins around a guess of them.
    fn measure_with<'a>(
        &mut self,
        lines: impl Iterator<Item = &'a [f32]>,
        total: usize,
        quantum: f32,
        (middle, sigma): (f32, f32),
    ) -> Option<SkyLevel> {
        let bins = Bins::around(middle, sigma, quantum);
        self.counts.fill([0; 256]);
        let [even, odd] = &mut self.counts;
        for line in lines {
            for part in line.chunks(PART) {
                // places first, in vector registers; then the counting
                let mut places = [0_u32; PART];
                places.iter_mut().zip(part).for_each(|(place, value)| *place = bins.place(*value));
                // in turn into two tables: neighbours often share a bin, and need not wait for one another
                let (pairs, last) = places[..part.len()].as_chunks::<2>();
                for [first, second] in pairs {
                    even[(first & 0xFF) as usize] += 1;
                    odd[(second & 0xFF) as usize] += 1;
                }
                last.iter().for_each(|place| even[(place & 0xFF) as usize] += 1);
            }
        }
        let counts = even[1..=BINS].iter().zip(&odd[1..=BINS]).map(|(even, odd)| even + odd);
        let mut cumulative = [0.0; BINS + 1];
        let mut sum = 0;
        for (bin, count) in counts.enumerate() {
            sum += count;
            cumulative[bin + 1] = sum as f32;
        }
        let (level, noise, stored) = clip(&cumulative);
        let floor = least_noise(middle, quantum);
        // spreading a bin's pixels over its width has added that width's variance
        let noise = (noise * noise - ROUNDING * ROUNDING).max(0.0).sqrt();
        (stored * 2.0 >= total as f32)
            .then(|| SkyLevel { level: bins.low + level * bins.width, noise: (noise * bins.width).max(floor) })
    }

    /// Median and sigma of a sample that is spread over the cell; None without finite pixels.
    fn guess<'a>(&mut self, lines: impl Iterator<Item = &'a [f32]>, total: usize) -> Option<(f32, f32)> {
        // an odd stride does not keep hitting the same columns
        let stride = (total / SAMPLE) | 1;
        self.sample.clear();
        let mut skip = 0;
        for line in lines {
            self.sample.extend(line.iter().skip(skip).step_by(stride).filter(|value| value.is_finite()));
            let after = if line.len() > skip { (line.len() - skip).div_ceil(stride) * stride + skip } else { skip };
            skip = after - line.len();
        }
        let middle = median_in_place(&mut self.sample)?;
        let least = self.sample.iter().copied().fold(f32::INFINITY, f32::min);
        let lowest = self.sample.iter().filter(|value| **value == least).count() as f32 / self.sample.len() as f32;
        let rank = ((UP_TO_SIGMA * self.sample.len() as f32) as usize).min(self.sample.len() - 1);
        // where many pixels share the lowest value, the spread is that of the others
        let cut_off = lowest > 0.7 * CUT_OFF;
        let above = cut_off.then(|| *self.sample.select_nth_unstable_by(rank, f32::total_cmp).1 - middle);
        self.sample.iter_mut().for_each(|value| *value = (*value - middle).abs());
        let sigma = MAD_TO_SIGMA * median_in_place(&mut self.sample)?;
        Some((middle, above.map_or(sigma, |above| sigma.max(above))))
    }
}

/// No digitised noise is smaller, nor any that f32 resolves, ADU.
fn least_noise(level: f32, quantum: f32) -> f32 {
    (ROUNDING * quantum).max(level_step(level))
}

/// Smallest step that f32 resolves near a level, with room for sums.
fn level_step(level: f32) -> f32 {
    (level.abs() * 16.0 * f32::EPSILON).max(f32::MIN_POSITIVE)
}

struct Bins {
    low: f32,
    width: f32,
    per_width: f32,
}

impl Bins {
    fn around(middle: f32, sigma: f32, quantum: f32) -> Self {
        let wanted = sigma / BINS_PER_SIGMA;
        if quantum > 0.0 {
            // whole steps, with edges half way between two possible values
            let width = quantum * (wanted / quantum).round().max(1.0);
            let low = (middle / quantum).round() * quantum - 0.5 * quantum - HALF as f32 * width;
            Self { low, width, per_width: 1.0 / width }
        } else {
            let width = wanted.max(level_step(middle));
            Self { low: middle - HALF as f32 * width, width, per_width: 1.0 / width }
        }
    }

    /// 1 + the bin of a value; 0 for what lies below and for NaN, `BINS + 1` for what lies above.
    fn place(&self, value: f32) -> u32 {
        // adding 2^23 rounds to whole numbers, which then stand in the lowest bits
        const WHOLE: f32 = 8_388_608.0;
        let at = (value - self.low) * self.per_width + 0.5;
        let at = if at > 0.0 { at } else { 0.0 };
        let at = if at < (BINS + 1) as f32 { at } else { (BINS + 1) as f32 };
        (at + WHOLE).to_bits() & 0xFF
    }
}

/// Clipped median and sigma in bins, and the number of pixels that were kept. Where a camera without pedestal has
/// cut off the lower half of the noise, mean and standard deviation instead: stars stand on the mean.
fn clip(cumulative: &[f32; BINS + 1]) -> (f32, f32, f32) {
    let (mut low, mut high) = (0.0, BINS as f32);
    let (mut level, mut noise, mut stored) = (0.0, 0.0, f32::INFINITY);
    let mut is_cut_off = false;
    let fullest = cumulative.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f32::max);
    for _ in 0..CLIP_PASSES {
        let (below, up_to) = (count_below(cumulative, low), count_below(cumulative, high));
        if up_to - below >= stored || up_to <= below {
            break;
        }
        stored = up_to - below;
        level = quantile(cumulative, below + 0.5 * stored);
        noise = MAD_TO_SIGMA * deviation(cumulative, level, low, high, 0.5 * stored);
        let upper = quantile(cumulative, below + UP_TO_SIGMA * stored) - level;
        is_cut_off = upper > 2.0 && fullest > CUT_OFF * stored;
        if is_cut_off {
            noise = upper;
        }
        // a bin's width of room: nearly all pixels may share one value
        let reach = (CLIP_SIGMA * noise).max(1.0);
        (low, high) = ((level - reach).max(0.0), (level + reach).min(BINS as f32));
    }
    if is_cut_off {
        (level, noise) = mean_and_spread(cumulative, low, high);
    }
    (level, noise, if stored.is_finite() { stored } else { 0.0 })
}

fn mean_and_spread(cumulative: &[f32; BINS + 1], low: f32, high: f32) -> (f32, f32) {
    let bins = (low as usize)..(high.ceil() as usize).min(BINS);
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for bin in bins {
        let (count, at) = (cumulative[bin + 1] - cumulative[bin], bin as f32 + 0.5);
        n += count;
        sum += count * at;
        squares += count * at * at;
    }
    let mean = sum / f32::max(n, 1.0);
    (mean, (squares / f32::max(n, 1.0) - mean * mean).max(0.0).sqrt())
}

/// Pixels below a place in the histogram, pixels of a bin being spread evenly over it.
fn count_below(cumulative: &[f32; BINS + 1], at: f32) -> f32 {
    let bin = (at as usize).min(BINS - 1);
    cumulative[bin] + (at - bin as f32) * (cumulative[bin + 1] - cumulative[bin])
}

fn quantile(cumulative: &[f32; BINS + 1], wanted: f32) -> f32 {
    let bin = cumulative.partition_point(|count| *count <= wanted).clamp(1, BINS) - 1;
    let inside = cumulative[bin + 1] - cumulative[bin];
    bin as f32 + if inside > 0.0 { ((wanted - cumulative[bin]) / inside).clamp(0.0, 1.0) } else { 0.5 }
}

/// Distance from `level` within which `wanted` of the pixels between `low` and `high` lie: bisection.
fn deviation(cumulative: &[f32; BINS + 1], level: f32, low: f32, high: f32, wanted: f32) -> f32 {
    let (mut near, mut far) = (0.0, high - low);
    for _ in 0..20 {
        let reach = 0.5 * (near + far);
        let inside =
            count_below(cumulative, (level + reach).min(high)) - count_below(cumulative, (level - reach).max(low));
        if inside < wanted { near = reach } else { far = reach }
    }
    0.5 * (near + far)
}

/// Median by partial selection, which reorders the values; None when there are none. An even number of values
/// gives the upper of the two middle ones.
pub(crate) fn median_in_place(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
