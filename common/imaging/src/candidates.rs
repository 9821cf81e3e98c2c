//! Which maxima of the matched filter are objects of their own?
//!
//! Noise makes maxima on the wings of a bright star, along a trail and on the plateau of a defocused disc. From the
//! brightest down, a maximum is kept when no kept one lies within 1 FWHM, when a valley
//! parts it from brighter neighbours, and when it stands out of its own surroundings too: fitted together with a
//! constant, a Gaussian must have a significant height above the scatter found there.

use crate::clean::Clean;
use crate::grid::Grid;
use crate::matched_filter::{FWHM_PER_SIGMA, Kernel, Peak, Peaks};
use crate::parallel;

/// Height of the fitted Gaussian over its error that is asked for. Fitting a constant too costs a quarter of the
/// signal: a star of significance 5 comes out at 3.7 on the average.
const LOCAL_SIGNIFICANCE: f32 = 2.5;
/// Neighbours within this many FWHM must be parted by a valley ...
const VALLEY_REACH: f32 = 3.0;
/// ... this deep: in units of significance, and as a share of the fainter one's.
const VALLEY: (f32, f32) = (2.5, 0.03);
/// More maxima than this are not looked at, the least significant being dropped.
const MOST: usize = 200_000;

/// The objects among the peaks, the most significant first. `is_saturated` marks flat tops, which have no height
/// of their own.
pub(crate) fn objects(
    clean: &Clean,
    kernel: &Kernel,
    peaks: &Peaks,
    is_saturated: impl Fn(&Peak) -> bool + Sync,
) -> Vec<Peak> {
    let peaks = &peaks.peaks[..peaks.peaks.len().min(MOST)];
    let stands_out = parallel::ranges(peaks.len(), 512, |range| {
        let stands_out = |peak| local_significance(clean, kernel, peak) >= LOCAL_SIGNIFICANCE || is_saturated(peak);
        peaks[range].iter().map(stands_out).collect::<Vec<bool>>()
    });
    let reach = VALLEY_REACH * kernel.fwhm_px;
    let mut grid = Grid::new(clean.width, clean.height, reach);
    let mut objects: Vec<Peak> = Vec::new();
    for (peak, _) in peaks.iter().zip(stands_out.into_iter().flatten()).filter(|(_, stands_out)| *stands_out) {
        let (x, y) = (peak.x as f32, peak.y as f32);
        let joined = grid.near(x, y, reach).any(|n| {
            let brighter = &objects[n];
            let apart = (brighter.x as f32 - x).hypot(brighter.y as f32 - y);
            apart <= kernel.fwhm_px || !has_valley(clean, kernel, peak, brighter)
        });
        if !joined {
            grid.add(x, y);
            objects.push(*peak);
        }
    }
    objects
}

/// Whether the significance falls between a peak and a brighter one.
fn has_valley(clean: &Clean, kernel: &Kernel, peak: &Peak, brighter: &Peak) -> bool {
    let here = kernel.significance(clean, peak.x, peak.y);
    let floor = here - VALLEY.0 - VALLEY.1 * here;
    let between = |from: usize, to: usize, step: f32| (from as f32 + step * (to as f32 - from as f32)).round() as usize;
    // the valley lies nearer to the fainter one
    [0.2, 0.35, 0.5, 0.65].iter().any(|step| {
        let (x, y) = (between(peak.x, brighter.x, *step), between(peak.y, brighter.y, *step));
        kernel.significance(clean, x, y) < floor
    })
}

/// Height over its error of a Gaussian that is fitted together with a constant, within 3 sigma of its middle.
fn local_significance(clean: &Clean, kernel: &Kernel, peak: &Peak) -> f32 {
    let radius = (3.0 * kernel.fwhm_px / FWHM_PER_SIGMA).max(2.0);
    let reach = radius as usize;
    let sigma = kernel.fwhm_px / FWHM_PER_SIGMA;
    // distances from the maximum, not from the pixel's centre: of a narrow star that is a great difference
    let profile = |offset: f32| -> Vec<f32> {
        (0..=2 * reach).map(|n| (-0.5 * ((n as f32 - reach as f32 - offset) / sigma).powi(2)).exp()).collect()
    };
    let (along_x, along_y) = (profile(peak.offset.0), profile(peak.offset.1));
    let (mut n, mut g, mut gg, mut a, mut ga, mut aa) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for y in peak.y.saturating_sub(reach)..(peak.y + reach + 1).min(clean.height) {
        let dy = y.abs_diff(peak.y);
        for x in peak.x.saturating_sub(reach)..(peak.x + reach + 1).min(clean.width) {
            let dx = x.abs_diff(peak.x);
            if ((dx * dx + dy * dy) as f32) <= radius * radius {
                let (gauss, pixel) =
                    (along_x[x + reach - peak.x] * along_y[y + reach - peak.y], clean.pixels[y * clean.width + x]);
                n += 1.0;
                g += gauss;
                gg += gauss * gauss;
                a += pixel;
                ga += gauss * pixel;
                aa += pixel * pixel;
            }
        }
    }
    let spread = gg - g * g / n;
    if n < 6.0 || spread <= 0.0 {
        return 0.0;
    }
    let height = (ga - g * a / n) / spread;
    let residual = (aa - a * a / n - height * height * spread).max(0.0) / (n - 2.0);
    // the scatter of a few pixels is itself uncertain: it counts when it is surely more than the sky's noise
    let sure = 1.0 - 1.5 / (2.0 * (n - 2.0)).sqrt();
    let noise = clean.background.noise.at(peak.x, peak.y).max(sure * residual.sqrt());
    height * spread.sqrt() / noise
}
