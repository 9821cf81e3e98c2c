//! From a similarity to a WCS: pairing all stars again and again, and fitting as much distortion as they prove.
//!
//! Mutual nearest neighbours, weights `1 / (sigma^2 + 0.1^2)`, a limit that closes in to three rms, and by number of
//! stars a similarity, an affine, a cubic radial or a full cubic polynomial.

use units::Angle;

use super::model::{self, Sample};
use super::source::{Stars, brightest};
use super::{Detected, Match, field};
use crate::grid::Grid;
use crate::star::Star;
use crate::tangent::TangentPlane;
use crate::wcs::Wcs;

/// Pairs are sought within this radius at first, px.
const FIRST_PX: f64 = 5.0;
/// ... and never within less, px: centroids of faint stars scatter.
const LEAST_PX: f64 = 1.0;
const ROUNDS: usize = 6;
/// What centroids, catalogue and optics add to a star's own error, px.
const FLOOR_PX: f64 = 0.1;
/// The middle of a saturated star is worse known, px.
const SATURATED_PX: f64 = 0.5;
/// Stars of the frame that take part.
const STARS: usize = 1000;
/// Catalogue stars for each of them in the frame, and fewest and most in its circumscribed circle.
const CATALOGUE: (f64, usize, usize) = (3.0, 60, 3000);

/// A WCS with the stars it was made from.
pub(super) struct Refined {
    pub(super) wcs: Wcs,
    pub(super) matches: Vec<Match>,
    pub(super) rms_px: f64,
}

/// Refines a WCS whose reference pixel is the frame's centre. None when the stars do not fix it.
pub(super) fn refine(detected: &Detected, source: &impl Stars, start: Wcs) -> Option<Refined> {
    let mut stars = field::usable(detected);
    stars.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    stars.truncate(STARS);
    let (width, height) = (detected.width as f64, detected.height as f64);
    let half_diagonal = 0.5 * width.hypot(height);
    let cone = Angle::from_arcseconds(start.scale_arcsec_px() * (1.02 * half_diagonal + FIRST_PX));
    let share = std::f64::consts::PI * half_diagonal * half_diagonal / (width * height);
    let count = ((CATALOGUE.0 * share * stars.len() as f64) as usize).clamp(CATALOGUE.1, CATALOGUE.2);
    let known = brightest(source, start.ra, start.dec, cone, count);
    let mut grid = Grid::new(detected.width, detected.height, FIRST_PX as f32);
    stars.iter().for_each(|star| grid.add(star.x_px as f32, star.y_px as f32));

    let (mut wcs, mut radius, mut rms_px) = (start, FIRST_PX, f64::INFINITY);
    let mut pairs = Vec::new();
    for round in 0..ROUNDS {
        pairs = mutual(&wcs, &known, &stars, &grid, radius);
        let plane = TangentPlane::new(wcs.ra, wcs.dec);
        let sample = |(star, number): &(usize, usize)| {
            let (star, known) = (&stars[*star], &known[*number]);
            let (xi, eta) = plane.project(known.ra, known.dec)?;
            let (u, v) = (star.x_px - wcs.x_px, star.y_px - wcs.y_px);
            Some(Sample { u, v, xi: xi.to_degrees(), eta: eta.to_degrees(), weight: weight(star) })
        };
        let samples: Vec<Sample> = pairs.iter().filter_map(sample).collect();
        // wrong pairs of the first rounds must not bend the frame
        let (fitted, rms) = model::fit(&samples, &wcs, start.sip, half_diagonal, round >= 2)?;
        wcs = fitted;
        rms_px = rms;
        radius = (3.0 * rms).clamp(LEAST_PX, FIRST_PX);
    }
    let places = wcs.all_to_pixels(pairs.iter().map(|(_, k)| (known[*k].ra, known[*k].dec)));
    let describe = |(at, (s, k)): (Option<(f64, f64)>, &(usize, usize))| {
        let (at, star, known) = (at?, &stars[*s], &known[*k]);
        Some(Match { star: *star, known: *known, dx_px: star.x_px - at.0, dy_px: star.y_px - at.1 })
    };
    let matches = places.zip(&pairs).filter_map(describe).collect();
    Some(Refined { wcs, matches, rms_px })
}

fn weight(star: &Star) -> f64 {
    let own = star.x_error_px.max(star.y_error_px);
    let own = if own.is_finite() { own.clamp(0.0, FIRST_PX) } else { SATURATED_PX };
    let more = if star.flags.saturated || star.flags.edge || star.flags.blended { SATURATED_PX } else { 0.0 };
    1.0 / (own * own + more * more + FLOOR_PX * FLOOR_PX)
}

/// Pairs (star, catalogue star), each nearest to the other, within `radius` px.
fn mutual(
    wcs: &Wcs,
    known: &[crate::catalogue::CatalogueStar],
    stars: &[Star],
    grid: &Grid,
    radius: f64,
) -> Vec<(usize, usize)> {
    let mut nearest: Vec<Option<(f64, usize)>> = vec![None; stars.len()];
    let places = wcs.all_to_pixels(known.iter().map(|star| (star.ra, star.dec)));
    for (number, (x, y)) in places.enumerate().filter_map(|(n, at)| at.map(|at| (n, at))) {
        let apart = |n: usize| (stars[n].x_px - x).hypot(stars[n].y_px - y);
        let near = grid.near(x as f32, y as f32, radius as f32).map(|n| (apart(n), n));
        if let Some((far, star)) = near.min_by(|a, b| a.0.total_cmp(&b.0))
            && nearest[star].is_none_or(|(other, _)| far < other)
        {
            nearest[star] = Some((far, number));
        }
    }
    nearest.iter().enumerate().filter_map(|(star, found)| found.map(|(_, number)| (star, number))).collect()
}
