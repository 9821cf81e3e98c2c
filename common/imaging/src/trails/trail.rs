//! One trail: proven by its light along the path, with its profile across.

use super::path::{Path, Strip};
use super::ridge::RidgeLine;
use crate::background::median_in_place;
use crate::clean::Clean;

/// A station is lit at this significance.
const LIT: f32 = 3.0;
/// Light beyond this many times the median of the lit stations is a star's.
const CLIP: f32 = 2.0;
/// A dash is at least this many widths, and stations, long: stars and blends are shorter.
const DASH: (f32, f32) = (5.0, 5.0);
/// All dashes together are at least this many widths, and px, long: a galaxy is shorter.
const LONG: (f32, f32) = (15.0, 40.0);
/// Dashes are that much longer than those on lines next to the trail, so many widths and px away: a crowded
/// field has them everywhere.
const CONTRAST: f32 = 2.5;
const ASIDE: [(f32, f32); 2] = [(5.0, 12.0), (9.0, 20.0)];
/// The middle of a trail is looked for within so many widths of the path.
const CENTRED: f32 = 1.0;
/// The profile ends where it is less than this share of a pixel's noise.
const FLOOR: f32 = 0.15;
/// Greatest distance from the path at which a profile is looked at, px.
const WIDEST: usize = 128;
/// Light that falls from the middle to both ends by more than this is a galaxy's or, around a star, a spike's.
const FALL: f32 = 0.35;
/// Dashes fill at least this share of the way from the first to the last.
const FILLED: f32 = 0.3;
/// Where a station has less than half or more than twice the light of those around it, stars stand in a row; a trail has
/// no more of these than this share.
const UNEVEN: f32 = 0.15;
/// What runs along a row or column within this, rad, may be charge that bled from a saturated star.
const ALONG: f32 = 0.01;

/// A trail on a frame.
pub(super) struct Trail {
    pub(super) path: Path,
    /// Full width at half maximum, px.
    pub(super) fwhm: f32,
    /// Light across the path as a share of that on it, from minus `reach` to `reach` px.
    profile: Vec<f32>,
    reach: usize,
    /// Light of each station on the path, ADU.
    light: Vec<f32>,
    strip: Strip,
    /// First and last station of the trail.
    pub(super) stations: (usize, usize),
}

impl Trail {
    /// The trail along a line. None when there is none.
    pub(super) fn along(clean: &Clean, line: RidgeLine, saturation: f32) -> Option<Self> {
        let step = (line.bin / 2).max(4);
        let path = middle_path(clean, line, step)?;
        let (strip, profile) = look_across(clean, &path, line.bin, step)?;
        let dashes = Dashes::of(&strip, profile.fwhm);
        if !(dashes.is_trail && dashes.stand_out(clean, &path, step, profile.fwhm)) {
            return None;
        }
        let path = centred(clean, path, step, profile.fwhm, strip.reach)?;
        let (strip, profile) = look_across(clean, &path, line.bin, step)?;
        let (fwhm, reach, dashes) = (profile.fwhm, strip.reach, Dashes::of(&strip, profile.fwhm));
        if !dashes.is_trail {
            return None;
        }
        let stations = dashes.ends;
        // what was measured over the core is less than what shines on the path itself
        let core = core_of(fwhm, reach);
        let shares = &profile.shares[reach - core..=reach + core];
        let share = shares.iter().sum::<f32>() / shares.len() as f32;
        let light = strip.amplitudes(core, aside_of(fwhm), f32::min);
        let light = medians(&light, 2).iter().map(|light| light / share.max(0.1)).collect();
        let trail = Self { path, fwhm, light, profile: profile.shares, reach, strip, stations };
        (!trail.fades_from_middle() && !trail.is_bleeding(saturation)).then_some(trail)
    }

    /// Length, px.
    pub(super) fn length(&self) -> f32 {
        ((self.stations.1 + 1 - self.stations.0) * self.strip.step) as f32
    }

    /// First and last px along the path.
    pub(super) fn ends(&self) -> (f32, f32) {
        let half = 0.5 * self.strip.step as f32;
        (self.strip.t(self.stations.0) - half, self.strip.t(self.stations.1) + half)
    }

    /// First and last px where its light falls: the trail ends within its last station, and goes on by a width; one that
    /// the frame cuts goes on beyond its corner.
    pub(super) fn reaches(&self) -> (f32, f32) {
        let ((first, last), (cut_first, cut_last)) = (self.ends(), self.is_cut());
        let more =
            |is_cut: bool| if is_cut { 2.0 * self.half_width() + 3.0 * self.strip.step as f32 } else { self.fwhm };
        (first - more(cut_first), last + more(cut_last))
    }

