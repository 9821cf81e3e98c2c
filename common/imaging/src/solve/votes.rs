//! Level 1: the scale is known to a few percent; pairs of stars of equal length vote for rotation and place.
//!
//! A pair of the frame's bright stars laid on a pair of the catalogue fixes a similarity. Each is tested on the other
//! stars, first by one bit per star (`mask`), and what survives is refitted and counted
//! (docs/formulae.md, "Pairs that vote").

use std::ops::Range;

use super::candidate::{By, Candidate};
use super::chance;
use super::field::FrameStars;
use super::mask::{Mask, View};
use super::similarity::{Place, Similarity, divide, multiply, turned};
use super::tile::Tile;

/// Pairs closer than this share of the frame's diagonal fix the rotation too badly.
const CLOSEST: f64 = 0.04;
/// Error of a length beyond that of the scale, px.
const LENGTH_PX: f64 = 2.0;
/// A search by rank takes a star for one that is at most so many times fainter by its place in the order of brightness,
/// and by so many places more: false detections only push a star down that order, and a few magnitudes are wrong.
const RANK: f64 = 1.5;
const MORE_RANKS: usize = 10;
/// Stars that are tested before a hypothesis without any agreement is given up ...
const FIRST_LOOK: usize = 12;
/// ... and in a search by rank, which has time for it: the brightest stars may all be false detections.
const LONG_LOOK: usize = 30;
/// Candidates by chance that a search may examine closely.
const BY_CHANCE: f64 = 30.0;
/// Probability of a false alarm at which the search stops at once.
pub(super) const CERTAIN: f64 = 1e-9;

/// How a tile is searched.
#[derive(Debug, Clone)]
pub(super) struct Effort<'a> {
    /// Numbers of the frame's stars, by brightness, that vote, each paired with all brighter ones.
    pub(super) voters: Range<usize>,
    /// Only pairs whose stars stand about as high, and the same way about, in the frame's order of brightness and in
    /// the catalogue's: a tenth of the hypotheses.
    pub(super) by_rank: bool,
    /// Greatest error of the scale, as a share.
    pub(super) scale_tolerance: f64,
    /// Parities to be tried (true: mirrored).
    pub(super) parities: &'a [bool],
    /// Hypotheses after which to stop.
    pub(super) most_hypotheses: u64,
}

/// Examines what the pairs of a tile vote for and gives each good candidate to `judge`, which says whether to stop.
/// `hypotheses` goes on counting.
pub(super) fn search(
    field: &FrameStars,
    tile: &Tile,
    effort: &Effort,
    hypotheses: &mut u64,
    mut judge: impl FnMut(Candidate, u64) -> bool,
) -> bool {
    let n = field.spots.len();
    // a voter may be one of so many of the tile's brightest
    let bright = |voter: usize| match effort.by_rank {
        true => (RANK * tile.share(field) * (voter + 1) as f64) as usize + MORE_RANKS,
        false => usize::MAX,
    };
    let look = n.min(if effort.by_rank { LONG_LOOK } else { FIRST_LOOK });
    let most = tile.stars.len().min(bright(n.min(effort.voters.end)));
    let catalogue = Pairs::new(&tile.stars[..most], field, effort.scale_tolerance);
    let mask = Mask::new(tile);
    for (b, a) in (effort.voters.start..n.min(effort.voters.end)).flat_map(|b| (0..b).map(move |a| (b, a))) {
        let (za, zb) = (field.spots[a], field.spots[b]);
        let dz = (zb.x - za.x, zb.y - za.y);
        let length = dz.0.hypot(dz.1);
        if length < CLOSEST * field.diagonal() {
            continue;
        }
        let enough = fewest(n, mask.filled, *hypotheses);
        let inverse = divide((1.0, 0.0), dz);
        let margin = effort.scale_tolerance * length + LENGTH_PX;
        let limit = bright(b);
        for (p, q) in catalogue.between(length - margin, length + margin).filter(|(_, q)| *q < limit) {
            for mirrored in effort.parities {
                let (wp, wq) = (turned(tile.stars[p], *mirrored), turned(tile.stars[q], *mirrored));
                let back = multiply((wq.0 - wp.0, wq.1 - wp.1), inverse);
                let shift = multiply((za.x, za.y), back);
                let either_way =
                    [(back, (wp.0 - shift.0, wp.1 - shift.1)), ((-back.0, -back.1), (wq.0 + shift.0, wq.1 + shift.1))];
                // p is brighter than q, as a is than b
                for (back, centre) in either_way.into_iter().take(if effort.by_rank { 1 } else { 2 }) {
                    if centre.0 * centre.0 + centre.1 * centre.1 > tile.radius * tile.radius * 1.02 {
                        continue;
                    }
                    *hypotheses += 1;
                    if agreement(field, &mask.seen_from(back, centre, *mirrored), (a, b), look, enough) < enough {
                        continue;
                    }
                    let s = divide((1.0, 0.0), back);
                    let t = multiply(s, centre);
                    let start = Similarity { s, t: (-t.0, -t.1), mirrored: *mirrored };
                    if let Some(candidate) = Candidate::examine(field, tile, start, By::Pair)
                        && judge(candidate, *hypotheses)
                    {
                        return true;
                    }
                }
            }
        }
        if *hypotheses >= effort.most_hypotheses {
            return false;
        }
    }
    false
}

