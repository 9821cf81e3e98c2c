//! The order of the search: little first, then more, until something is found that chance does not explain.

use std::ops::Range;

use units::Angle;

use super::Detected;
use super::candidate::{Acceptance, Candidate};
use super::differences::best_shift;
use super::failure::{FEWEST, FEWEST_KNOWN, FailedSearch, NoSolution};
use super::field::FrameStars;
use super::hint::{Hint, KNOWN_OPTICS, LearnedOptics};
use super::refine::refine;
use super::scales;
use super::similarity::Similarity;
use super::solution::{Level, Solution};
use super::source::Stars;
use super::tile::{Tile, covering};
use super::votes::{self, CERTAIN, Effort};
use crate::tangent::{TangentPlane, separation};
use crate::wcs::Wcs;

/// Bright stars of the frame whose pairs vote: the first ones, and those that then join in, each with all before it.
const FIRST_VOTERS: Range<usize> = 0..8;
const MORE_VOTERS: Range<usize> = 8..15;
const ALL_VOTERS: Range<usize> = 0..15;
/// ... and those that vote where brightness is asked too: there are far fewer hypotheses, and among false detections the
/// first true pair comes late.
const RANKED_VOTERS: Range<usize> = 0..24;
/// Catalogue stars for each star of the frame: as many, and many more, where stars or catalogue lack some.
const DEPTHS: [f64; 2] = [1.0, 3.0];
/// Shares of the frame's longer side within which its centre is looked for at level 0.
const SHIFTS: [f64; 3] = [0.1, 0.35, 1.05];
/// The steps of level 1: voters, whether by rank, depth, and in longer sides how far the centre is looked for (a little more than one,
/// as the hinted scale may be wrong) and in tiles of which radius. Small tiles last: a large one of many stars reaches
/// the greatest number of them before it reaches the frame's depth.
const FIELDS: [(Range<usize>, bool, f64, f64, f64); 9] = [
    (RANKED_VOTERS, true, DEPTHS[0], 0.5, 0.5),
    (RANKED_VOTERS, true, DEPTHS[0], 1.05, 1.05),
    (FIRST_VOTERS, false, DEPTHS[0], 0.5, 0.5),
    (FIRST_VOTERS, false, DEPTHS[0], 1.05, 1.05),
    (MORE_VOTERS, false, DEPTHS[0], 0.5, 0.5),
    (MORE_VOTERS, false, DEPTHS[0], 1.05, 1.05),
    (ALL_VOTERS, false, DEPTHS[1], 0.5, 0.5),
    (ALL_VOTERS, false, DEPTHS[1], 1.05, 1.05),
    (ALL_VOTERS, false, DEPTHS[1], 1.05, 0.5),
];
/// Those of them that other scales are worth: the quick ones.
const RANKED_STEPS: usize = 2;
/// Those of them that come before other scales and places; the last one takes longer than all others together.
const QUICK_STEPS: usize = FIELDS.len() - 1;
/// Up to these shares of all work: the quick steps, other scales, the quick step around; then what remains.
const SHARES: [f64; 3] = [0.3, 0.7, 0.9];
/// Work of laying out a piece of the sky, in hypotheses: reading it, and so many of its pairs of stars each.
const TILE_WORK: u64 = 5_000;
const PAIRS_WORK: u64 = 10;
/// The steps of level 2: voters, whether by rank.
const AROUND: [(Range<usize>, bool); 3] = [(RANKED_VOTERS, true), (FIRST_VOTERS, false), (MORE_VOTERS, false)];
/// Error of a place at the frame's edge that a slightly wrong rotation may cause, px ...
const TURN_PX: f64 = 2.0;
/// ... and most steps to either side that are tried to keep it.
const MOST_TURNS: f64 = 12.0;
/// Radius of a tile of level 2 in longer sides ...
const TILE: f64 = 1.5;
/// ... but not more than this: a larger plane is not flat enough for one similarity.
const FLAT_DEG: f64 = 2.0;
/// Greatest number of tiles from the hint to the edge of the search.
const MOST_TILES: f64 = 50.0;
/// Two solutions whose centres are nearer than this are one, px.
const SAME_PX: f64 = 10.0;

