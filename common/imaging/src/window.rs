//! Place, flux and shape of one star, seen through a Gaussian window.
//!
//! The window moves until the weighted first moment vanishes. Each step divides by the slope of that moment, which for
//! a window as wide as the star is half the weighted flux: the factor 2 of SExtractor's `XWIN` (docs/formulae.md,
//! "Windowed centroid"). The errors carry the noise of each pixel, sky and photons, through the same sums. Second
//! moments `M` under a window `W` belong to a Gaussian of covariance `C = (M^-1 - W^-1)^-1`.

use crate::clean::Clean;
use crate::matched_filter::FWHM_PER_SIGMA;

const STEPS: usize = 10;
/// Converged when a step is shorter, px.
const CLOSE_PX: f64 = 1e-3;
/// Pixels beyond this many sigma of the window weigh nothing.
const REACH_SIGMA: f64 = 3.0;
/// A window narrower than this is not sampled well enough by pixels, px.
const NARROWEST_SIGMA_PX: f64 = 1.0;
/// Systematic error of a centroid, px: pixel phase, flat field.
const FLOOR_PX: f64 = 0.01;
/// Moments above this share of the window's are cut off by it.
const WIDEST: f64 = 0.9;

/// How pixels are weighed and what noise they have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    sigma: f64,
    gain: f64,
}

/// What the window showed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WindowMoments {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Standard errors of x and y, px.
    pub(crate) error: (f64, f64),
    /// Weighted flux and its standard error, ADU.
    pub(crate) flux: f64,
    pub(crate) flux_error: f64,
    /// Variance along the longer and the shorter axis, px^2.
    pub(crate) major: f64,
    pub(crate) minor: f64,
    /// Standard error of the mean variance, px^2.
    pub(crate) variance_error: f64,
    /// Position angle of the longer axis from +x towards +y, rad, -pi/2 to pi/2.
    pub(crate) angle: f64,
    /// Whether the frame's edge cuts the window.
    pub(crate) cut: bool,
}

impl WindowMoments {
    /// FWHM of the Gaussian with the mean (geometric) width, px.
    pub(crate) fn fwhm(&self) -> f64 {
        f64::from(FWHM_PER_SIGMA) * (self.major * self.minor).max(0.0).powf(0.25)
    }

    pub(crate) fn variance(&self) -> f64 {
        (self.major * self.minor).max(0.0).sqrt()
    }

    pub(crate) fn axis_ratio(&self) -> f64 {
        if self.minor > 0.0 { (self.major / self.minor).sqrt() } else { 1.0 }
    }
}

#[derive(Default)]
struct MomentSums {
    flux: f64,
    flux_variance: f64,
    x: f64,
    y: f64,
    x_variance: f64,
    y_variance: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    spread_variance: f64,
}

impl Window {
    /// A window for stars of this width.
    pub(crate) fn new(fwhm_px: f64, gain_e_per_adu: f32) -> Self {
        let sigma = (fwhm_px / f64::from(FWHM_PER_SIGMA)).max(NARROWEST_SIGMA_PX);
        Self { sigma, gain: f64::from(gain_e_per_adu.max(f32::MIN_POSITIVE)) }
    }

    /// Standard deviation of the window, px.
    pub(crate) fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Looks for a star near a place. None when it runs away by more than `reach` px, or has no flux.
    pub(crate) fn look(&self, clean: &Clean, near: (f64, f64), reach: f64) -> Option<WindowMoments> {
        let (mut x, mut y) = near;
        let noise = f64::from(clean.background.noise.at(near.0.round() as usize, near.1.round() as usize));
        let mut sums = self.sums(clean, x, y, noise);
        for _ in 0..STEPS {
            let (step_x, step_y) = self.step(&sums)?;
            (x, y) = (x + step_x, y + step_y);
            let moved = (x - near.0).hypot(y - near.1);
            if moved.is_nan() || moved > reach {
                return None;
            }
            sums = self.sums(clean, x, y, noise);
            if step_x.hypot(step_y) < CLOSE_PX {
                break;
            }
        }
        self.seen(clean, x, y, &sums)
    }

    /// The way to the place where the first moments vanish.
    fn step(&self, sums: &MomentSums) -> Option<(f64, f64)> {
        let (slope_x, slope_y) = self.slopes(sums)?;
        // longer steps than a window are a sign of noise
        Some(((sums.x / slope_x).clamp(-self.sigma, self.sigma), (sums.y / slope_y).clamp(-self.sigma, self.sigma)))
    }