/// How many stars of the frame fall near a catalogue star, the voting pair among them; fewer where the first `look`
/// stars say that it cannot be `enough`.
fn agreement(field: &FrameStars, view: &View, pair: (usize, usize), look: usize, enough: usize) -> usize {
    let near = |spot: &super::field::Spot| usize::from(view.is_set(spot.x, spot.y));
    let (first, rest) = field.spots.split_at(look);
    let hits: usize = first.iter().map(near).sum();
    let own = usize::from(pair.0 < look) + usize::from(pair.1 < look);
    if hits <= own || hits + rest.len() < enough { hits } else { hits + rest.iter().map(near).sum::<usize>() }
}

/// The number of agreeing stars (with the pair) from which a hypothesis is worth a closer look.
fn fewest(stars: usize, filled: f64, hypotheses: u64) -> usize {
    let by_chance = |k: &usize| chance::at_least(k - 2, stars - 2, filled) * hypotheses as f64;
    (4..=stars).find(|k| by_chance(k) < BY_CHANCE).unwrap_or(stars + 1)
}

/// All pairs of catalogue stars that fit into the frame, by length.
struct Pairs {
    /// First pair of each bin of lengths; one more than there are bins.
    starts: Vec<u32>,
    /// Length (px) and the numbers of both stars, the brighter one first.
    pairs: Vec<(f32, u16, u16)>,
}

/// Width of a bin of lengths, px.
const BIN_PX: f64 = 2.0;

impl Pairs {
    fn new(stars: &[Place], field: &FrameStars, tolerance: f64) -> Self {
        let longest = field.diagonal() * (1.0 + tolerance) + LENGTH_PX;
        let shortest = (CLOSEST * field.diagonal() * (1.0 - tolerance) - LENGTH_PX).max(0.5);
        let bins = (longest / BIN_PX) as usize + 1;
        let mut all = Vec::new();
        let mut starts = vec![0_u32; bins + 1];
        for (q, one) in stars.iter().enumerate() {
            for (p, other) in stars[..q].iter().enumerate() {
                let squared = (one.0 - other.0).powi(2) + (one.1 - other.1).powi(2);
                if squared > longest * longest || squared < shortest * shortest {
                    continue;
                }
                // one rounding for counting and for placing
                let length = squared.sqrt() as f32;
                starts[bin(f64::from(length), bins) + 1] += 1;
                all.push((length, p as u16, q as u16));
            }
        }
        for n in 1..=bins {
            starts[n] += starts[n - 1];
        }
        let mut next = starts.clone();
        let mut pairs = vec![(0.0, 0, 0); all.len()];
        for pair in all {
            let place = &mut next[bin(f64::from(pair.0), bins)];
            pairs[*place as usize] = pair;
            *place += 1;
        }
        Self { starts, pairs }
    }

    /// Both stars of each pair with a length in a range, px.
    fn between(&self, low: f64, high: f64) -> impl Iterator<Item = (usize, usize)> {
        let bins = self.starts.len() - 1;
        let range = self.starts[bin(low, bins)] as usize..self.starts[bin(high, bins) + 1] as usize;
        let inside = move |pair: &&(f32, u16, u16)| (low..=high).contains(&f64::from(pair.0));
        self.pairs[range].iter().filter(inside).map(|(_, p, q)| (usize::from(*p), usize::from(*q)))
    }
}

fn bin(length: f64, bins: usize) -> usize {
    ((length.max(0.0) / BIN_PX) as usize).min(bins - 1)
}