/// A candidate as a WCS: the same for all tiles.
#[derive(Debug, Clone, Copy)]
struct FoundWcs {
    candidate: Candidate,
    wcs: Wcs,
}

/// A search under way.
pub(super) struct SolveSearch<'a, S> {
    detected: &'a Detected<'a>,
    hint: &'a Hint,
    source: &'a S,
    field: FrameStars,
    /// Size of a pixel, rad.
    scale: f64,
    hypotheses: u64,
    /// Work so far, and at which the present part of the search ends, in hypotheses.
    work: u64,
    limit: u64,
    searched: Angle,
    /// Scales that were tried in addition to the hinted one.
    others_arcsec_px: Vec<f64>,
    best: Option<FoundWcs>,
    /// The best one at another place.
    rival: Option<FoundWcs>,
    ambiguous: Option<NoSolution>,
}

impl<'a, S: Stars> SolveSearch<'a, S> {
    pub(super) fn new(detected: &'a Detected<'a>, hint: &'a Hint, source: &'a S) -> Self {
        let field = FrameStars::new(detected, hint);
        let scale = Angle::from_arcseconds(hint.scale_arcsec_px).radians();
        Self {
            detected,
            hint,
            source,
            field,
            scale,
            hypotheses: 0,
            work: 0,
            limit: hint.most_hypotheses,
            searched: Angle::default(),
            others_arcsec_px: Vec::new(),
            best: None,
            rival: None,
            ambiguous: None,
        }
    }

    /// Level 0, 1, 2, until a solution is believed.
    pub(super) fn run(&mut self) -> Option<Solution> {
        if let Some(learned) = self.hint.learned
            && self.field.spots.len() >= FEWEST_KNOWN
            && let Some(solution) = self.shift(&learned)
        {
            return Some(solution);
        }
        if self.field.spots.len() < FEWEST {
            return None;
        }
        let most = self.hint.most_hypotheses;
        let [field, mut scales, around] = SHARES.map(|share| (share * most as f64) as u64);
        // what nobody needs for places around goes to the scales
        if self.hint.furthest <= self.angle(self.field.longer_side()) {
            scales = around;
        }
        self.limit = field;
        self.hinted_field(0..QUICK_STEPS, Level::Field)
            .or_else(|| {
                self.limit = scales;
                self.other_scales()
            })
            .or_else(|| {
                self.limit = around;
                self.around(0..1)
            })
            .or_else(|| {
                self.limit = most;
                self.hinted_field(QUICK_STEPS..FIELDS.len(), Level::Field)
            })
            .or_else(|| self.around(1..AROUND.len()))
    }

    fn is_spent(&self) -> bool {
        self.work >= self.limit
    }

    /// What there is to say about a search that found nothing.
    pub(super) fn attempt(&mut self) -> FailedSearch {
        let (stars, hypotheses) = (self.field.spots.len(), self.hypotheses);
        let others_arcsec_px = std::mem::take(&mut self.others_arcsec_px);
        FailedSearch { stars, hypotheses, searched: self.searched, others_arcsec_px, ambiguous: self.ambiguous.take() }
    }

    /// Level 0.
    fn shift(&mut self, learned: &LearnedOptics) -> Option<Solution> {
        let mut cells = 0;
        for share in SHIFTS {
            let radius = share * self.field.longer_side();
            let tile = self.tile((self.hint.ra, self.hint.dec), radius, DEPTHS[1]);
            self.searched = self.angle(radius);
            let is_certain = |found: &Candidate, cells_here| found.false_alarm(cells + cells_here) < CERTAIN;
            let (candidate, cells_here) = best_shift(&self.field, &tile, &self.turns(learned, &tile), is_certain);
            cells += cells_here;
            // cells are no hypotheses of the other levels: what they offer is judged here
            if let Some(candidate) = candidate
                && candidate.is_accepted(&self.field, &self.acceptance(cells))
                && let Some(wcs) = self.wcs(&tile, &candidate.similarity)
                && let Some(solution) = self.refined(&FoundWcs { candidate, wcs }, cells, Level::Shift)
            {
                return Some(solution);
            }
        }
        None
    }

