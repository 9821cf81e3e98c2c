//! Level 3: nothing is known; shapes of four stars are looked up in tables of the whole sky.
//!
//! Each four of the frame's brightest stars have a shape (`pattern`) that is looked up in the tables (`pattern_table`),
//! the widest first: each table serves fields of about two to five times its size. What is found fixes place, scale,
//! rotation and parity, is laid over the frame's other stars, and is believed as the other levels are: by the
//! probability that so many others agree by chance, times the number of shapes that were found.

use std::sync::OnceLock;

use units::Angle;

use super::Detected;
use super::candidate::{By, Candidate, FEWEST_BLIND, agreeing};
use super::failure::NoSolution;
use super::field::FrameStars;
use super::hint::Hint;
use super::pattern::{Shape, shapes};
use super::pattern_table::{Pattern, Table, fours, lengths};
use super::search::SolveSearch;
use super::similarity::{Place, Similarity};
use super::solution::{Level, Solution};
use super::source::Stars;
use super::tile::Tile;
use super::votes::CERTAIN;
use crate::tangent::{TangentPlane, separation};

/// HEALPix orders of the tables, the widest first: AB of 8.8 deg and more down to 0.27 deg and more.
const ORDERS: [u8; 6] = [2, 3, 4, 5, 6, 7];
/// Brightest stars of the frame that form patterns.
const STARS: usize = 30;
/// AB in the frame, as shares of its shorter side and of its diagonal.
const SIDES: (f64, f64) = (0.15, 0.9);
/// Tolerance of a code: a share of AB for what lens and projection bend ...
const BENT: f64 = 0.003;
/// ... and an error of the places, px.
const PLACE_PX: f64 = 0.7;
/// Longest side of a frame that is believed, deg: narrower ones have no patterns, wider ones are not flat.
const FIELDS_DEG: (f64, f64) = (0.3, 60.0);
/// Catalogue stars of a frame for each of its own.
const DEPTH: f64 = 1.5;
/// How far from the four stars the others are fitted first, in lengths of AB.
const GROWTH: [f64; 3] = [0.7, 1.4, 2.8];
/// Tolerance of the scale once a pattern has given it, as a share.
const STATED: f64 = 0.03;

/// What is known of a frame before a blind search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blind {
    /// Least and greatest size of a (binned) pixel, arcsec; None where nothing is known.
    pub scales_arcsec_px: Option<(f64, f64)>,
    /// Patterns that are looked at more closely before the search gives up; some 5,000 to 10,000 in a second.
    pub most_candidates: u64,
    /// Where the frame's centre must be; None: anywhere.
    pub within: Option<Within>,
}

/// A part of the sky, of any size up to all of it: for hints that are wider than [`Hint::furthest`] may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Within {
    /// ICRS right ascension of its middle.
    pub ra: Angle,
    /// ICRS declination of its middle.
    pub dec: Angle,
    /// How far from the middle the frame's centre may be.
    pub furthest: Angle,
}

impl Within {
    fn holds(&self, at: (Angle, Angle)) -> bool {
        separation((self.ra, self.dec), at) <= self.furthest
    }
}

impl Default for Blind {
    fn default() -> Self {
        Self { scales_arcsec_px: None, most_candidates: 30_000, within: None }
    }
}

/// The whole sky of a catalogue, in which a frame of 1 deg and more is found without a hint.
///
/// Tables are made when they are first needed, the widest in some 0.1 s and the narrowest in a few seconds, from the
/// brightest stars: a catalogue to magnitude 12 serves as well as a deeper one. All of them take 70 MB.
#[derive(Debug)]
pub struct AllSky<S> {
    stars: S,
    tables: [OnceLock<Table>; ORDERS.len()],
}

/// The best pattern so far.
struct FoundPattern {
    candidate: Candidate,
    tile: Tile,
    /// Size of a pixel, rad.
    scale: f64,
}

/// What a blind search has done so far.
#[derive(Default)]
struct Progress {
    candidates: u64,
    best: Option<FoundPattern>,
    patterns: usize,
}

impl<S: Stars + Sync> AllSky<S> {
    /// A sky of stars at the epoch of the frames (a few years do not matter); no table is made yet.
    pub fn new(stars: S) -> Self {
        Self { stars, tables: [const { OnceLock::new() }; ORDERS.len()] }
    }

