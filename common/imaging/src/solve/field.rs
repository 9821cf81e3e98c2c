//! The stars of the frame, made ready for matching.

use super::hint::Hint;
use super::seen::StarArea;
use super::{Detected, trail};
use crate::grid::Grid;
use crate::star::{Star, spread_evenly};

/// Stars that take part in matching.
const STARS: usize = 60;
/// Stars of a frame that is hidden in part keep so much of their mean distance: the edge of what hides is full of false
/// ones.
const APART: f64 = 0.3;
/// ... of which so many are looked at.
const THINNED: usize = 2000;
/// Greatest reach of a question about neighbours, px.
const REACH_PX: f32 = 16.0;

/// A star of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    /// Place, px from the frame's centre, without the distortion that is known.
    pub(super) x: f64,
    pub(super) y: f64,
}

/// Up to 60 stars spread over the frame, the brightest first.
pub(super) struct FrameStars {
    pub(super) spots: Vec<Spot>,
    pub(super) width: f64,
    pub(super) height: f64,
    /// Width of the stars, px.
    pub(super) fwhm_px: f64,
    /// The part of the frame in which there are stars.
    seen: StarArea,
    /// What trails add to the error of a place along them, px.
    pub(super) along_px: f64,
    grid: Grid,
}

impl FrameStars {
    pub(super) fn new(detected: &Detected, hint: &Hint) -> Self {
        let (width, height) = (detected.width as f64, detected.height as f64);
        let usable = usable(detected);
        let middle = (0.5 * (width - 1.0), 0.5 * (height - 1.0));
        let places: Vec<_> = usable.iter().map(|star| (star.x_px - middle.0, star.y_px - middle.1)).collect();
        let seen = StarArea::new(&places, width, height);
        let mut chosen = if seen.share < 1.0 {
            let apart = APART * (seen.share * width * height / STARS as f64).sqrt();
            spread_evenly(&thinned(&usable, apart), detected.width, detected.height, STARS)
        } else {
            spread_evenly(&usable, detected.width, detected.height, STARS)
        };
        chosen.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
        let sip = hint.learned.and_then(|learned| learned.sip);
        let spot = |star: &Star| {
            let (x, y) = (star.x_px - 0.5 * (width - 1.0), star.y_px - 0.5 * (height - 1.0));
            let (x, y) = sip.map_or((x, y), |sip| sip.apply(x, y));
            Spot { x, y }
        };
        let spots: Vec<Spot> = chosen.iter().map(spot).collect();
        let mut grid = Grid::new(detected.width, detected.height, REACH_PX);
        spots.iter().for_each(|s| grid.add((s.x + 0.5 * width) as f32, (s.y + 0.5 * height) as f32));
        let mut widths: Vec<f32> = chosen.iter().map(|star| star.fwhm_px as f32).filter(|w| w.is_finite()).collect();
        let fwhm_px = crate::background::median_in_place(&mut widths).map_or(3.0, f64::from);
        let along_px = trail::of(detected).map_or(0.0, |trail| trail.length_px);
        Self { spots, width, height, fwhm_px, seen, along_px, grid }
    }

    /// Share of the frame in which there are stars: 1, or less where a part is hidden.
    pub(super) fn seen_share(&self) -> f64 {
        self.seen.share
    }

    /// Whether a place (px from the centre) is inside of the frame where it shows stars.
    pub(super) fn shows(&self, x: f64, y: f64) -> bool {
        self.holds(x, y) && self.seen.holds(x, y, self.width, self.height)
    }

    pub(super) fn area(&self) -> f64 {
        self.width * self.height
    }

    pub(super) fn diagonal(&self) -> f64 {
        self.width.hypot(self.height)
    }

    pub(super) fn longer_side(&self) -> f64 {
        self.width.max(self.height)
    }

    /// Greatest rms of a solution that is believed, px.
    pub(super) fn greatest_rms_px(&self) -> f64 {
        (0.5 * self.fwhm_px).max(1.5)
    }

    /// Whether a place (px from the centre) is inside of the frame.
    pub(super) fn holds(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.width && y.abs() <= 0.5 * self.height
    }

    /// The star nearest to a place (px from the centre) within `reach` px, and the square of its distance.
    pub(super) fn nearest(&self, x: f64, y: f64, reach: f64) -> Option<(usize, f64)> {
        let (column, row) = ((x + 0.5 * self.width) as f32, (y + 0.5 * self.height) as f32);
        let near = self.grid.near(column, row, reach as f32 + 0.01);
        let squared = |n: usize| (self.spots[n].x - x).powi(2) + (self.spots[n].y - y).powi(2);
        let nearest = near.map(|n| (n, squared(n))).min_by(|a, b| a.1.total_cmp(&b.1));
        nearest.filter(|(_, squared)| *squared <= reach * reach)
    }
}

/// The stars that may be those of a catalogue: with a place inside of the frame, neither cosmic rays nor pieces of a
/// satellite's trail.
pub(super) fn usable(detected: &Detected) -> Vec<Star> {
    let inside = |at: f64, length: usize| (-0.5..=length as f64 - 0.5).contains(&at);
    let sound = |s: &&Star| inside(s.x_px, detected.width) && inside(s.y_px, detected.height) && s.flux_adu.is_finite();
    let stars: Vec<Star> = detected.stars.iter().filter(sound).filter(|s| !s.flags.cosmic).copied().collect();
    let trailed = stars.iter().filter(|star| star.flags.trailed).count();
    // then it is the frame that is, and they are all there are
    if trailed as f64 >= trail::SHARE * stars.len() as f64 {
        return stars;
    }
    stars.into_iter().filter(|star| !star.flags.trailed).collect()
}

/// The stars without those that have a brighter one nearby.
fn thinned(stars: &[Star], apart_px: f64) -> Vec<Star> {
    let mut order: Vec<&Star> = stars.iter().collect();
    order.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    let mut retained: Vec<Star> = Vec::new();
    // the brightest few hundred are all that ever take part
    for star in order.into_iter().take(THINNED) {
        if retained.iter().all(|other| (other.x_px - star.x_px).hypot(other.y_px - star.y_px) >= apart_px) {
            retained.push(*star);
        }
    }
    retained
}
