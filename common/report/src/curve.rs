//! Light curves: the flux of a target against the sum of comparison stars.

use std::collections::BTreeMap;

use serde::Serialize;
use units::Utc;

use crate::events::{FluxRecord, FrameRecord, NightEvents};

/// A curve of fewer frames shows nothing.
const FEWEST_FRAMES: usize = 5;
/// A comparison star that is measured on a smaller share of the frames is left out.
const PRESENT: f64 = 0.9;
/// A comparison star that scatters so many times more than its errors explain varies, and is left out where that is so many
/// times more than for the middle one of them.
const ABOVE_EXPECTED: f64 = 3.0;
const ABOVE_OTHERS: f64 = 1.5;
/// What two stars differ by shows something where their errors are at most so many times those of the best two.
const FAINTER: f64 = 4.0;

/// The light curve of a target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    /// OBJECT.
    pub object: String,
    /// The filter.
    pub filter: Option<String>,
    /// Which camera.
    pub camera: String,
    /// How many comparison stars it rests on.
    pub comparison_stars: usize,
    /// How many stars were left out because they vary.
    pub variable_stars: usize,
    /// What a reader has to know before believing the curve.
    pub warnings: Vec<String>,
    /// Frames of the target that are not in it: not solved, saturated, or without the target.
    pub frames_left_out: usize,
    /// The points, the oldest first.
    pub points: Vec<CurvePoint>,
}

/// A frame of a curve.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CurvePoint {
    /// The middle of the exposure.
    pub mid_utc: Utc,
    /// Target over comparison stars; the median of the curve is 1.
    pub flux: f64,
    /// Its standard error.
    pub flux_error: f64,
    /// The flux of the target, ADU.
    pub target_adu: f64,
    /// The sum of the comparison stars, ADU.
    pub comparison_adu: f64,
    /// Airmass.
    pub airmass: Option<f64>,
    /// Width of the stars, arcsec; absent where the scale is not known.
    pub fwhm_arcsec: Option<f64>,
    /// Sky, ADU.
    pub sky_adu: Option<f64>,
    /// Drift of the target since the first point, px along x.
    pub dx_px: f64,
    /// Drift of the target since the first point, px along y.
    pub dy_px: f64,
}

/// All light curves of a night.
pub fn curves(events: &NightEvents) -> Vec<Curve> {
    let frames: BTreeMap<&str, &FrameRecord> = events.frames.iter().map(|frame| (frame.id.as_str(), frame)).collect();
    let mut series: BTreeMap<&str, Vec<&FluxRecord>> = BTreeMap::new();
    for flux in &events.fluxes {
        series.entry(&flux.series).or_default().push(flux);
    }
    series.values().filter_map(|fluxes| curve(fluxes, &frames, events)).collect()
}

/// The fluxes of one frame by star.
type Stars<'a> = BTreeMap<u32, &'a FluxRecord>;