    /// Finds where a frame points.
    ///
    /// # Errors
    /// [`NoSolution::Blind`] when nothing on the whole sky fits, [`NoSolution::TooFewStars`], and
    /// [`NoSolution::Hint`] when the scales or the part of the sky make no sense.
    pub fn solve(&self, detected: &Detected, blind: &Blind) -> Result<Solution, NoSolution> {
        let scales = checked(blind)?;
        super::failure::check_trails(detected)?;
        let field = FrameStars::new(detected, &Hint::new(Angle::default(), Angle::default(), 1.0));
        let stars = field.spots.len();
        if detected.width.min(detected.height) < 16 || stars < FEWEST_BLIND {
            return Err(NoSolution::TooFewStars { stars, needed: FEWEST_BLIND });
        }
        let mut progress = Progress::default();
        for (order, table) in ORDERS.into_iter().zip(&self.tables) {
            if !is_useful(order, &field, scales) || progress.candidates >= blind.most_candidates {
                continue;
            }
            let table = table.get_or_init(|| Table::new(&self.stars, order));
            progress.patterns += table.len();
            if let Some(solution) = self.look_up(detected, &field, table, scales, blind, &mut progress) {
                return Ok(solution);
            }
        }
        let Progress { candidates, patterns, .. } = progress;
        Err(NoSolution::Blind { stars, patterns, candidates, scales_arcsec_px: blind.scales_arcsec_px })
    }

    /// Looks up all fours of the frame's brightest stars in a table.
    fn look_up(
        &self,
        detected: &Detected,
        field: &FrameStars,
        table: &Table,
        scales: (f64, f64),
        blind: &Blind,
        progress: &mut Progress,
    ) -> Option<Solution> {
        let (shortest, longest) = (SIDES.0 * field.width.min(field.height), SIDES.1 * field.diagonal());
        for four in fours(field.spots.len().min(STARS)) {
            let places = four.map(|n| (field.spots[n].x, field.spots[n].y));
            let side_px = longest_side(&places);
            if side_px < shortest || side_px > longest {
                continue;
            }
            let reach = BENT + PLACE_PX / side_px;
            let mut hits = Vec::new();
            shapes(&places, 2.0 * reach, |shape| {
                table.near(&shape.code, reach, |pattern| {
                    let scale = pattern.length() / side_px;
                    if scale >= scales.0 && scale <= scales.1 {
                        hits.push((shape, *pattern));
                    }
                });
            });
            for (shape, pattern) in hits {
                progress.candidates += 1;
                let named = shape.order.map(|n| places[n]);
                let Some(found) = self.examine(field, (&shape, &pattern), &named, blind.within) else { continue };
                if found.candidate.false_alarm(progress.candidates) < CERTAIN
                    && let Some(solution) = self.confirmed(detected, &found, progress.candidates)
                {
                    return Some(solution);
                }
                if progress.best.as_ref().is_none_or(|best| found.candidate.chance < best.candidate.chance) {
                    progress.best = Some(found);
                }
            }
            if progress.candidates >= blind.most_candidates {
                break;
            }
        }
        let best = progress.best.as_ref()?;
        self.confirmed(detected, best, progress.candidates)
    }

    /// Lays the sky around a pattern over the frame.
    fn examine(
        &self,
        field: &FrameStars,
        (shape, pattern): (&Shape, &Pattern),
        places: &[Place; 4],
        within: Option<Within>,
    ) -> Option<FoundPattern> {
        let directions = pattern.directions();
        let start = Similarity { s: (1.0, 0.0), t: (0.0, 0.0), mirrored: shape.flipped != pattern.flipped() };
        let fitted = |plane: &TangentPlane, scale: f64| {
            let mut pairs = Vec::with_capacity(4);
            for ((ra, dec), place) in directions.iter().zip(places) {
                let (xi, eta) = plane.project(*ra, *dec)?;
                pairs.push(((xi / scale, eta / scale), *place));
            }
            start.fitted(&pairs, false)
        };
        // first around A, then around the frame's centre, where the sky is laid flat as the frame is
        let plane = TangentPlane::new(directions[0].0, directions[0].1);
        let first = fitted(&plane, 1.0)?;
        let scale = 1.0 / first.size();
        let centre = first.invert((0.0, 0.0));
        let longer_deg = (scale * field.longer_side()).to_degrees();
        if !(FIELDS_DEG.0..=FIELDS_DEG.1).contains(&longer_deg) || centre.0.hypot(centre.1) > 1.0 {
            return None;
        }
        let centre = plane.direction(centre.0, centre.1);
        if !within.is_none_or(|within| within.holds(centre)) {
            return None;
        }
        let tile = Tile::new(&self.stars, centre, field, scale, 0.0, DEPTH);
        let start = grown(field, &tile, fitted(&tile.plane, scale)?, places)?;
        let candidate = Candidate::examine(field, &tile, start, By::Pattern)?;
        Some(FoundPattern { candidate, tile, scale })
    }