    /// The learned rotation as it is seen from the tile's centre. It was learned against north at the frame's centre,
    /// and north turns on the way there, by tan(dec) per radian to the east: one similarity for each step of that.
    /// Near a pole it turns too much to be worth it; level 1 does not mind.
    fn turns(&self, learned: &LearnedOptics, tile: &Tile) -> Vec<Similarity> {
        let arm = 0.5 * self.field.diagonal();
        let steepness = (self.hint.dec.abs().radians() + tile.radius * self.scale).min(1.57).tan();
        let steps = (tile.radius * self.scale * steepness * arm / TURN_PX).ceil();
        if steps > MOST_TURNS {
            return Vec::new();
        }
        let count = steps as i32;
        let turn = |n: i32| {
            let east = tile.radius * f64::from(n) / steps.max(1.0);
            let here = tile.direction((east, 0.0));
            let (xi, eta) = tile.plane.project(here.0, here.1)?;
            let (ra, dec) = (here.0, here.1 + Angle::from_arcseconds(1.0));
            let (north_xi, north_eta) = tile.plane.project(ra, dec)?;
            let turned = Angle::from_radians((north_xi - xi).atan2(north_eta - eta));
            let rotation_deg = learned.rotation_deg + turned.degrees();
            Some(Similarity::learned(&LearnedOptics { rotation_deg, ..*learned }, self.hint.scale_arcsec_px))
        };
        // the hint is most probably right: from the middle outwards
        let outwards = std::iter::once(0).chain((1..=count).flat_map(|n| [n, -n]));
        outwards.filter_map(turn).collect()
    }

    /// Level 1.
    fn hinted_field(&mut self, steps: Range<usize>, level: Level) -> Option<Solution> {
        let centre = (self.hint.ra, self.hint.dec);
        let side = self.field.longer_side();
        for (voters, by_rank, depth, share, tile) in FIELDS.into_iter().take(steps.end).skip(steps.start) {
            if self.is_spent() {
                return None;
            }
            let stars = self.field.spots.len();
            if voters.start >= stars || (tile < share && stars <= ALL_VOTERS.end) {
                continue;
            }
            let (radius, furthest) = (self.angle(tile * side), self.angle(share * side));
            self.searched = if furthest > self.searched { furthest } else { self.searched };
            // one plane where it is flat enough, else several
            let flat = tile >= share && radius.degrees() <= FLAT_DEG;
            let small = if radius.degrees() <= FLAT_DEG { radius } else { self.tile_radius() };
            let tiles = if flat { vec![centre] } else { covering(centre, small, furthest) };
            for at in tiles {
                if self.vote(at, self.pixels(small), voters.clone(), by_rank, depth) || self.is_spent() {
                    break;
                }
            }
            if let Some(solution) = self.believed(level) {
                return Some(solution);
            }
        }
        None
    }

    /// Level 1 at scales other than the hinted one.
    fn other_scales(&mut self) -> Option<Solution> {
        if !self.hint.wrong_scales {
            return None;
        }
        for (n, factor) in scales::FACTORS.into_iter().enumerate() {
            if self.is_spent() {
                break;
            }
            // each gets its part of what is left, so that a wide field does not keep the others from being tried
            let left = (scales::FACTORS.len() - n) as u64;
            let limit = self.work + (self.limit - self.work).div_ceil(left);
            let hint = Hint {
                scale_arcsec_px: factor * self.hint.scale_arcsec_px,
                scale_tolerance: scales::TOLERANCE,
                learned: None,
                ..self.hint.clone()
            };
            // what was tried before costs belief here too
            let mut search =
                SolveSearch { hypotheses: self.hypotheses, ..SolveSearch::new(self.detected, &hint, self.source) };
            (search.work, search.limit) = (self.work, limit);
            let found = search.hinted_field(0..RANKED_STEPS, Level::Scale);
            (self.hypotheses, self.work) = (search.hypotheses, search.work);
            if found.is_some() {
                return found;
            }
            self.others_arcsec_px.push(hint.scale_arcsec_px);
        }
        self.others_arcsec_px.sort_by(f64::total_cmp);
        None
    }