    fn slopes(&self, sums: &MomentSums) -> Option<(f64, f64)> {
        // between a point (1) and something as wide as the window (near 0)
        let slope = |moment: f64| sums.flux - (moment / self.sigma.powi(2)).clamp(0.0, 0.8 * sums.flux);
        (sums.flux > 0.0).then(|| (slope(sums.xx), slope(sums.yy)))
    }

    fn sums(&self, clean: &Clean, x: f64, y: f64, noise: f64) -> MomentSums {
        let reach = REACH_SIGMA * self.sigma;
        let range = |at: f64, length: usize| {
            let first = (at - reach).ceil().max(0.0) as usize;
            let end = ((at + reach).floor() + 1.0).max(0.0) as usize;
            first.min(length)..end.min(length)
        };
        let (columns, rows) = (range(x, clean.width), range(y, clean.height));
        let weight = |d: f64| (-0.5 * (d / self.sigma).powi(2)).exp();
        let along_x: Vec<[f64; 3]> = columns
            .clone()
            .map(|c| c as f64 - x)
            .map(|d| (d * d, d, weight(d)))
            .map(|(d2, d, weight)| [weight, weight * d, weight * d2])
            .collect();
        let (sky, per_gain, squared) = (noise * noise, 1.0 / self.gain, self.sigma.powi(2));
        let mut sums = MomentSums::default();
        for row in rows {
            let line = &clean.pixels[row * clean.width + columns.start..row * clean.width + columns.end];
            // first along the row, then as a whole: what belongs to y is the same for all its pixels
            let (mut light, mut light_x, mut light_xx) = (0.0, 0.0, 0.0);
            let (mut variance, mut variance_xx, mut variance_x4) = (0.0, 0.0, 0.0);
            for ([weight, weight_x, weight_xx], pixel) in along_x.iter().zip(line) {
                let value = f64::from(*pixel);
                let squared_noise = sky + per_gain * value.max(0.0);
                light += weight * value;
                light_x += weight_x * value;
                light_xx += weight_xx * value;
                variance += weight * weight * squared_noise;
                variance_xx += weight_x * weight_x * squared_noise;
                variance_x4 += weight_xx * weight_xx * squared_noise;
            }
            let dy = row as f64 - y;
            let (weight, dy2) = (weight(dy), dy * dy);
            let twice = weight * weight;
            sums.flux += weight * light;
            sums.flux_variance += twice * variance;
            sums.x += weight * light_x;
            sums.y += weight * light * dy;
            sums.x_variance += twice * variance_xx;
            sums.y_variance += twice * variance * dy2;
            sums.xx += weight * light_xx;
            sums.xy += weight * light_x * dy;
            sums.yy += weight * light * dy2;
            // of (dx^2 + dy^2 - sigma^2) / 2
            let rest = dy2 - squared;
            sums.spread_variance += 0.25 * twice * (variance_x4 + 2.0 * rest * variance_xx + rest * rest * variance);
        }
        sums
    }

    fn seen(&self, clean: &Clean, x: f64, y: f64, sums: &MomentSums) -> Option<WindowMoments> {
        let (slope_x, slope_y) = self.slopes(sums)?;
        let error = |variance: f64, slope: f64| (variance / slope.powi(2) + FLOOR_PX.powi(2)).sqrt();
        let (xx, xy, yy) = (sums.xx / sums.flux, sums.xy / sums.flux, sums.yy / sums.flux);
        // eigenvalues of the moments; then the window is taken out of each
        let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let squared = self.sigma.powi(2);
        let without_window = |moment: f64| {
            let moment = moment.clamp(0.0, WIDEST * squared);
            moment / (1.0 - moment / squared)
        };
        let stretch = without_window(mean) / mean.max(f64::MIN_POSITIVE);
        let reach = REACH_SIGMA * self.sigma;
        let inside = |at: f64, length: usize| at >= reach && at + reach <= (length - 1) as f64;
        Some(WindowMoments {
            x,
            y,
            error: (error(sums.x_variance, slope_x), error(sums.y_variance, slope_y)),
            flux: sums.flux,
            flux_error: sums.flux_variance.sqrt(),
            major: without_window(mean + half),
            minor: without_window(mean - half),
            variance_error: stretch.powi(2) * sums.spread_variance.sqrt() / sums.flux,
            angle: 0.5 * (2.0 * xy).atan2(xx - yy),
            cut: !(inside(x, clean.width) && inside(y, clean.height)),
        })
    }
}
