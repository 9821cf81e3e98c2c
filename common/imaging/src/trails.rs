//! Trails of satellites and aircraft: found and taken out before stars are looked for.
//!
//! A trail is a straight or slightly bent line of light, longer than anything else on the sky and even along its length.
//! In coarse pixels ([`map`]) its pixels lie on ridges that vote for one line ([`ridge`]); at full resolution the light
//! along that line ([`path`]) proves it or not ([`trail`]). Its model is taken away, and what is left on it becomes sky
//! unless it stands out as a star does ([`fill`]).
//!
//! Many trails of one length and direction are the stars themselves, drawn out because the mount did not follow: they are
//! counted and left as they are.

mod fill;
mod map;
mod path;
mod ridge;
mod trail;

use crate::background::median_in_place;
use crate::camera::Camera;
use crate::clean::Clean;
use crate::parallel;
use map::Map;
use ridge::RidgeLine;
use trail::Trail;

/// Lines that are looked at in one map, at most.
const MOST_LINES: usize = 16;
/// A dash of a trail is at least so many widths of the stars long: it is as wide as they are, or wider ([`trail`] asks for
/// five of its own widths; stars may be a little narrower than was known). Wide doughnuts in a row are shorter.
const SHORTEST_DASH: f32 = 3.0;
/// The work of looking along one line, as that on so many pixels.
const PIXELS_OF_LINE: usize = 1 << 18;
/// Trails of one direction (rad) that are not satellites any more, of any length ...
const MANY: usize = 8;
const SAME_DIRECTION: f32 = 0.05;
/// ... or whole and of one length within this share.
const MANY_ALIKE: usize = 5;
const SAME_LENGTH: f32 = 0.2;

/// What was found in a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct FoundTrails {
    /// Trails that were taken out.
    pub(crate) removed: usize,
    /// Length of the stars themselves where they are drawn out into trails, px.
    pub(crate) stars_px: Option<f32>,
}

/// Takes the trails out of a frame whose stars are `fwhm_px` wide, if that is known.
pub(crate) fn remove(clean: &mut Clean, camera: &Camera, saturation: f32, fwhm_px: Option<f32>) -> FoundTrails {
    let trails = find(clean, saturation, fwhm_px);
    if trails.is_empty() {
        return FoundTrails::default();
    }
    if let Some(length) = length_of_stars(&trails) {
        return FoundTrails { removed: 0, stars_px: Some(length) };
    }
    for trail in &trails {
        fill::fill(clean, camera.gain_e_per_adu, trail);
    }
    FoundTrails { removed: trails.len(), stars_px: None }
}

/// The trails of a frame, each once.
fn find(clean: &Clean, saturation: f32, fwhm_px: Option<f32>) -> Vec<Trail> {
    let lines = lines(clean, SHORTEST_DASH * fwhm_px.unwrap_or(0.0));
    let proven = parallel::ranges(lines.len(), PIXELS_OF_LINE, |range| {
        lines[range].iter().map(|line| Trail::along(clean, *line, saturation)).collect::<Vec<_>>()
    });
    let mut trails: Vec<Trail> = Vec::new();
    for trail in proven.into_iter().flatten().flatten() {
        if !trails.iter().any(|known| is_same(known, &trail)) {
            trails.push(trail);
        }
    }
    trails
}

/// Lines that may be trails, from the finest map to the coarsest; each has a dash of light of at least `dash_px`.
fn lines(clean: &Clean, dash_px: f32) -> Vec<RidgeLine> {
    let mut lines = Vec::new();
    let mut map = Some(Map::new(clean));
    while let Some(here) = map {
        let mut ridges = ridge::ridges(&here);
        let voted = (0..MOST_LINES).map_while(|_| ridge::best_line(&here, &mut ridges));
        lines.extend(voted.filter(|line| ridge::longest_dash_px(&here, line) >= dash_px));
        map = here.coarser();
    }
    lines
}

/// Whether two trails lie on one line, as one that is seen in two maps does.
fn is_same(a: &Trail, b: &Trail) -> bool {
    let (first, last) = b.ends();
    let reach = (0.5 * (a.fwhm + b.fwhm)).max(3.0);
    let on = |share: f32| {
        let (x, y) = b.path.place(first + share * (last - first), 0.0);
        let (t, d) = a.path.along_and_across(x, y);
        let (from, to) = a.ends();
        d.abs() < reach && (from - reach..to + reach).contains(&t)
    };
    [0.1, 0.3, 0.5, 0.7, 0.9].into_iter().filter(|share| on(*share)).count() >= 3
}

/// Length of the stars where they are what is drawn out, px.
fn length_of_stars(trails: &[Trail]) -> Option<f32> {
    trails.iter().find_map(|one| {
        let parallel: Vec<&Trail> = trails
            .iter()
            .filter(|other| ridge::turned(one.path.angle(), other.path.angle()) < SAME_DIRECTION)
            .collect();
        let whole = parallel.iter().filter(|trail| trail.is_cut() == (false, false));
        let mut lengths: Vec<f32> = whole.map(|trail| trail.length()).collect();
        let typical = median_in_place(&mut lengths);
        let is_alike = |length: &&f32| typical.is_some_and(|typical| (*length / typical - 1.0).abs() < SAME_LENGTH);
        let many = parallel.len() > MANY || lengths.iter().filter(is_alike).count() >= MANY_ALIKE;
        let longest = || parallel.iter().map(|trail| trail.length()).fold(0.0, f32::max);
        many.then(|| typical.unwrap_or_else(longest))
    })
}
