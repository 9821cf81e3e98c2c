//! Coarse pixels on a straight ridge, and the lines on which many of them lie.
//!
//! A pixel lies on a ridge in a direction when nearly all pixels along it are lit too, and those of a line on either
//! side are not. Stars are round, galaxies short: only a trail has many such pixels on one line in that very direction.
//! Two of them fix a line; each pair votes for its own.

use std::f32::consts::PI;

use super::map::Map;
use crate::parallel;

/// Significance of a coarse pixel from which on a ridge is looked for, and that of the pixels along it; along it they are
/// also not below, and next to it below, this share of it.
const SEED: f32 = 3.0;
const LIT: f32 = 1.5;
const SHARE: f32 = 0.3;
/// Pixels that are looked at, at most.
const MOST_SEEDS: usize = 6000;
/// The work of looking around one of them, as that on so many pixels.
const PIXELS_OF_SEED: usize = 512;
/// Directions tried.
const DIRECTIONS: usize = 24;
/// How far along the ridge is looked, px; so many of the pixels may be dark.
const REACH: isize = 6;
const GAPS: usize = 3;
/// Distances of the lines next to it, px: trails may fly side by side. So many of their pixels may be lit.
const ASIDE: [f32; 2] = [3.0, 5.0];
const LIT_ASIDE: usize = 4;
/// Ridge pixels that vote, at most, and at least for one line.
const MOST: usize = 300;
pub(super) const FEWEST: usize = 6;
/// A pair votes when its line has the direction of both within this, rad, and they are so far apart, px.
const SAME_DIRECTION: f32 = 0.2;
const APART: f32 = 8.0;
/// Cells of the vote: directions, and px across.
const ANGLES: usize = 180;
const ACROSS: f32 = 1.5;
/// A dash goes on after a dark way of less than this, px.
const DASH_GAP: f32 = 3.0;
/// Ridge pixels within this of a line belong to it, px.
const NEAR: f32 = 2.0;

/// A pixel on a ridge, with the ridge's direction, rad from +x towards +y in [0, pi).
#[derive(Debug, Clone, Copy)]
pub(super) struct Ridge {
    x: f32,
    y: f32,
    angle: f32,
}

/// A line on the frame: a point on it and its direction, px and unit vector.
#[derive(Debug, Clone, Copy)]
pub(super) struct RidgeLine {
    pub(super) at: (f32, f32),
    pub(super) along: (f32, f32),
    /// Width of the pixels it was seen in, px.
    pub(super) bin: usize,
}

/// Steps along a direction and the lines next to it.
struct Steps {
    angle: f32,
    along: Vec<(isize, isize)>,
    /// For each distance, on either side.
    aside: [[Vec<(isize, isize)>; 2]; 2],
}

impl Steps {
    fn new(number: usize) -> Self {
        let angle = PI * number as f32 / DIRECTIONS as f32;
        let (sin, cos) = angle.sin_cos();
        let place = |t: f32, d: f32| ((t * cos - d * sin).round() as isize, (t * sin + d * cos).round() as isize);
        // the far ones first: a star has none of them
        let mut along: Vec<isize> = (1..=REACH).flat_map(|t| [t, -t]).collect();
        along.sort_by_key(|t| (t.abs() - 4).abs());
        let line = |d: f32| (-REACH..=REACH).map(|t| place(t as f32, d)).collect::<Vec<_>>();
        Self {
            angle,
            along: along.iter().map(|t| place(*t as f32, 0.0)).collect(),
            aside: ASIDE.map(|d| [line(d), line(-d)]),
        }
    }
}

/// The pixels of a map that lie on ridges; of too many each so manyth.
pub(super) fn ridges(map: &Map) -> Vec<Ridge> {
    let steps: Vec<Steps> = (0..DIRECTIONS).map(Steps::new).collect();
    let seeds = map.above(SEED, MOST_SEEDS);
    let found = parallel::ranges(seeds.len(), PIXELS_OF_SEED, |range| {
        let ridges = seeds[range].iter().filter_map(|(x, y)| ridge(map, &steps, *x as isize, *y as isize));
        ridges.collect::<Vec<Ridge>>()
    });
    let found = found.concat();
    let step = found.len().div_ceil(MOST).max(1);
    found.into_iter().step_by(step).collect()
}

fn ridge(map: &Map, steps: &[Steps], x: isize, y: isize) -> Option<Ridge> {
    let here = map.at(x, y);
    let least = LIT.max(SHARE * here);
    let is_lit = |(dx, dy): &(isize, isize)| map.at(x + dx, y + dy) > least;
    let is_dark_beside = |[left, right]: &[Vec<(isize, isize)>; 2]| {
        [left, right].iter().all(|line| line.iter().filter(|at| is_lit(at)).count() <= LIT_ASIDE)
    };
    let passes = |steps: &&Steps| {
        steps.along.iter().filter(|at| !is_lit(at)).nth(GAPS).is_none() && steps.aside.iter().any(is_dark_beside)
    };
    let light = |steps: &Steps| -> f32 {
        steps.along.iter().map(|(dx, dy)| map.at(x + dx, y + dy).clamp(0.0, 2.0 * here)).sum()
    };
    let best = steps.iter().filter(passes).map(|steps| (light(steps), steps.angle)).max_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, angle)| Ridge { x: x as f32, y: y as f32, angle })
}

