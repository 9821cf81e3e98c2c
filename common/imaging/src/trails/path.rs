//! A slightly curved path over a frame, and the light along and across it.

use std::ops::Range;

use super::ridge::RidgeLine;
use crate::background::median_in_place;
use crate::clean::Clean;
use crate::least_squares::LeastSquares;

/// Fewest stations that show where a path runs, and how far a trail bends.
const FEWEST: usize = 5;
const FEWEST_BENT: usize = 30;
/// Stations further from the path than so many standard deviations are stars ...
const CLIP: f32 = 2.5;
/// ... but none that are nearer than this, px.
const CLOSE_PX: f32 = 0.3;

/// A path: `t` px along a line, and `d` px across it from the curve that the trail follows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Path {
    line: RidgeLine,
    /// The curve's distance from the line, px: a polynomial in t / half the path's length.
    curve: [f32; 3],
    /// Where the line enters and leaves the frame.
    pub(super) ends: (f32, f32),
}

impl Path {
    /// The path along a line, from edge to edge. None when it does not cross the frame.
    pub(super) fn new(clean: &Clean, line: RidgeLine) -> Option<Self> {
        let (mut first, mut last) = (f32::NEG_INFINITY, f32::INFINITY);
        for (at, along, length) in [(line.at.0, line.along.0, clean.width), (line.at.1, line.along.1, clean.height)] {
            let far = length as f32 - 1.0;
            if along.abs() > 1e-6 {
                let (a, b) = (-at / along, (far - at) / along);
                (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
            } else if !(0.0..=far).contains(&at) {
                return None;
            }
        }
        let middle = 0.5 * (first + last);
        let at = (line.at.0 + middle * line.along.0, line.at.1 + middle * line.along.1);
        let half = 0.5 * (last - first);
        (half > 1.0).then_some(Self { line: RidgeLine { at, ..line }, curve: [0.0; 3], ends: (-half, half) })
    }

    /// Direction from +x towards +y, rad.
    pub(super) fn angle(&self) -> f32 {
        self.line.along.1.atan2(self.line.along.0)
    }

    /// Distance of the curve from the line.
    fn bend(&self, t: f32) -> f32 {
        let s = t / self.ends.1;
        self.curve[0] + s * (self.curve[1] + s * self.curve[2])
    }

    /// The pixel's place at (t, d), px.
    pub(super) fn place(&self, t: f32, d: f32) -> (f32, f32) {
        let ((x, y), (cos, sin), d) = (self.line.at, self.line.along, d + self.bend(t));
        (x + t * cos - d * sin, y + t * sin + d * cos)
    }

    /// (t, d) of a place.
    pub(super) fn along_and_across(&self, x: f32, y: f32) -> (f32, f32) {
        let ((dx, dy), (cos, sin)) = ((x - self.line.at.0, y - self.line.at.1), self.line.along);
        let t = dx * cos + dy * sin;
        (t, dy * cos - dx * sin - self.bend(t))
    }

    /// Bends the path through the stations' middles: (t, d, is it seen).
    pub(super) fn bent_through(mut self, middles: &[(f32, f32)]) -> Option<Self> {
        let mut used = vec![true; middles.len()];
        let mut fitted = [0.0; 3];
        for _ in 0..4 {
            let some = || middles.iter().zip(&used).filter(|(_, used)| **used).map(|(middle, _)| *middle);
            let count = some().count();
            if count < FEWEST {
                return None;
            }
            let (first, last) = some().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), (t, _)| (a.min(t), b.max(t)));
            // a short part of a line does not show its bend elsewhere
            let bends = count >= FEWEST_BENT && last - first > 0.5 * (self.ends.1 - self.ends.0);
            fitted = if bends { polynomial::<3>(some(), self.ends.1)? } else { polynomial::<2>(some(), self.ends.1)? };
            let off = |(t, d): &(f32, f32)| {
                let s = t / self.ends.1;
                (d - (fitted[0] + s * (fitted[1] + s * fitted[2]))).abs()
            };
            let mut all: Vec<f32> = some().map(|middle| off(&middle)).collect();
            let limit = (CLIP * 1.4826 * median_in_place(&mut all)?).max(CLOSE_PX);
            used = middles.iter().map(|middle| off(middle) <= limit).collect();
        }
        self.curve = std::array::from_fn(|n| self.curve[n] + fitted[n]);
        Some(self)
    }
}

/// A polynomial of `N` terms in t / half through places; its missing terms are 0.
fn polynomial<const N: usize>(places: impl Iterator<Item = (f32, f32)>, half: f32) -> Option<[f32; 3]> {
    let mut sums = LeastSquares::<N>::new();
    for (t, d) in places {
        let s = f64::from(t / half);
        sums.add(std::array::from_fn(|n| s.powi(n as i32)), f64::from(d), 1.0);
    }
    let found = sums.solve()?;
    Some(std::array::from_fn(|n| found.get(n).map_or(0.0, |value| *value as f32)))
}