    /// A pattern that is believed, refined on all stars.
    fn confirmed(&self, detected: &Detected, found: &FoundPattern, candidates: u64) -> Option<Solution> {
        let (ra, dec) = found.tile.direction((0.0, 0.0));
        let scale_arcsec_px = Angle::from_radians(found.scale).arcseconds();
        let hint = Hint { scale_tolerance: STATED, ..Hint::new(ra, dec, scale_arcsec_px) };
        SolveSearch::new(detected, &hint, &self.stars).judged(&found.tile, found.candidate, candidates, Level::Blind)
    }
}

/// Least and greatest size of a pixel, rad.
fn checked(blind: &Blind) -> Result<(f64, f64), NoSolution> {
    let wrong = |what, value, expected| Err(NoSolution::Hint { what, value, expected });
    if let Some(Within { ra, dec, furthest }) = blind.within {
        if !ra.is_finite() {
            return wrong("ra, deg", ra.degrees(), "a number");
        }
        if !(-90.0..=90.0).contains(&dec.degrees()) {
            return wrong("dec, deg", dec.degrees(), "-90 to 90");
        }
        if !(0.0..=180.0).contains(&furthest.degrees()) {
            return wrong(
                "distance from the hint up to which the frame is looked for, deg",
                furthest.degrees(),
                "0 to 180",
            );
        }
    }
    let Some((low, high)) = blind.scales_arcsec_px else { return Ok((0.0, f64::INFINITY)) };
    if !(low > 0.0 && low.is_finite()) {
        return wrong("least scale, arcsec/px", low, "greater than 0");
    }
    if !(high >= low && high.is_finite()) {
        return wrong("greatest scale, arcsec/px", high, "not less than the least scale");
    }
    Ok((Angle::from_arcseconds(low).radians(), Angle::from_arcseconds(high).radians()))
}

/// Whether patterns of a table can be seen in such a frame.
fn is_useful(order: u8, field: &FrameStars, scales: (f64, f64)) -> bool {
    let (shortest, longest) = lengths(order);
    let (least_px, most_px) = (SIDES.0 * field.width.min(field.height), SIDES.1 * field.diagonal());
    longest >= scales.0 * least_px && shortest <= scales.1 * most_px
}

fn longest_side(places: &[Place; 4]) -> f64 {
    let squared = |p: usize, q: usize| (places[p].0 - places[q].0).powi(2) + (places[p].1 - places[q].1).powi(2);
    [squared(0, 1), squared(0, 2), squared(0, 3), squared(1, 2), squared(1, 3), squared(2, 3)]
        .into_iter()
        .fold(0.0, f64::max)
        .sqrt()
}

/// A similarity of four stars fitted to those around them, then to more: far from the four its error is too large.
fn grown(field: &FrameStars, tile: &Tile, start: Similarity, places: &[Place; 4]) -> Option<Similarity> {
    let (a, b) = (places[0], places[1]);
    let (middle, length) = ((0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1)), (a.0 - b.0).hypot(a.1 - b.1));
    let mut similarity = start;
    for share in GROWTH {
        let (mut pairs, _) = agreeing(field, tile, &similarity, super::candidate::SEARCH_PX);
        pairs.retain(|(_, z)| (z.0 - middle.0).hypot(z.1 - middle.1) < share * length);
        // a pattern is there when its stars are
        if pairs.len() < 4 {
            return None;
        }
        similarity = similarity.fitted(&pairs, false)?;
    }
    Some(similarity)
}