    /// Whether the frame cuts it at either end.
    pub(super) fn is_cut(&self) -> (bool, bool) {
        (self.stations.0 <= 2, self.stations.1 + 3 >= self.strip.len())
    }

    /// Light at a place, ADU: (as modelled there, the most in the neighbourhood).
    pub(super) fn light_at(&self, t: f32, d: f32) -> (f32, f32) {
        let station = self.strip.station(t).clamp(self.stations.0, self.stations.1);
        let around = station.saturating_sub(1)..(station + 2).min(self.light.len());
        let most = self.light[around].iter().fold(0.0_f32, |most, light| most.max(*light));
        let at = (d + self.reach as f32).clamp(0.0, 2.0 * self.reach as f32);
        let (below, share) = (at as usize, at.fract());
        let next = (below + 1).min(2 * self.reach);
        let here = (1.0 - share) * self.profile[below] + share * self.profile[next];
        (self.light[station].max(0.0) * here, most * self.profile[below].max(self.profile[next]))
    }

    /// Greatest distance from the path at which there is light of it, px.
    pub(super) fn half_width(&self) -> f32 {
        let lit = |n: &usize| self.profile[*n] > 0.0;
        let furthest = (0..self.profile.len()).filter(lit).map(|n| n.abs_diff(self.reach)).max();
        furthest.unwrap_or(0) as f32 + 1.0
    }

    /// Whether the light falls from the middle to both ends, as that of galaxies and of spikes of bright stars does.
    fn fades_from_middle(&self) -> bool {
        let lit = &self.light[self.stations.0..=self.stations.1];
        let brightest = (0..lit.len()).max_by(|a, b| lit[*a].total_cmp(&lit[*b])).unwrap_or(0);
        let (left, right) = (&lit[..brightest], &lit[brightest..]);
        if left.len().min(right.len()) < lit.len() / 5 {
            return false;
        }
        let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len().max(1) as f32;
        let (near_left, far_left) = (mean(&left[left.len() - left.len() / 3..]), mean(&left[..left.len() / 3]));
        let (near_right, far_right) = (mean(&right[..right.len() / 3]), mean(&right[right.len() - right.len() / 3..]));
        far_left < FALL * near_left && far_right < FALL * near_right
    }

    /// Whether it runs along a row or column, is saturated and ends within the frame.
    fn is_bleeding(&self, saturation: f32) -> bool {
        let angle = self.path.angle().rem_euclid(std::f32::consts::FRAC_PI_2);
        let is_along = angle.min(std::f32::consts::FRAC_PI_2 - angle) < ALONG;
        let most = self.light.iter().fold(0.0_f32, |most, light| most.max(*light));
        is_along && most > 0.5 * saturation && self.is_cut() != (true, true)
    }
}

/// The light along and across a path, as far from it as it shines.
fn look_across(clean: &Clean, path: &Path, bin: usize, step: usize) -> Option<(Strip, TrailProfile)> {
    let mut reach = 6 * bin + 6;
    loop {
        let strip = Strip::new(clean, path, step, reach, 0.0);
        let profile = TrailProfile::of(&strip, bin)?;
        if !profile.goes_on || 2 * reach > WIDEST {
            return Some((strip, profile));
        }
        // a wide trail shines here too; of doughnuts next to the line no more need be seen
        if Dashes::of(&strip, profile.fwhm).length <= 0.0 {
            return None;
        }
        reach *= 2;
    }
}

/// The path bent through the middles of what is lit.
fn middle_path(clean: &Clean, line: RidgeLine, step: usize) -> Option<Path> {
    let mut path = Path::new(clean, line)?;
    for (near, core) in [(2 * line.bin, line.bin), (line.bin + 1, line.bin.div_ceil(2))] {
        let strip = Strip::new(clean, &path, step, 6 * line.bin + 6, 0.0);
        let lit = lit(&strip, core, 3 * line.bin + 2..usize::MAX).0;
        path = path.bent_through(&middles(&strip, &lit, near))?;
    }
    Some(path)
}

/// The path of a trail of a width that is known, through its middles once more: what saturates is wider and flatter than
/// the few pixels in which it was looked for, and seemed to lie in the middle wherever the path ran over it.
fn centred(clean: &Clean, mut path: Path, step: usize, fwhm: f32, reach: usize) -> Option<Path> {
    let near = (CENTRED * fwhm + 1.0).ceil() as usize;
    for _ in 0..2 {
        let strip = Strip::new(clean, &path, step, reach, 0.0);
        let lit = lit(&strip, core_of(fwhm, reach), aside_of(fwhm)).0;
        path = path.bent_through(&middles(&strip, &lit, near.min(reach)))?;
    }
    Some(path)
}

