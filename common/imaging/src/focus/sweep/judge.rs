//! What the points measured so far say.

use super::plan::{Curve, Plan};
use super::{FocusFit, FocusMeasurement, NoFocus};
use crate::focus::hyperbola::{Hyperbola, Size};
use crate::focus::operator::Better;

/// Share of the critical zone that the error of the focus may have: chosen, not measured.
const ERROR: f64 = 0.3;
/// Points with a value that a focus needs, and on either side of it.
const FEWEST: usize = 5;
const BESIDE: usize = 2;
/// The best value differs from the usual one by more than this share, or the run is flat.
const FLAT: f64 = 0.03;
/// A verification may be so much larger than the curve's least size.
const LARGER: f64 = 1.1;
/// A verification by another operator may fall short of the best by this share of the curve's range.
const SHORT: f64 = 0.25;

/// Where to look on.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Advice {
    /// The focus lies inside: look closely between these.
    Fine {
        low: f64,
        high: f64,
    },
    /// It lies below, or above, what was measured.
    Lower,
    Higher,
    /// Too few values for a curve: look about this position.
    Narrow(i32),
    /// Nothing to go by.
    Lost,
    /// Values enough, but no minimum among them.
    NoMinimum,
}

/// The curve through the points, if there is one.
pub(super) fn fit(plan: &Plan, points: &[FocusMeasurement]) -> Option<FocusFit> {
    match plan.curve {
        Curve::Hyperbola => {
            let sizes: Vec<Size> = points.iter().map(size).collect();
            Hyperbola::fit(&sizes).ok().map(FocusFit::Hyperbola)
        }
        Curve::Smoothed(smoother, better) => {
            let values: Vec<(f64, f64)> =
                points.iter().filter_map(|p| p.value.map(|value| (f64::from(p.position), value.value))).collect();
            let curve = smoother.curve(&values).ok()?;
            let best = smoother.best(&values, better).ok()?;
            Some(FocusFit::Smoothed { smoother: smoother.name, better, curve, best })
        }
    }
}

fn size(point: &FocusMeasurement) -> Size {
    let (size, error) = point.value.map_or((f64::NAN, f64::NAN), |value| (value.value, value.error));
    Size { position: f64::from(point.position), size, error }
}

/// What to do after the first positions, or after more of them.
pub(super) fn advice(plan: &Plan, points: &[FocusMeasurement], spacing: f64) -> Advice {
    let mut positions: Vec<i32> = points.iter().map(|p| p.position).collect();
    positions.sort_unstable();
    positions.dedup();
    let (Some(low), Some(high)) = (positions.get(1), positions.iter().rev().nth(1)) else { return Advice::Lost };
    if let Some(fit) = fit(plan, points) {
        let best = fit.best_position();
        return if best < f64::from(*low) {
            Advice::Lower
        } else if best > f64::from(*high) {
            Advice::Higher
        } else {
            let asked = plan.closer_percent.map(|percent| 0.01 * f64::from(percent) * f64::from(plan.half_range));
            let reach = asked.unwrap_or(fine_reach(&fit, spacing));
            Advice::Fine { low: best - reach, high: best + reach }
        };
    }
    match smallest(plan, points) {
        None => Advice::Lost,
        Some((_, valid)) if valid < FEWEST => smallest(plan, points).map_or(Advice::Lost, |(at, _)| Advice::Narrow(at)),
        Some((at, _)) if at < *low => Advice::Lower,
        Some((at, _)) if at > *high => Advice::Higher,
        Some(_) => Advice::NoMinimum,
    }
}

/// Between which positions to look closely, as far as there is a curve with its best position near the points.
pub(super) fn about_the_focus(plan: &Plan, points: &[FocusMeasurement], spacing: f64) -> Option<(f64, f64)> {
    let fit = fit(plan, points)?;
    let best = fit.best_position();
    let reach = fine_reach(&fit, spacing);
    let is_near = |point: &FocusMeasurement| (f64::from(point.position) - best).abs() < 2.0 * spacing;
    points.iter().any(is_near).then_some((best - reach, best + reach))
}

/// Three critical zones to either side, but neither finer than a few steps nor coarser than the first positions.
fn fine_reach(fit: &FocusFit, spacing: f64) -> f64 {
    let wanted = fit.critical_zone().map_or(1.5 * spacing, |zone| 3.0 * zone);
    wanted.clamp((0.5 * spacing).max(3.0), (4.0 * spacing).max(3.0))
}

/// Position of the best of the values, each being the median of itself and its neighbours; and how many there are.
fn smallest(plan: &Plan, points: &[FocusMeasurement]) -> Option<(i32, usize)> {
    let sign = match plan.curve {
        Curve::Smoothed(_, Better::Larger) => -1.0,
        _ => 1.0,
    };
    let mut valid: Vec<(i32, f64)> =
        points.iter().filter_map(|p| p.value.map(|value| (p.position, sign * value.value))).collect();
    valid.sort_by_key(|(position, _)| *position);
    let smooth = |n: usize| {
        let around = &valid[n.saturating_sub(1)..(n + 2).min(valid.len())];
        crate::focus::median(around.iter().map(|(_, value)| *value).collect()).unwrap_or(f64::INFINITY)
    };
    let best = (0..valid.len()).min_by(|a, b| smooth(*a).total_cmp(&smooth(*b)))?;
    let usual = crate::focus::median(valid.iter().map(|(_, value)| *value).collect())?;
    // of values that are all alike none is the best: the middle keeps the range where it is
    let stands_out = usual - smooth(best) > FLAT * usual.abs();
    let best = if stands_out { best } else { valid.len() / 2 };
    Some((valid[best].0, valid.len()))
}

/// Whether the curve's minimum can be believed.
pub(super) fn accept(plan: &Plan, points: &[FocusMeasurement]) -> Result<FocusFit, NoFocus> {
    let valid = points.iter().filter(|p| p.value.is_some()).count();
    if valid < FEWEST {
        return Err(NoFocus::TooFewValues { valid, needed: FEWEST });
    }
    let fit = fit(plan, points).ok_or(NoFocus::NoMinimum)?;
    let best = fit.best_position();
    let is_used = |n: usize| match &fit {
        FocusFit::Hyperbola(curve) => curve.used.get(n).copied().unwrap_or(false),
        FocusFit::Smoothed { .. } => points[n].value.is_some(),
    };
    let used: Vec<f64> = (0..points.len()).filter(|n| is_used(*n)).map(|n| f64::from(points[n].position)).collect();
    let (below, above) = (used.iter().filter(|p| **p < best).count(), used.iter().filter(|p| **p > best).count());
    if used.len() < FEWEST || below < BESIDE || above < BESIDE {
        return Err(NoFocus::OneSided { below, above });
    }
    if let (Some(error), Some(zone)) = (fit.best_position_error(), fit.critical_zone())
        && error >= ERROR * zone
    {
        return Err(NoFocus::Uncertain { error_steps: error, critical_zone_steps: zone });
    }
    Ok(fit)
}

/// Whether a value in focus is as good as the curve promises.
pub(super) fn is_verified(fit: &FocusFit, value: f64) -> bool {
    match fit {
        FocusFit::Hyperbola(curve) => value <= LARGER * curve.least_size,
        FocusFit::Smoothed { better, curve, best, .. } => {
            let (low, high) = curve.iter().fold((f64::MAX, f64::MIN), |(l, h), (_, y)| (l.min(*y), h.max(*y)));
            let missing = if *better == Better::Smaller { value - best.1 } else { best.1 - value };
            missing <= SHORT * (high - low)
        }
    }
}