    /// A candidate of another's search, refined, if it is believed after so many hypotheses.
    pub(super) fn judged(&self, tile: &Tile, candidate: Candidate, hypotheses: u64, level: Level) -> Option<Solution> {
        if !candidate.is_accepted(&self.field, &self.acceptance(hypotheses)) {
            return None;
        }
        let wcs = self.wcs(tile, &candidate.similarity)?;
        self.refined(&FoundWcs { candidate, wcs }, hypotheses, level)
    }

    /// Level 2.
    fn around(&mut self, steps: Range<usize>) -> Option<Solution> {
        let radius = self.tile_radius();
        if self.hint.furthest <= self.angle(self.field.longer_side()) {
            return None;
        }
        let centre = (self.hint.ra, self.hint.dec);
        let tiles = covering(centre, radius, self.hint.furthest);
        for (voters, by_rank) in AROUND.into_iter().take(steps.end).skip(steps.start) {
            for at in &tiles {
                if self.is_spent() {
                    return self.believed(Level::Around);
                }
                let far = separation(centre, *at);
                self.searched = if far > self.searched { far } else { self.searched };
                let certain = self.vote(*at, self.pixels(radius), voters.clone(), by_rank, DEPTHS[0]);
                if certain && let Some(solution) = self.believed(Level::Around) {
                    return Some(solution);
                }
            }
            if let Some(solution) = self.believed(Level::Around) {
                return Some(solution);
            }
        }
        None
    }

    /// Searches one tile; true when something certain was found.
    fn vote(&mut self, at: (Angle, Angle), radius: f64, voters: Range<usize>, by_rank: bool, depth: f64) -> bool {
        let tile = self.tile(at, radius, depth);
        let known = self.hint.mirrored.or(self.hint.learned.map(|learned| learned.mirrored));
        // each hypothesis costs belief: what was asked is not asked again
        let effort = Effort {
            voters,
            by_rank,
            scale_tolerance: self.hint.scale_tolerance,
            parities: match known {
                None => &[false, true],
                Some(false) => &[false],
                Some(true) => &[true],
            },
            most_hypotheses: self.hypotheses + self.limit.saturating_sub(self.work),
        };
        let mut hypotheses = self.hypotheses;
        let (mut best, mut rival) = (self.best, self.rival);
        let found = votes::search(&self.field, &tile, &effort, &mut hypotheses, |candidate, tested| {
            // nothing that is worse than both needs a place
            if rival.is_some_and(|rival| candidate.chance >= rival.candidate.chance) {
                return false;
            }
            let Some(wcs) = self.wcs(&tile, &candidate.similarity) else { return false };
            let new = FoundWcs { candidate, wcs };
            let same = |other: &FoundWcs| self.is_same(&new, other);
            if best.as_ref().is_none_or(&same) {
                best = best.filter(|b| b.candidate.chance <= candidate.chance).or(Some(new));
            } else if best.is_some_and(|b| candidate.chance < b.candidate.chance) {
                rival = best;
                best = Some(new);
            } else {
                rival = Some(new);
            }
            candidate.false_alarm(tested) < CERTAIN && candidate.is_accepted(&self.field, &self.acceptance(tested))
        });
        let pairs = (tile.stars.len() * tile.stars.len() / 2) as u64;
        self.work += TILE_WORK + pairs / PAIRS_WORK + (hypotheses - self.hypotheses);
        (self.best, self.rival, self.hypotheses) = (best, rival, hypotheses);
        found
    }

    /// The best candidate so far, refined, if it is believed and no other is.
    fn believed(&mut self, level: Level) -> Option<Solution> {
        let acceptance = self.acceptance(self.hypotheses);
        let best = self.best.filter(|best| best.candidate.is_accepted(&self.field, &acceptance))?;
        if best.candidate.false_alarm(self.hypotheses) >= CERTAIN
            && let Some(rival) = self.rival
            && rival.candidate.is_accepted(&self.field, &acceptance)
        {
            let apart = separation((best.wcs.ra, best.wcs.dec), (rival.wcs.ra, rival.wcs.dec));
            self.ambiguous = Some(NoSolution::Ambiguous { apart, matched: rival.candidate.matched });
            return None;
        }
        let solution = self.refined(&best, self.hypotheses, level);
        if solution.is_none() {
            // what does not hold on all stars must not hide what comes later
            self.best = self.rival.take();
        }
        solution
    }