/// The light across a path at one station after the other.
pub(super) struct Strip {
    /// Length of a station, px.
    pub(super) step: usize,
    /// Distances across go from minus this to this, px.
    pub(super) reach: usize,
    /// For each station the mean light at each distance, ADU; NaN outside of the frame.
    light: Vec<f32>,
    /// For each station the noise of a pixel, ADU.
    pub(super) noise: Vec<f32>,
    first: f32,
}

impl Strip {
    /// Looks along a path, `aside` px to its side.
    pub(super) fn new(clean: &Clean, path: &Path, step: usize, reach: usize, aside: f32) -> Self {
        let stations = ((path.ends.1 - path.ends.0) as usize + 1).div_ceil(step);
        let columns = 2 * reach + 1;
        let (mut light, mut noise) = (vec![f32::NAN; stations * columns], Vec::with_capacity(stations));
        let mut counts = vec![0_u32; columns];
        let (width, height) = (clean.width as f32, clean.height as f32);
        for (station, sums) in light.chunks_mut(columns).enumerate() {
            counts.fill(0);
            sums.fill(0.0);
            let begin = path.ends.0 + (station * step) as f32;
            for t in 0..step {
                let t = begin + t as f32;
                let ((x, y), (cos, sin)) = (path.place(t, aside - reach as f32), path.line.along);
                // half a pixel more, cut off: rounding itself is a call of a library here
                let (x, y) = (x + 0.5, y + 0.5);
                for (n, (sum, count)) in sums.iter_mut().zip(&mut counts).enumerate() {
                    let (column, row) = (x - n as f32 * sin, y + n as f32 * cos);
                    if (0.0..width).contains(&column) && (0.0..height).contains(&row) {
                        let (column, row) = (column as i32, row as i32);
                        *sum += clean.pixels[row as usize * clean.width + column as usize];
                        *count += 1;
                    }
                }
            }
            sums.iter_mut().zip(&counts).for_each(|(sum, count)| *sum /= *count as f32);
            let (x, y) = path.place(begin + 0.5 * step as f32, aside);
            let within = |at: f32, length: usize| (at.max(0.0) as usize).min(length - 1);
            noise.push(clean.background.noise.at(within(x, clean.width), within(y, clean.height)));
        }
        Self { step, reach, light, noise, first: path.ends.0 }
    }

    /// Number of stations.
    pub(super) fn len(&self) -> usize {
        self.noise.len()
    }

    /// The middle of a station, px along the path.
    pub(super) fn t(&self, station: usize) -> f32 {
        self.first + (station * self.step) as f32 + 0.5 * (self.step as f32 - 1.0)
    }

    /// The station at `t` px, or the nearest one.
    pub(super) fn station(&self, t: f32) -> usize {
        let station = ((t + 0.5 - self.first) / self.step as f32).floor().max(0.0);
        (station as usize).min(self.len() - 1)
    }

    /// The light of a station at the distances from minus reach to reach.
    pub(super) fn across(&self, station: usize) -> &[f32] {
        let columns = 2 * self.reach + 1;
        &self.light[station * columns..(station + 1) * columns]
    }

    /// Light of each station within `core` px of the path above what `side` makes of that on either side, ADU; NaN where
    /// it is not on the frame.
    pub(super) fn amplitudes(&self, core: usize, aside: Range<usize>, side: fn(f32, f32) -> f32) -> Vec<f32> {
        let aside = aside.start.min(self.reach)..aside.end.min(self.reach + 1);
        let mut scratch = Vec::new();
        (0..self.len())
            .map(|station| {
                let across = self.across(station);
                let core = mean(&across[self.reach - core..=self.reach + core]);
                // the darker quarter: other trails and stars stand there too
                let mut dark = |values: &[f32]| {
                    scratch.clear();
                    scratch.extend(values.iter().filter(|value| value.is_finite()));
                    let rank = scratch.len() / 4;
                    if scratch.is_empty() { f32::NAN } else { *scratch.select_nth_unstable_by(rank, f32::total_cmp).1 }
                };
                let left = dark(&across[self.reach + 1 - aside.end..self.reach + 1 - aside.start]);
                let right = dark(&across[self.reach + aside.start..self.reach + aside.end]);
                // f32::max and f32::min pass over NaN: the frame may end next to the trail
                core - side(left, right)
            })
            .collect()
    }
}

/// Mean of the finite values; NaN of none.
fn mean(values: &[f32]) -> f32 {
    let finite = values.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}