fn curve(fluxes: &[&FluxRecord], frames: &BTreeMap<&str, &FrameRecord>, events: &NightEvents) -> Option<Curve> {
    let mut by_frame: BTreeMap<&str, Stars<'_>> = BTreeMap::new();
    for flux in fluxes {
        if flux.flux_adu.is_finite() && flux.flux_adu > 0.0 && flux.error_adu.is_finite() && !flux.is_saturated {
            by_frame.entry(&flux.frame).or_default().insert(flux.star, flux);
        }
    }
    let counts = |frame: &&FrameRecord| frame.refused.is_none();
    let mut measured: Vec<(&FrameRecord, &Stars<'_>)> = by_frame
        .iter()
        .filter(|(_, stars)| stars.contains_key(&0))
        .filter_map(|(id, stars)| Some((frames.get(id).copied().filter(counts)?, stars)))
        .collect();
    measured.sort_by_key(|(frame, _)| frame.started);
    let Comparison { stars, variable_stars, warnings } = Comparison::of(&measured)?;
    measured.retain(|(_, of)| stars.iter().all(|star| of.contains_key(star)));
    if measured.len() < FEWEST_FRAMES {
        return None;
    }
    let (first, first_stars) = measured.first()?;
    let ratios: Vec<f64> = measured.iter().filter_map(|(_, of)| ratio(of, 0, &stars)).collect();
    let level = median(&ratios)?;
    let origin = first_stars.get(&0)?;
    let points: Vec<CurvePoint> = measured
        .iter()
        .filter_map(|(frame, of)| {
            let target = of.get(&0)?;
            let comparison_adu: f64 = stars.iter().filter_map(|star| of.get(star)).map(|flux| flux.flux_adu).sum();
            let variance: f64 = stars.iter().filter_map(|star| of.get(star)).map(|flux| flux.error_adu.powi(2)).sum();
            let flux = target.flux_adu / comparison_adu / level;
            let relative = (target.error_adu / target.flux_adu).hypot(variance.sqrt() / comparison_adu);
            Some(CurvePoint {
                mid_utc: frame.started.plus_seconds(frame.exposure_s / 2.0),
                flux,
                flux_error: flux * relative,
                target_adu: target.flux_adu,
                comparison_adu,
                airmass: frame.airmass,
                fwhm_arcsec: frame.fwhm_px.zip(frame.scale_arcsec_px).map(|(fwhm, scale)| fwhm * scale),
                sky_adu: frame.sky_adu,
                dx_px: target.x_px - origin.x_px,
                dy_px: target.y_px - origin.y_px,
            })
        })
        .collect();
    let is_same = |frame: &&FrameRecord| {
        frame.object == first.object
            && frame.filter == first.filter
            && frame.camera == first.camera
            && frame.bin == first.bin
            && frame.exposure_us() == first.exposure_us()
            && frame.action == first.action
            && frame.refused.is_none()
    };
    let all = events.frames.iter().filter(is_same).count();
    Some(Curve {
        object: first.object.clone().unwrap_or_default(),
        filter: first.filter.clone(),
        camera: first.camera.clone(),
        comparison_stars: stars.len(),
        variable_stars,
        warnings,
        frames_left_out: all.saturating_sub(points.len()),
        points,
    })
}

/// The stars that a curve rests on.
struct Comparison {
    stars: Vec<u32>,
    variable_stars: usize,
    warnings: Vec<String>,
}

impl Comparison {
    /// The stars that are on nearly all frames and do not vary.
    fn of(measured: &[(&FrameRecord, &Stars<'_>)]) -> Option<Self> {
        let mut present: BTreeMap<u32, usize> = BTreeMap::new();
        for star in measured.iter().flat_map(|(_, of)| of.keys()).filter(|star| **star > 0) {
            *present.entry(*star).or_default() += 1;
        }
        let fewest = PRESENT * measured.len() as f64;
        let mut stars: Vec<u32> =
            present.into_iter().filter(|(_, count)| *count as f64 >= fewest).map(|(star, _)| star).collect();
        let (mut variable_stars, mut scatters) = (0, scatters(measured, &stars));
        while stars.len() > 1 {
            let middle = median(&scatters.iter().map(|of| of.of_expected).collect::<Vec<f64>>()).unwrap_or(f64::NAN);
            let worst = scatters.iter().enumerate().max_by(|(_, a), (_, b)| a.of_expected.total_cmp(&b.of_expected));
            match worst {
                Some((index, worst)) if worst.varies() && worst.of_expected > ABOVE_OTHERS * middle => {
                    stars.remove(index)
                }
                _ => break,
            };
            variable_stars += 1;
            scatters = self::scatters(measured, &stars);
        }
        let warnings = warnings(&scatters);
        (!stars.is_empty()).then_some(Self { stars, variable_stars, warnings })
    }
}

/// The scatter of each star against that one of the others, and of the target, with which it agrees best: a star that varies
/// agrees with none, and one that does not with each that does not.
fn scatters(measured: &[(&FrameRecord, &Stars<'_>)], stars: &[u32]) -> Vec<Scatter> {
    let best = |star: &u32| {
        let others = std::iter::once(&0).chain(stars).filter(|other| *other != star);
        let against: Vec<Scatter> = others.map(|other| Scatter::of(measured, *star, *other)).collect();
        // Against a faint star everything agrees within the errors.
        let sharpest = against.iter().map(|of| of.expected).fold(f64::INFINITY, f64::min);
        let sharp = against.iter().filter(|of| of.expected <= FAINTER * sharpest).copied();
        sharp.min_by(|a, b| a.of_expected.total_cmp(&b.of_expected)).unwrap_or(Scatter::UNKNOWN)
    };
    stars.iter().map(best).collect()
}

/// Where the stars that are left do not agree, or there is only one, the curve may show their light.
fn warnings(scatters: &[Scatter]) -> Vec<String> {
    let worst = scatters.iter().filter(|of| of.varies()).max_by(|a, b| a.relative.total_cmp(&b.relative));
    let warning = match (scatters.len(), worst) {
        (1, _) => Some("there is one comparison star, and whether it varies cannot be seen".to_owned()),
        (count, Some(Scatter { relative, of_expected, .. })) => Some(format!(
            "the {count} comparison stars differ by {:.1} % from frame to frame, {of_expected:.0} times what their photons \
             explain, and which of them varies cannot be seen; the curve may show it",
            100.0 * relative
        )),
        (_, None) => None,
    };
    warning.into_iter().collect()
}

/// A star over the sum of others; absent where one of them is missing.
fn ratio(of: &Stars<'_>, star: u32, others: &[u32]) -> Option<f64> {
    let sum: Option<f64> = others.iter().map(|other| of.get(other).map(|flux| flux.flux_adu)).sum();
    let ratio = of.get(&star)?.flux_adu / sum?;
    ratio.is_finite().then_some(ratio)
}

/// The middle of some values; absent of none.
pub(crate) fn median(values: &[f64]) -> Option<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        length if length % 2 == 1 => Some(sorted[middle]),
        _ => Some(f64::midpoint(sorted[middle - 1], sorted[middle])),
    }
}

/// How much a star scatters against another one.
#[derive(Debug, Clone, Copy)]
struct Scatter {
    /// Relative to its flux, robust against outliers.
    relative: f64,
    /// What the errors of both explain.
    expected: f64,
    /// The scatter in units of that.
    of_expected: f64,
}

impl Scatter {
    const UNKNOWN: Self = Self { relative: f64::INFINITY, expected: f64::INFINITY, of_expected: f64::INFINITY };

    fn of(measured: &[(&FrameRecord, &Stars<'_>)], star: u32, other: u32) -> Self {
        let ratios: Vec<f64> = measured.iter().filter_map(|(_, of)| ratio(of, star, &[other])).collect();
        let error = |of: &Stars<'_>| {
            let relative = |star: &u32| of.get(star).map(|flux| flux.error_adu / flux.flux_adu);
            Some(relative(&star)?.hypot(relative(&other)?))
        };
        let errors: Vec<f64> = measured.iter().filter_map(|(_, of)| error(of)).collect();
        let (Some(middle), Some(expected)) = (median(&ratios), median(&errors)) else { return Self::UNKNOWN };
        let off: Vec<f64> = ratios.iter().map(|value| (value / middle - 1.0).abs()).collect();
        // A median is 1.4826 times smaller than the standard deviation of a normal distribution.
        let relative = median(&off).map_or(f64::INFINITY, |off| 1.4826 * off);
        Self { relative, expected, of_expected: relative / expected }
    }

    fn varies(&self) -> bool {
        self.of_expected > ABOVE_EXPECTED
    }
}
