//! One way to lay the sky over the frame, and how many stars agree with it.

use super::chance;
use super::field::FrameStars;
use super::similarity::{Place, PlacePair, Similarity};
use super::tile::Tile;

/// Radius of the first count of stars that agree, px.
pub(super) const SEARCH_PX: f64 = 4.0;
/// Above this number of stars the wide radius is kept for the second count too: it leaves room for distortion.
const MANY: usize = 20;
/// How much a lens may change the mean scale of the frame against that at its centre, as a share.
const BENT: f64 = 0.01;

/// Fewest stars that a blind search believes: four and two that agree with them.
pub(super) const FEWEST_BLIND: usize = 6;

/// A hypothesis that was refitted and counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    pub(super) similarity: Similarity,
    /// Distinct stars that agree, K.
    pub(super) matched: usize,
    /// Root of their mean squared distance (both axes together), px.
    pub(super) rms_px: f64,
    /// Probability that so many agree by chance in one hypothesis.
    pub(super) chance: f64,
    by: By,
}

/// How a hypothesis was made: the stars that made it prove nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum By {
    /// One star; rotation and scale are known, only the shift is free.
    Shift,
    /// Two stars.
    Pair,
    /// Four stars of the same shape.
    Pattern,
}

impl By {
    fn stars(self) -> usize {
        match self {
            By::Shift => 1,
            By::Pair => 2,
            By::Pattern => 4,
        }
    }
}

/// What has to be known to accept one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Acceptance {
    pub(super) hypotheses: u64,
    pub(super) scale_tolerance: f64,
}

impl Candidate {
    /// Refits a hypothesis on the stars within 4 px and counts again. None when fewer than two stars agree.
    pub(super) fn examine(field: &FrameStars, tile: &Tile, start: Similarity, by: By) -> Option<Self> {
        let few = (0.5 * field.fwhm_px).clamp(1.5, 2.0);
        let radius = if field.spots.len() > MANY { SEARCH_PX } else { few };
        let mut similarity = start;
        // the first fit is pulled by what lies at the edge of the radius
        for reach in [SEARCH_PX, radius.max(0.75 * SEARCH_PX), radius] {
            let (pairs, _) = agreeing(field, tile, &similarity, reach);
            if pairs.len() < 2 {
                return None;
            }
            similarity = similarity.fitted(&pairs, by == By::Shift)?;
        }
        let (pairs, inside) = agreeing(field, tile, &similarity, radius);
        let matched = pairs.len();
        let squares = pairs.iter().map(|(place, z)| {
            let at = similarity.apply(*place);
            (at.0 - z.0).powi(2) + (at.1 - z.1).powi(2)
        });
        let rms_px = (squares.sum::<f64>() / matched.max(1) as f64).sqrt();
        // what hides a part of the frame hides the catalogue's stars behind it too; a trail lengthens what counts as near
        let open = chance::near_one(inside.all, radius, field.area());
        let seen = chance::near_one(inside.seen, radius, field.seen_share() * field.area());
        let p = (open.max(seen) * (1.0 + field.along_px / radius)).min(1.0);
        let trials = field.spots.len().checked_sub(by.stars())?;
        let chance = chance::at_least(matched.checked_sub(by.stars())?, trials, p);
        Some(Self { similarity, matched, rms_px, chance, by })
    }

    /// Probability of a false alarm after so many hypotheses.
    pub(super) fn false_alarm(&self, hypotheses: u64) -> f64 {
        self.chance * hypotheses.max(1) as f64
    }

    /// Whether it is believed (docs/formulae.md, "Probability of agreement by chance").
    pub(super) fn is_accepted(&self, field: &FrameStars, acceptance: &Acceptance) -> bool {
        let (fewest, greatest) = match self.by {
            By::Shift => (3, 1e-4),
            By::Pair => (4, 1e-6),
            By::Pattern => (FEWEST_BLIND, 1e-6),
        };
        // with many stars distortion is fitted first; then rms and scale at the centre are judged again
        let many = field.spots.len() > MANY;
        let straight = many || self.rms_px <= field.greatest_rms_px();
        let tolerance = acceptance.scale_tolerance + if many { BENT } else { 0.0 };
        self.matched >= fewest
            && self.false_alarm(acceptance.hypotheses) < greatest
            && (self.similarity.size() - 1.0).abs() <= tolerance
            && straight
    }
}

/// How many catalogue stars lie in the frame.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Inside {
    all: usize,
    /// Those where the frame shows stars.
    seen: usize,
}

/// The pairs within `radius` px, each star in one pair at most, and the number of catalogue stars in the frame.
pub(super) fn agreeing(
    field: &FrameStars,
    tile: &Tile,
    similarity: &Similarity,
    radius: f64,
) -> (Vec<PlacePair>, Inside) {
    let mut inside = Inside::default();
    // nearest catalogue star of each star of the frame
    let mut nearest: Vec<Option<(f64, Place)>> = vec![None; field.spots.len()];
    for place in &tile.stars {
        let (x, y) = similarity.apply(*place);
        if !field.holds(x, y) {
            continue;
        }
        inside.all += 1;
        inside.seen += usize::from(field.shows(x, y));
        if let Some((spot, squared)) = field.nearest(x, y, radius)
            && nearest[spot].is_none_or(|(other, _)| squared < other)
        {
            nearest[spot] = Some((squared, *place));
        }
    }
    let pair = |(n, found): (usize, &Option<(f64, Place)>)| {
        found.map(|(_, place)| (place, (field.spots[n].x, field.spots[n].y)))
    };
    (nearest.iter().enumerate().filter_map(pair).collect(), inside)
}
