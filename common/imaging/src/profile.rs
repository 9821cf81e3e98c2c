//! The mean radial profile of a frame's stars, and the Moffat function through it.
//!
//! Moments under a Gaussian window show the width of a Gaussian; real stars have wings. The stacked profile of the
//! best stars, fitted with `(1 + r^2 / alpha^2)^-beta` (Moffat 1969, A&A 3, 455), gives the true width at half
//! maximum and the share of the flux that the window sees. The width is that of the image: seeing, optics, guiding
//! and the square of the pixel together.

use crate::clean::Clean;

/// Bins of the profile, and bins per FWHM.
const BINS: usize = 40;
const BINS_PER_FWHM: f64 = 10.0;
/// A bin with fewer pixels does not count.
const FEWEST: usize = 3;
/// Of wide stars every n-th pixel of every n-th row is enough: so many along the width.
const SAMPLES_PER_FWHM: f64 = 8.0;
/// From strong wings to nearly a Gaussian.
const BETAS: [f64; 11] = [1.8, 2.1, 2.5, 3.0, 3.5, 4.2, 5.0, 6.5, 9.0, 14.0, 30.0];

/// A star of the stack: the pixels it is on, its place there (px) and its flux through the window (ADU).
pub(crate) type Stacked<'a> = (&'a Clean, f64, f64, f64);

/// The mean profile of a frame's stars.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StarProfile {
    pub(crate) fwhm_px: f64,
    pub(crate) beta: f64,
}

impl StarProfile {
    /// Stacks and fits; `fwhm_px` is the width by moments. None when the pixels are too few or no peak is there.
    pub(crate) fn fit(stars: &[Stacked], fwhm_px: f64) -> Option<Self> {
        let profile = stack(stars, fwhm_px);
        if profile.len() < 8 {
            return None;
        }
        let fits = BETAS.iter().map(|beta| {
            let width = minimum(0.5 * fwhm_px, 1.6 * fwhm_px, |width| misfit(&profile, width, *beta));
            (misfit(&profile, width, *beta), Self { fwhm_px: width, beta: *beta })
        });
        fits.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, fit)| fit)
    }

    /// Flux of the whole profile over the flux seen through a Gaussian window of this sigma (px).
    pub(crate) fn whole_over_window(&self, sigma_px: f64) -> f64 {
        let alpha = alpha(self.fwhm_px, self.beta);
        let step = 0.02 * self.fwhm_px.min(sigma_px);
        let seen: f64 = (0..(6.0 * sigma_px / step) as usize)
            .map(|n| (n as f64 + 0.5) * step)
            .map(|r| r * moffat(r, alpha, self.beta) * (-0.5 * (r / sigma_px).powi(2)).exp())
            .sum();
        0.5 * alpha.powi(2) / (self.beta - 1.0) / (seen * step)
    }
}

fn alpha(fwhm: f64, beta: f64) -> f64 {
    0.5 * fwhm / (2.0_f64.powf(1.0 / beta) - 1.0).sqrt()
}

fn moffat(r: f64, alpha: f64, beta: f64) -> f64 {
    (1.0 + (r / alpha).powi(2)).powf(-beta)
}

/// Radius (px) and median brightness, in units of the flux, of rings around the stars.
fn stack(stars: &[Stacked], fwhm_px: f64) -> Vec<(f64, f64)> {
    let per_px = BINS_PER_FWHM / fwhm_px;
    let reach = BINS as f64 / per_px;
    let step = (fwhm_px / SAMPLES_PER_FWHM).max(1.0) as usize;
    let mut rings: Vec<(f64, Vec<f64>)> = vec![(0.0, Vec::new()); BINS];
    for (clean, x, y, flux) in stars {
        let range = |at: f64, length: usize| {
            (at - reach).ceil().max(0.0) as usize..((at + reach).floor() + 1.0).clamp(0.0, length as f64) as usize
        };
        for row in range(*y, clean.height).step_by(step) {
            for column in range(*x, clean.width).step_by(step) {
                let r = (column as f64 - x).hypot(row as f64 - y);
                if let Some((sum, values)) = rings.get_mut((r * per_px) as usize) {
                    *sum += r;
                    values.push(f64::from(clean.pixels[row * clean.width + column]) / flux);
                }
            }
        }
    }
    let filled = rings.into_iter().filter(|(_, values)| values.len() >= FEWEST);
    filled
        .map(|(sum, mut values)| {
            let (count, middle) = (values.len(), values.len() / 2);
            (sum / count as f64, *values.select_nth_unstable_by(middle, f64::total_cmp).1)
        })
        .collect()
}

/// Sum of squared differences, the height being the best one.
fn misfit(profile: &[(f64, f64)], fwhm: f64, beta: f64) -> f64 {
    let alpha = alpha(fwhm, beta);
    let (mut mm, mut md, mut dd) = (0.0, 0.0, 0.0);
    for (r, value) in profile {
        let model = moffat(*r, alpha, beta);
        mm += model * model;
        md += model * value;
        dd += value * value;
    }
    dd - md.max(0.0).powi(2) / mm
}

/// Golden-section search.
fn minimum(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_75;
    let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
    let (mut fa, mut fb) = (f(a), f(b));
    for _ in 0..24 {
        if fa < fb {
            (high, b, fb) = (b, a, fa);
            a = high - GOLDEN * (high - low);
            fa = f(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + GOLDEN * (high - low);
            fb = f(b);
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_seen_of_a_gaussian_is_that_of_the_formula() {
        // beta 30 is nearly a Gaussian: under a window of its own width half of it is seen
        let profile = StarProfile { fwhm_px: 4.0, beta: 30.0 };
        let whole = profile.whole_over_window(4.0 / 2.354_82);
        assert!((whole - 2.0).abs() < 0.05, "{whole}");
    }

    #[test]
    fn the_minimum_of_a_parabola_is_found() {
        assert!((minimum(0.0, 10.0, |x| (x - 3.3).powi(2)) - 3.3).abs() < 1e-4);
    }
}