/// The line with the most votes, if there are enough; what lies on it is taken out of the ridge pixels.
pub(super) fn best_line(map: &Map, ridges: &mut Vec<Ridge>) -> Option<RidgeLine> {
    if ridges.len() < FEWEST {
        return None;
    }
    let (angle, offset) = most_votes(map, ridges)?;
    let (mut angle, mut offset) = (angle, offset);
    for _ in 0..3 {
        let on: Vec<&Ridge> = ridges.iter().filter(|ridge| ridge.is_on(angle, offset, NEAR)).collect();
        if on.len() < FEWEST {
            break;
        }
        (angle, offset) = through(&on, angle);
    }
    let (sin, cos) = angle.sin_cos();
    let before = ridges.len();
    ridges.retain(|ridge| !ridge.is_on(angle, offset, 2.0 * NEAR));
    if before - ridges.len() < FEWEST {
        return None;
    }
    // the middle of coarse pixel 0 lies half a pixel from the middle of fine pixel 0 for each further fine one
    let whole = |at: f32| map.bin as f32 * at + 0.5 * (map.bin as f32 - 1.0);
    Some(RidgeLine { at: (whole(-offset * sin), whole(offset * cos)), along: (cos, sin), bin: map.bin })
}

/// The longest way along a line that is lit, px, small gaps included.
pub(super) fn longest_dash_px(map: &Map, line: &RidgeLine) -> f32 {
    let bin = map.bin as f32;
    let coarse = |at: f32| (at - 0.5 * (bin - 1.0)) / bin;
    let (x, y, (cos, sin)) = (coarse(line.at.0), coarse(line.at.1), line.along);
    let light =
        |t: f32, d: f32| map.at((x + t * cos - d * sin).round() as isize, (y + t * sin + d * cos).round() as isize);
    let half = (map.width as f32).hypot(map.height as f32);
    let (mut longest, mut first, mut last) = (0.0_f32, f32::NAN, f32::NEG_INFINITY);
    for t in (-half as i32..=half as i32).map(|t| t as f32) {
        if [-1.0, 0.0, 1.0].into_iter().any(|d| light(t, d) > LIT) {
            if t - last > DASH_GAP {
                first = t;
            }
            last = t;
            longest = longest.max(t + 1.0 - first);
        }
    }
    bin * longest
}

impl Ridge {
    fn is_on(&self, angle: f32, offset: f32, reach: f32) -> bool {
        (offset_of(self.x, self.y, angle) - offset).abs() < reach && turned(self.angle, angle) < 1.5 * SAME_DIRECTION
    }
}

/// Distance of the line through a point in a direction from the origin, with a sign.
fn offset_of(x: f32, y: f32, angle: f32) -> f32 {
    y * angle.cos() - x * angle.sin()
}

/// Angle between two directions, rad, 0 to pi/2.
pub(super) fn turned(a: f32, b: f32) -> f32 {
    let turned = (a - b).rem_euclid(PI);
    turned.min(PI - turned)
}

fn most_votes(map: &Map, ridges: &[Ridge]) -> Option<(f32, f32)> {
    let half = (map.width as f32).hypot(map.height as f32);
    let columns = (2.0 * half / ACROSS) as usize + 3;
    let mut votes = vec![0_u32; ANGLES * columns];
    for (n, a) in ridges.iter().enumerate() {
        for b in &ridges[n + 1..] {
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let angle = dy.atan2(dx);
            if dx.hypot(dy) < APART
                || turned(angle, a.angle) > SAME_DIRECTION
                || turned(angle, b.angle) > SAME_DIRECTION
            {
                continue;
            }
            let angle = angle.rem_euclid(PI);
            let row = ((ANGLES as f32 * angle / PI) as usize).min(ANGLES - 1);
            let column = ((offset_of(a.x, a.y, angle) + half) / ACROSS) as usize + 1;
            votes[row * columns + column] += 1;
        }
    }
    // with its neighbours: a line falls between cells
    let around = |n: usize| -> u32 {
        let (row, column) = (n / columns, n % columns);
        let rows = [row.saturating_sub(1), row, (row + 1).min(ANGLES - 1)];
        rows.iter().map(|row| votes[row * columns + column - 1..=row * columns + column + 1].iter().sum::<u32>()).sum()
    };
    let inner = (0..votes.len()).filter(|n| votes[*n] > 0 && (1..columns - 1).contains(&(n % columns)));
    let (most, at) = inner.map(|n| (around(n), n)).max()?;
    let enough = (FEWEST * (FEWEST - 1) / 4) as u32;
    let angle = (at / columns) as f32 + 0.5;
    let offset = ((at % columns) as f32 - 0.5) * ACROSS - half;
    (most >= enough).then_some((PI * angle / ANGLES as f32, offset))
}

/// Direction and offset of the line through points, by their moments.
fn through(on: &[&Ridge], near: f32) -> (f32, f32) {
    let count = on.len() as f32;
    let (x, y) = on.iter().fold((0.0, 0.0), |(x, y), ridge| (x + ridge.x / count, y + ridge.y / count));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for ridge in on {
        let (dx, dy) = (ridge.x - x, ridge.y - y);
        (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
    }
    let angle = (0.5 * (2.0 * xy).atan2(xx - yy)).rem_euclid(PI);
    let angle = if turned(angle, near) < SAME_DIRECTION { angle } else { near };
    (angle, offset_of(x, y, angle))
}
