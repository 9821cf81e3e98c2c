//! The quality of a frame as a whole: what triggers and headers are made of.

use crate::background::median_in_place;
use crate::clean::Clean;
use crate::star::Star;

/// Stars from which the frame's width and ellipticity are taken.
const BEST: usize = 50;
/// A frame is trailed when its stars are longer than wide by more than this ...
const TRAILED: f64 = 1.6;
/// ... in a common direction: mean of the doubled angles as unit vectors.
const COMMON: f64 = 0.7;

/// A value and its standard error, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Standard error.
    pub error: f64,
}

/// What a frame is worth.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Stars, without what is flagged as cosmic.
    pub stars: usize,
    /// Median width at half maximum of the best stars, px; None without a well seen, unsaturated star.
    pub fwhm_px: Option<Estimate>,
    /// Median of 1 - minor / major axis of the same stars.
    pub ellipticity: Option<Estimate>,
    /// Their common direction from +x towards +y, degrees, -90 to 90; None when they have none.
    pub elongation_deg: Option<f64>,
    /// All stars are drawn out in one direction: tracking failed, or wind.
    pub trailed: bool,
    /// Median sky level, ADU.
    pub background_adu: f64,
    /// Median noise of a pixel on empty sky, ADU.
    pub noise_adu: f64,
    /// Share of the pixels that are saturated, 0 to 1.
    pub saturated_fraction: f64,
    /// Share of the pixels that were replaced: hot, dead, known as bad, or without a value; 0 to 1.
    pub defect_fraction: f64,
    /// Whether rows or columns had offsets, which were taken out.
    pub banding: bool,
}

impl Quality {
    /// `measured`: whether the width was measured on well seen stars.
    pub(crate) fn of(clean: &Clean, stars: &[Star], measured: bool) -> Self {
        let clear = |s: &&Star| !(s.flags.saturated || s.flags.cosmic || s.flags.edge || s.flags.blended);
        let mut best: Vec<&Star> = stars.iter().filter(clear).collect();
        if best.is_empty() {
            best = stars.iter().filter(|s| !s.flags.saturated && !s.flags.cosmic).collect();
        }
        best.truncate(if measured { BEST } else { 0 });
        let over_all = |of: fn(&Star) -> f64| median(best.iter().map(|star| of(star)));
        let ellipticity = over_all(|star| star.ellipticity);
        let (cos, sin) = best
            .iter()
            .map(|star| (2.0 * star.angle_deg.to_radians()).sin_cos())
            .fold((0.0, 0.0), |(cos, sin), (s, c)| (cos + c, sin + s));
        let common = best.len() >= 3 && cos.hypot(sin) > COMMON * best.len() as f64;
        let pixels = clean.pixels.len() as f64;
        Self {
            stars: stars.iter().filter(|star| !star.flags.cosmic).count(),
            fwhm_px: over_all(|star| star.fwhm_px),
            ellipticity,
            elongation_deg: common.then(|| (0.5 * sin.atan2(cos)).to_degrees()),
            trailed: common && ellipticity.is_some_and(|e| e.value > 1.0 - 1.0 / TRAILED),
            background_adu: f64::from(clean.background.level.median()),
            noise_adu: f64::from(clean.background.noise.median()),
            saturated_fraction: clean.saturated as f64 / pixels,
            defect_fraction: clean.filled.len() as f64 / pixels,
            banding: clean.banding,
        }
    }
}

/// Median and its standard error, 1.2533 sigma / sqrt(n) with sigma from the MAD. None when there are no values.
fn median(values: impl Iterator<Item = f64>) -> Option<Estimate> {
    let mut values: Vec<f32> = values.map(|value| value as f32).collect();
    let middle = median_in_place(&mut values)?;
    values.iter_mut().for_each(|value| *value = (*value - middle).abs());
    let sigma = 1.4826 * f64::from(median_in_place(&mut values)?);
    Some(Estimate { value: f64::from(middle), error: 1.2533 * sigma / (values.len() as f64).sqrt() })
}
