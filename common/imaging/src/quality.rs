//! The quality of a frame as a whole: what triggers and headers are made of.

use crate::background::median_in_place;
use crate::clean::Clean;
use crate::defect::SHARPEST_PX;
use crate::star::Star;
use crate::trails::FoundTrails;

/// Stars from which the frame's width and ellipticity are taken.
const BEST: usize = 50;
/// A frame is trailed when its stars are longer than wide by more than this ...
const TRAILED: f64 = 1.6;
/// ... in a common direction: mean of the doubled angles as unit vectors.
const COMMON: f64 = 0.7;
/// They are drawn out so far that no place on them is theirs when the trail is longer than this many widths: it is then seen
/// as several stars.
const STREAK: f64 = 6.0;
/// Stars that show how long their trails are, and how far they are followed, px.
const FOLLOWED: usize = 20;
const FURTHEST_PX: usize = 1000;
/// No star is narrower than this, px: it is what a pixel makes of a point.
const NARROWEST_PX: f64 = 0.68;
/// Widths that are as sharp as those of cosmic rays are those of stars if they agree within this share.
const SHARP_SPREAD: f64 = 0.25;

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
    /// Length of the trails where the stars are drawn out by more than six widths, px: where on it a star was is not known.
    pub trail_px: Option<f64>,
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
    /// Trails of satellites and aircraft that were taken out.
    pub trails: usize,
}

impl Quality {
    /// `measured`: whether the width was measured on well seen stars.
    pub(crate) fn of(clean: &Clean, stars: &[Star], measured: bool, trails: FoundTrails) -> Self {
        let clear = |s: &&Star| !(s.flags.saturated || s.flags.cosmic || s.flags.edge || s.flags.blended);
        let mut best: Vec<&Star> = stars.iter().filter(clear).collect();
        if best.is_empty() {
            best = stars.iter().filter(|s| !s.flags.saturated && !s.flags.cosmic).collect();
        }
        best.truncate(if measured { BEST } else { 0 });
        let over_all = |of: fn(&Star) -> f64| median(best.iter().map(|star| of(star)));
        let spread = |fwhm: &Estimate| fwhm.error * (best.len() as f64).sqrt() / MEDIAN_ERROR;
        let is_sharp = |fwhm: &Estimate| fwhm.value < f64::from(SHARPEST_PX);
        let may_be_stars = |fwhm: &Estimate| {
            fwhm.value >= NARROWEST_PX && (!is_sharp(fwhm) || spread(fwhm) <= SHARP_SPREAD * fwhm.value)
        };
        let fwhm_px = over_all(|star| star.fwhm_px).filter(may_be_stars);
        let ellipticity = over_all(|star| star.ellipticity).filter(|_| fwhm_px.is_some());
        let (cos, sin) = best
            .iter()
            .map(|star| (2.0 * star.angle_deg.to_radians()).sin_cos())
            .fold((0.0, 0.0), |(cos, sin), (s, c)| (cos + c, sin + s));
        let common = best.len() >= 3 && cos.hypot(sin) > COMMON * best.len() as f64;
        let elongation_deg = common.then(|| (0.5 * sin.atan2(cos)).to_degrees());
        let drawn_out = common && ellipticity.is_some_and(|e| e.value > 1.0 - 1.0 / TRAILED);
        let streak = || streak_px(clean, best.get(..FOLLOWED).unwrap_or(&best), elongation_deg?);
        let trail_px = drawn_out.then(streak).flatten().or(trails.stars_px.map(f64::from));
        let pixels = clean.pixels.len() as f64;
        Self {
            stars: stars.iter().filter(|star| !star.flags.cosmic).count(),
            fwhm_px,
            ellipticity,
            elongation_deg,
            trailed: drawn_out || trail_px.is_some(),
            trail_px,
            background_adu: f64::from(clean.background.level.median()),
            noise_adu: f64::from(clean.background.noise.median()),
            saturated_fraction: clean.saturated as f64 / pixels,
            defect_fraction: clean.filled.len() as f64 / pixels,
            banding: clean.banding,
            trails: trails.removed,
        }
    }
}

/// Median length of the stars' trails in a direction, px. None when it is not much more than they are wide.
fn streak_px(clean: &Clean, stars: &[&Star], angle_deg: f64) -> Option<f64> {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let length = |star: &&Star| {
        // the mean of 3 x 3 px, at a distance along the trail
        let light = |t: f64| {
            let (x, y) = ((star.x_px + t * cos).round(), (star.y_px + t * sin).round());
            let inside = x >= 1.0 && y >= 1.0 && x + 2.0 < clean.width as f64 && y + 2.0 < clean.height as f64;
            let rows = || (0..3).map(|row| (y as usize + row - 1) * clean.width + x as usize);
            inside.then(|| rows().flat_map(|at| &clean.pixels[at - 1..=at + 1]).sum::<f32>())
        };
        let here = light(0.0).unwrap_or(0.0);
        let reach = |sign: f64| {
            let is_dark = |t: &usize| light(sign * *t as f64).is_none_or(|light| light < 0.5 * here);
            (1..FURTHEST_PX).find(is_dark).unwrap_or(FURTHEST_PX)
        };
        (reach(1.0) + reach(-1.0)) as f64 - 1.0
    };
    let (lengths, widths) = (
        median(stars.iter().map(length))?.value,
        median(stars.iter().map(|star| star.fwhm_px * (1.0 - star.ellipticity).max(0.0).sqrt()))?.value,
    );
    (lengths > STREAK * widths.max(NARROWEST_PX)).then_some(lengths)
}

/// Standard error of a median over that of a mean.
const MEDIAN_ERROR: f64 = 1.2533;

/// Median and its standard error, 1.2533 sigma / sqrt(n) with sigma from the MAD. None when there are no values.
fn median(values: impl Iterator<Item = f64>) -> Option<Estimate> {
    let mut values: Vec<f32> = values.map(|value| value as f32).collect();
    let middle = median_in_place(&mut values)?;
    values.iter_mut().for_each(|value| *value = (*value - middle).abs());
    let sigma = 1.4826 * f64::from(median_in_place(&mut values)?);
    Some(Estimate { value: f64::from(middle), error: MEDIAN_ERROR * sigma / (values.len() as f64).sqrt() })
}