/// The middle of each lit station, within `near` px of the path: its place along and across.
fn middles(strip: &Strip, lit: &[f32], near: usize) -> Vec<(f32, f32)> {
    let middle = |(station, light): (usize, &f32)| {
        (*light > 0.0).then_some(())?;
        let across = &strip.across(station)[strip.reach - near..=strip.reach + near];
        // what is above a quarter of the light: wings and noise pull everything to the middle
        let above = across.iter().map(|value| (value - 0.25 * light).max(0.0));
        let (sum, moment) = above
            .enumerate()
            .fold((0.0, 0.0), |(sum, moment), (n, value)| (sum + value, moment + value * (n as f32 - near as f32)));
        (sum > 0.0).then_some((strip.t(station), moment / sum))
    };
    lit.iter().enumerate().filter_map(middle).collect()
}

/// Light of the stations that are lit, 0 of the others; and that of all.
fn lit(strip: &Strip, core: usize, aside: std::ops::Range<usize>) -> (Vec<f32>, Vec<f32>) {
    let all = strip.amplitudes(core, aside, f32::max);
    let error = ((strip.step * (2 * core + 1)) as f32).sqrt();
    let lit =
        all.iter().zip(&strip.noise).map(|(light, noise)| if *light > LIT * noise / error { *light } else { 0.0 });
    (lit.collect(), all)
}

/// The light across.
struct TrailProfile {
    shares: Vec<f32>,
    fwhm: f32,
    /// It may be wider than was looked at.
    goes_on: bool,
}

impl TrailProfile {
    fn of(strip: &Strip, bin: usize) -> Option<Self> {
        let (lit, _) = lit(strip, bin.div_ceil(2), 3 * bin + 2..usize::MAX);
        let mut lights: Vec<f32> = lit.iter().copied().filter(|light| *light > 0.0).collect();
        let typical = median_in_place(&mut lights)?;
        // the brighter half of a blinking trail
        let used: Vec<usize> = (0..strip.len()).filter(|n| lit[*n] >= typical).collect();
        let mut noise: Vec<f32> = used.iter().map(|n| strip.noise[*n]).collect();
        let noise = median_in_place(&mut noise)?;
        let columns = 0..2 * strip.reach + 1;
        let median = |n: usize| {
            let mut values: Vec<f32> =
                used.iter().map(|station| strip.across(*station)[n]).filter(|value| value.is_finite()).collect();
            median_in_place(&mut values).unwrap_or(0.0)
        };
        let mut across: Vec<f32> = columns.map(median).collect();
        let outer = strip.reach / 4;
        let mut sky: Vec<f32> = across[..outer].iter().chain(&across[across.len() - outer..]).copied().collect();
        let rank = sky.len() / 4;
        let sky = *sky.select_nth_unstable_by(rank, f32::total_cmp).1;
        across.iter_mut().for_each(|value| *value -= sky);
        let middle = strip.reach;
        let peak = across[middle - 1].max(across[middle]).max(across[middle + 1]);
        if peak <= 0.0 {
            return None;
        }
        let halves = (
            half_width(across[..=middle].iter().rev().copied(), peak),
            half_width(across[middle..].iter().copied(), peak),
        );
        let fwhm = halves.0 + halves.1;
        let end = |side: &mut dyn Iterator<Item = f32>| last(&side.collect::<Vec<_>>(), noise);
        let left = end(&mut across[..=middle].iter().rev().copied());
        let right = end(&mut across[middle..].iter().copied());
        let goes_on = left.max(right) + outer > middle;
        let is_inside = |n: usize| n + left >= middle && n <= middle + right;
        let share = |(n, value): (usize, &f32)| if is_inside(n) { (value / peak).max(0.0) } else { 0.0 };
        Some(Self { shares: across.iter().enumerate().map(share).collect(), fwhm, goes_on })
    }
}

