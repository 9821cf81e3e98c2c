//! Frames whose stars are drawn out: how long their trails are, and whether they can be places at all.
//!
//! The middle of a trail is a place only where the trail was found as one. A long one falls into pieces, or its end is
//! taken for its middle, and then all stars agree on a place that is off by the same distance: no count of stars would
//! show it.

use super::Detected;
use crate::star::Star;

/// Half the stars flagged as trailed: then it is the frame that is.
pub(super) const SHARE: f64 = 0.5;
/// Trails longer than so many widths of the stars have no middle that could be trusted.
const LONGEST_WIDTHS: f64 = 6.0;
/// Neighbours along the trail are looked for from so many widths on, up to this distance, within this angle.
const PIECES: (f64, f64, f64) = (1.5, 160.0, 8.0);
/// From this share of the stars on with a neighbour along the trail more than across it, trails lie in pieces.
const IN_PIECES: f64 = 0.3;
/// Stars that are looked at, the brightest.
const STARS: usize = 200;
/// A line of this FWHM has the length of one: of a box the second moment is `length^2 / 12`, and FWHM is 2.35 of its root.
const FWHM_OF_LENGTH: f64 = 0.68;

/// The trails of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameTrails {
    /// Length beyond the width of the stars, px.
    pub(super) length_px: f64,
    /// Whether it is too long for a place.
    pub(super) is_too_long: bool,
}

/// The trails of a frame whose stars are drawn out; None where they are round.
pub(super) fn of(detected: &Detected) -> Option<FrameTrails> {
    let is_trailed = detected.quality.is_some_and(|quality| quality.trailed);
    let mut stars: Vec<&Star> = detected.stars.iter().filter(|star| !star.flags.cosmic && is_whole(star)).collect();
    let trailed = stars.iter().filter(|star| star.flags.trailed).count();
    if stars.is_empty() || !(is_trailed || trailed as f64 >= SHARE * stars.len() as f64 && trailed >= 3) {
        return None;
    }
    stars.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    stars.truncate(STARS);
    let axes = |star: &&Star| {
        let root = (1.0 - star.ellipticity).max(1e-3).sqrt();
        (star.fwhm_px * root, star.fwhm_px / root)
    };
    let width = median(stars.iter().map(|star| axes(star).0));
    let length_px = median(stars.iter().map(|star| {
        let (minor, major) = axes(star);
        (major * major - minor * minor).max(0.0).sqrt() / FWHM_OF_LENGTH
    }));
    let is_too_long = length_px > LONGEST_WIDTHS * width || pieces(&stars, width) > IN_PIECES;
    Some(FrameTrails { length_px, is_too_long })
}

fn is_whole(star: &Star) -> bool {
    [star.x_px, star.y_px, star.fwhm_px, star.ellipticity, star.angle_deg].iter().all(|v| v.is_finite())
        && (0.0..1.0).contains(&star.ellipticity)
}

/// How many more of the stars have a neighbour along the trails than across them, as a share.
fn pieces(stars: &[&Star], width: f64) -> f64 {
    // directions repeat after half a turn: their mean is that of the doubled angles
    let (sin, cos) = stars.iter().fold((0.0, 0.0), |(sin, cos), star| {
        let doubled = (2.0 * star.angle_deg).to_radians();
        (sin + star.ellipticity * doubled.sin(), cos + star.ellipticity * doubled.cos())
    });
    let along = 0.5 * f64::atan2(sin, cos);
    let with_neighbour = |direction: f64| {
        let (sin, cos) = direction.sin_cos();
        let (nearest, furthest, angle) = (PIECES.0 * width, PIECES.1, PIECES.2.to_radians().tan());
        let has = |star: &&&Star| {
            stars.iter().any(|other| {
                let (dx, dy) = (other.x_px - star.x_px, other.y_px - star.y_px);
                let (far, off) = ((dx * cos + dy * sin).abs(), (dy * cos - dx * sin).abs());
                (nearest..furthest).contains(&far) && off < far * angle
            })
        };
        stars.iter().filter(has).count() as f64
    };
    let across = along + std::f64::consts::FRAC_PI_2;
    (with_neighbour(along) - with_neighbour(across)) / stars.len().max(1) as f64
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}
