//! How far the stars moved, from the sums over rows and over columns: for fields too crowded or too nebulous for
//! star lists.
//!
//! The way of donuts (McCormac et al. 2013, PASP 125, 548; algorithms.md 3.2 and 6.4), with star cores only, means
//! taken off, ends tapered and nothing wrapped around: profiles are correlated directly over the lags asked for. A
//! shift counts only if its peak stands clear of every other one.

use crate::clean::Clean;
use crate::shift::{Method, NoShift, Shift};

/// What stands less than this above the sky is no star, sigma.
const CORE: f32 = 5.0;
/// Pixels at an end over which a profile fades to zero, and share of the profile at most.
const TAPER: (usize, f64) = (32, 0.1);
/// Lags tried, as a share of the profile.
const LAGS: f64 = 0.25;
/// The highest peak over the second one.
const CLEAR: f64 = 1.5;
/// Standard error to be expected, px: measured on pairs with known shifts (tests/shift.rs).
const ERROR_PX: f64 = 0.1;

/// The shift between two cleaned frames: check minus reference, up to a quarter of the frame. It has no rotation.
///
/// # Errors
/// [`NoShift`] when the frames differ in shape, or a correlation has no clear peak (no stars, clouds).
pub fn from_projections(reference: &Clean, check: &Clean) -> Result<Shift, NoShift> {
    between(&Profiles::of(reference), &Profiles::of(check))
}

/// The same from profiles that were kept.
///
/// # Errors
/// As [`from_projections`].
pub fn between(reference: &Profiles, check: &Profiles) -> Result<Shift, NoShift> {
    let shape = |profiles: &Profiles| (profiles.along_x.len(), profiles.along_y.len());
    let ((width, height), (check_width, check_height)) = (shape(reference), shape(check));
    if (width, height) != (check_width, check_height) {
        return Err(NoShift::Shapes(width, height, check_width, check_height));
    }
    let dx_px = lag(&reference.along_x, &check.along_x).ok_or(NoShift::NoPeak { axis: 'x' })?;
    let dy_px = lag(&reference.along_y, &check.along_y).ok_or(NoShift::NoPeak { axis: 'y' })?;
    let variance = ERROR_PX * ERROR_PX;
    Ok(Shift {
        dx_px,
        dy_px,
        rotation_deg: 0.0,
        covariance: [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0; 3]],
        stars: 0,
        transparency: None,
        method: Method::Projections,
    })
}

/// What is left of a frame for this: the sums over its rows and over its columns, star cores only.
#[derive(Debug, Clone, PartialEq)]
pub struct Profiles {
    along_x: Vec<f64>,
    along_y: Vec<f64>,
}

impl Profiles {
    /// Of a cleaned frame.
    pub fn of(clean: &Clean) -> Self {
        let mut sigma = vec![0.0; clean.width];
        let (mut along_x, mut along_y) = (vec![0.0; clean.width], Vec::with_capacity(clean.height));
        for (y, line) in clean.pixels.chunks(clean.width).enumerate() {
            clean.background.noise.row(y, &mut sigma);
            let mut sum = 0.0;
            for ((column, pixel), sigma) in along_x.iter_mut().zip(line).zip(&sigma) {
                let core = f64::from((pixel - CORE * sigma).max(0.0));
                *column += core;
                sum += core;
            }
            along_y.push(sum);
        }
        Self { along_x: tapered(along_x), along_y: tapered(along_y) }
    }
}

/// Less its mean, and fading to zero at both ends.
fn tapered(mut profile: Vec<f64>) -> Vec<f64> {
    let length = profile.len();
    let mean = profile.iter().sum::<f64>() / length as f64;
    let fade = TAPER.0.min((TAPER.1 * length as f64) as usize).max(1);
    for (n, value) in profile.iter_mut().enumerate() {
        let from_end = (n.min(length - 1 - n) + 1) as f64 / (fade + 1) as f64;
        let share = if from_end < 1.0 { 0.5 - 0.5 * (std::f64::consts::PI * from_end).cos() } else { 1.0 };
        *value = (*value - mean) * share;
    }
    profile
}

/// The lag of the highest correlation, refined by a parabola. None when it is not clear of the second peak.
fn lag(reference: &[f64], check: &[f64]) -> Option<f64> {
    let reach = ((LAGS * reference.len() as f64) as isize).max(2);
    let correlation: Vec<f64> = (-reach..=reach)
        .map(|lag| {
            let (r, c) = if lag >= 0 {
                (&reference[..reference.len() - lag as usize], &check[lag as usize..])
            } else {
                (&reference[lag.unsigned_abs()..], check)
            };
            r.iter().zip(c).map(|(a, b)| a * b).sum()
        })
        .collect();
    let best = (0..correlation.len()).max_by(|a, b| correlation[*a].total_cmp(&correlation[*b]))?;
    let (before, here, after) =
        (*correlation.get(best.checked_sub(1)?)?, correlation[best], *correlation.get(best + 1)?);
    let is_peak = |n: usize| correlation[n] >= correlation[n - 1] && correlation[n] >= correlation[n + 1];
    let others = (1..correlation.len() - 1).filter(|n| n.abs_diff(best) > 1 && is_peak(*n));
    let second = others.map(|n| correlation[n]).fold(0.0, f64::max);
    let curvature = before - 2.0 * here + after;
    let vertex = 0.5 * (before - after) / curvature;
    (here.is_finite() && here > CLEAR * second && curvature < 0.0 && vertex.abs() <= 1.0)
        .then_some(best as f64 - reach as f64 + vertex)
}