/// Where a side falls to half of the peak, px.
fn half_width(side: impl Iterator<Item = f32>, peak: f32) -> f32 {
    let side: Vec<f32> = side.collect();
    let below = side.iter().position(|value| *value < 0.5 * peak).unwrap_or(side.len() - 1);
    let Some(before) = below.checked_sub(1).map(|n| side[n]) else { return 0.5 };
    below as f32 - 1.0 + ((before - 0.5 * peak) / (before - side[below]).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// Last px of a side that belongs to the trail: then comes the sky, or another trail.
fn last(side: &[f32], noise: f32) -> usize {
    for n in 0..side.len() - 1 {
        let next = side[n + 1..].iter().take(3).fold(f32::NEG_INFINITY, |most, value| most.max(*value));
        let rises = n > 1 && next > 2.0 * side[n].max(0.0) + 0.5 * noise;
        if rises || (n > 0 && next < FLOOR * noise) {
            return n;
        }
    }
    side.len() - 1
}

/// The dashes of light along a path.
struct Dashes {
    /// Length of all, px.
    length: f32,
    is_trail: bool,
    /// First and last station.
    ends: (usize, usize),
}

impl Dashes {
    fn of(strip: &Strip, fwhm: f32) -> Self {
        let (lit, all) = lit(strip, core_of(fwhm, strip.reach), aside_of(fwhm));
        let mut some: Vec<f32> = lit.iter().copied().filter(|light| *light > 0.0).collect();
        let clip = CLIP * median_in_place(&mut some).unwrap_or(0.0);
        let around = medians(&all, 3);
        let is_uneven = |n: &usize| all[*n] < 0.5 * around[*n] || all[*n] > 2.0 * around[*n];
        let (mut length, mut ends, mut dashes, mut stations, mut uneven) = (0.0, None, 0, 0, 0);
        let step = strip.step as f32;
        for (first, last) in runs(&lit) {
            let clipped: Vec<f32> = all[first..=last].iter().map(|light| light.clamp(0.0, clip)).collect();
            let top = clipped.windows(3).map(|three| three.iter().sum::<f32>() / 3.0).fold(0.0, f32::max);
            let effective = if top > 0.0 { step * clipped.iter().sum::<f32>() / top } else { 0.0 };
            if effective >= (DASH.0 * fwhm).max(DASH.1 * step) {
                length += effective;
                dashes += 1;
                stations += last + 1 - first;
                // the ends of a dash are never even
                uneven += (first + 1..last).filter(is_uneven).count();
                ends = Some((ends.map_or(first, |(first, _)| first), last));
            }
        }
        let Some((first, last)) = ends else { return Self { length: 0.0, is_trail: false, ends: (0, 0) } };
        let is_long = length >= (LONG.0 * fwhm).max(LONG.1) && length >= FILLED * step * (last + 1 - first) as f32;
        let is_even = uneven as f32 <= UNEVEN * stations as f32;
        // a blinking trail goes on beyond its last whole dash
        let ends = if dashes > 1 { (0, strip.len() - 1) } else { (first, last) };
        Self { length, is_trail: is_long && is_even, ends }
    }

    /// Whether they are much longer than those on the lines next to the trail.
    fn stand_out(&self, clean: &Clean, path: &Path, step: usize, fwhm: f32) -> bool {
        let aside = |(widths, px): (f32, f32)| (widths * fwhm).max(px);
        let reach = (3.0 * fwhm) as usize + 4;
        let distances = ASIDE.into_iter().map(aside).flat_map(|d| [d, -d]);
        let mut lengths: Vec<f32> =
            distances.map(|d| Dashes::of(&Strip::new(clean, path, step, reach, d), fwhm).length).collect();
        lengths.sort_unstable_by(f32::total_cmp);
        lengths.get(1).is_some_and(|length| self.length > CONTRAST * length)
    }
}

/// Half the core of a trail, px: there its light is looked for.
fn core_of(fwhm: f32, reach: usize) -> usize {
    ((0.5 * fwhm).round() as usize).clamp(1, reach)
}

/// Where the sky next to it is reported, px from the path.
fn aside_of(fwhm: f32) -> std::ops::Range<usize> {
    (1.5 * fwhm) as usize + 1..(3.0 * fwhm) as usize + 3
}

/// The median of each station and `reach` on either side, none below 0.
fn medians(all: &[f32], reach: usize) -> Vec<f32> {
    let finite: Vec<f32> = all.iter().map(|light| if light.is_finite() { *light } else { 0.0 }).collect();
    let smooth = |n: usize| {
        let mut around = finite[n.saturating_sub(reach)..(n + reach + 1).min(finite.len())].to_vec();
        median_in_place(&mut around).unwrap_or(0.0).max(0.0)
    };
    (0..finite.len()).map(smooth).collect()
}

/// First and last of the lit stations without a gap of more than one.
fn runs(lit: &[f32]) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for (n, _) in lit.iter().enumerate().filter(|(_, light)| **light > 0.0) {
        match runs.last_mut() {
            Some((_, last)) if n <= *last + 2 => *last = n,
            _ => runs.push((n, n)),
        }
    }
    runs
}
