//! Which star of the one list is which of the other?

use std::collections::HashMap;

use super::fit::FieldMotion;
use crate::star::Star;

/// Distance of the grid points at which differences are counted, px: room for centroids and a small rotation.
const CELL_PX: f64 = 4.0;
/// Two detections are the same star if their fluxes differ by no more than this from the usual ratio.
const FLUX_FACTOR: f64 = 4.0;
/// Places that agree better than this, while all others move, belong to the detector, px.
const STILL_PX: f64 = 0.3;

/// The difference of places (check - reference, px) that most pairs have in common; None of none.
///
/// Counted on a grid of points, each pair at the four points around it, so that no peak is cut by a border.
pub(crate) fn most_frequent_difference(differences: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let mut points: HashMap<(i64, i64), u32> = HashMap::new();
    for (dx, dy) in differences {
        let corner = ((dx / CELL_PX).floor() as i64, (dy / CELL_PX).floor() as i64);
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            *points.entry((corner.0 + i, corner.1 + j)).or_default() += 1;
        }
    }
    // of equal counts the point nearest to no shift at all wins
    let far = |(i, j): &(i64, i64)| i.pow(2) + j.pow(2);
    let best = points.iter().max_by(|(a, va), (b, vb)| va.cmp(vb).then(far(b).cmp(&far(a))).then(a.cmp(b)));
    best.map(|((i, j), _)| (*i as f64 * CELL_PX, *j as f64 * CELL_PX))
}

/// The pairs that did not stay in place, if they are at least half of all: then the others are the detector's, and
/// their sharp places must not hold the field back.
pub(super) fn moving<'a>(pairs: &[(&'a Star, &'a Star)]) -> Option<Vec<(&'a Star, &'a Star)>> {
    let moves = |(r, c): &&(&Star, &Star)| (c.x_px - r.x_px).hypot(c.y_px - r.y_px) >= STILL_PX;
    let moving: Vec<_> = pairs.iter().filter(moves).copied().collect();
    (moving.len() >= 3 && 2 * moving.len() >= pairs.len()).then_some(moving)
}

/// Stars that are each other's nearest within `reach` px of where the motion puts them, and of like flux. Where the
/// field moved, pairs that stayed in place are left out: they are hot pixels.
pub(super) fn mutual<'a>(
    reference: &'a [Star],
    check: &'a [Star],
    motion: &FieldMotion,
    reach: f64,
) -> Vec<(&'a Star, &'a Star)> {
    let apart = |r: &Star, c: &Star| {
        let (x, y) = motion.apply(r.x_px, r.y_px);
        (c.x_px - x).hypot(c.y_px - y)
    };
    let nearest = |r: &Star| check.iter().min_by(|a, b| apart(r, a).total_cmp(&apart(r, b)));
    let owner = |c: &Star| reference.iter().min_by(|a, b| apart(a, c).total_cmp(&apart(b, c)));
    let is_mutual = |r: &Star, c: &Star| owner(c).is_some_and(|back| std::ptr::eq(back, r));
    let still = |r: &Star| check.iter().any(|c| (c.x_px - r.x_px).hypot(c.y_px - r.y_px) < STILL_PX);
    let moved = motion.dx.hypot(motion.dy) > 3.0 * STILL_PX;
    let mut pairs: Vec<(&Star, &Star)> = reference
        .iter()
        .filter(|r| !(moved && still(r)))
        .filter_map(|r| nearest(r).map(|c| (r, c)))
        .filter(|(r, c)| apart(r, c) <= reach && is_mutual(r, c))
        .collect();
    let ratio = |pair: &(&Star, &Star)| pair.1.flux_adu / pair.0.flux_adu;
    let mut ratios: Vec<f32> = pairs.iter().map(|pair| ratio(pair) as f32).collect();
    if let Some(usual) = crate::background::median_in_place(&mut ratios).map(f64::from) {
        pairs.retain(|pair| (1.0 / FLUX_FACTOR..FLUX_FACTOR).contains(&(ratio(pair) / usual)));
    }
    pairs
}