    fn refined(&self, found: &FoundWcs, hypotheses: u64, level: Level) -> Option<Solution> {
        let refined = refine(self.detected, self.source, found.wcs)?;
        let wcs = refined.wcs;
        let drift = self.shifted_px(&found.wcs, &wcs);
        let scale = wcs.scale_arcsec_px() / self.hint.scale_arcsec_px;
        let sound = refined.matches.len() >= FEWEST_KNOWN
            && (scale - 1.0).abs() <= 1.02 * self.acceptance(hypotheses).scale_tolerance
            && 2 * refined.matches.len() >= found.candidate.matched
            && refined.rms_px <= self.field.greatest_rms_px()
            && drift < SAME_PX;
        sound.then(|| Solution {
            ra: wcs.ra,
            dec: wcs.dec,
            scale_arcsec_px: wcs.scale_arcsec_px(),
            rotation_deg: wcs.rotation_deg(),
            mirrored: wcs.mirrored(),
            matched: refined.matches.len(),
            rms_px: refined.rms_px,
            false_alarm: found.candidate.false_alarm(hypotheses),
            wcs,
            level,
            hypotheses,
            matches: refined.matches,
        })
    }

    fn is_same(&self, one: &FoundWcs, other: &FoundWcs) -> bool {
        one.wcs.mirrored() == other.wcs.mirrored() && self.shifted_px(&one.wcs, &other.wcs) < SAME_PX && {
            let corner = |wcs: &Wcs| wcs.pixel_to_sky(0.0, 0.0);
            self.pixels(separation(corner(&one.wcs), corner(&other.wcs))) < 2.0 * SAME_PX
        }
    }

    /// Distance of two centres, px.
    fn shifted_px(&self, one: &Wcs, other: &Wcs) -> f64 {
        self.pixels(separation((one.ra, one.dec), (other.ra, other.dec)))
    }

    /// A similarity as a WCS with its reference pixel in the frame's centre.
    fn wcs(&self, tile: &Tile, similarity: &Similarity) -> Option<Wcs> {
        const ARM_PX: f64 = 50.0;
        let (ra, dec) = tile.direction(similarity.invert((0.0, 0.0)));
        let plane = TangentPlane::new(ra, dec);
        let place = |x: f64, y: f64| {
            let (ra, dec) = tile.direction(similarity.invert((x, y)));
            plane.project(ra, dec)
        };
        let slope = |plus: (f64, f64), minus: (f64, f64)| {
            [plus.0 - minus.0, plus.1 - minus.1].map(|step| (step / (2.0 * ARM_PX)).to_degrees())
        };
        let x = slope(place(ARM_PX, 0.0)?, place(-ARM_PX, 0.0)?);
        let y = slope(place(0.0, ARM_PX)?, place(0.0, -ARM_PX)?);
        Some(Wcs {
            ra,
            dec,
            x_px: 0.5 * (self.field.width - 1.0),
            y_px: 0.5 * (self.field.height - 1.0),
            cd_deg_px: [[x[0], y[0]], [x[1], y[1]]],
            sip: self.hint.learned.and_then(|learned| learned.sip),
        })
    }

    fn tile(&self, at: (Angle, Angle), radius: f64, depth: f64) -> Tile {
        Tile::new(self.source, at, &self.field, self.scale, radius, depth)
    }

    fn tile_radius(&self) -> Angle {
        let side = self.angle(self.field.longer_side());
        // a tiny frame must not need a million tiles
        let least = self.hint.furthest.degrees() / MOST_TILES;
        let wide = (side * TILE).degrees().max(least).min(FLAT_DEG).max(0.5 * side.degrees());
        Angle::from_degrees(wide)
    }

    fn acceptance(&self, hypotheses: u64) -> Acceptance {
        Acceptance { hypotheses, scale_tolerance: self.hint.scale_tolerance.max(KNOWN_OPTICS) }
    }

    fn angle(&self, px: f64) -> Angle {
        Angle::from_radians((px * self.scale).atan())
    }

    fn pixels(&self, angle: Angle) -> f64 {
        angle.radians() / self.scale
    }
}
