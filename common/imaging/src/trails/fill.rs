//! A trail's light taken out of the frame.

use std::collections::HashSet;

use super::trail::Trail;
use crate::clean::Clean;

/// Light of the trail below this share of the noise is left.
const NOTHING: f32 = 0.2;
/// What stands out of the most light that the trail has thereabouts by so many standard deviations and this share of its light is a star.
const STAR: (f32, f32) = (5.0, 0.3);
/// ... if so many of the eight pixels around do too.
const FEWEST: usize = 2;

/// A pixel of the trail.
struct Pixel {
    at: usize,
    x: isize,
    y: isize,
    /// The trail's light, ADU.
    model: f32,
    /// Whether the noise of the trail's light is more than the sky's.
    is_bright: bool,
    /// Whether more light than the trail's is there.
    stands_out: bool,
}

/// Takes a trail away. Its noise goes too, except where a star shines through.
pub(super) fn fill(clean: &mut Clean, gain_e_per_adu: f32, trail: &Trail) {
    let pixels = pixels(clean, gain_e_per_adu, trail);
    let bright: HashSet<(isize, isize)> = pixels.iter().filter(|p| p.stands_out).map(|p| (p.x, p.y)).collect();
    let around = |x: isize, y: isize, reach: isize| {
        (y - reach..=y + reach).flat_map(move |y| (x - reach..=x + reach).map(move |x| (x, y)))
    };
    let is_star = |at: &&(isize, isize)| around(at.0, at.1, 1).filter(|other| bright.contains(other)).count() > FEWEST;
    let reach = trail.fwhm.clamp(1.0, 16.0).ceil() as isize;
    let spared: HashSet<(isize, isize)> =
        bright.iter().filter(is_star).flat_map(|(x, y)| around(*x, *y, reach)).collect();
    for pixel in &pixels {
        let value = &mut clean.pixels[pixel.at];
        let keep = !pixel.is_bright || spared.contains(&(pixel.x, pixel.y));
        *value = if keep { *value - pixel.model } else { 0.0 };
    }
}

fn pixels(clean: &Clean, gain_e_per_adu: f32, trail: &Trail) -> Vec<Pixel> {
    let half = trail.half_width();
    let (first, last) = trail.reaches();
    let (from, to) = (trail.path.place(first, 0.0), trail.path.place(last, 0.0));
    let angle = trail.path.angle();
    let is_flat = angle.cos().abs() > angle.sin().abs();
    let (steepness, length) = if is_flat { (angle.cos(), clean.width) } else { (angle.sin(), clean.height) };
    let (a, b) = if is_flat { (from.0, to.0) } else { (from.1, to.1) };
    let reach = half / steepness.abs() + 2.0;
    let range = |a: f32, b: f32, length: usize| {
        (a.min(b).floor().max(0.0) as usize).min(length)..((a.max(b).ceil() + 1.0).max(0.0) as usize).min(length)
    };
    let mut found = Vec::new();
    for major in range(a - half, b + half, length).start..range(a - half, b + half, length).end {
        // where the path crosses this column or row
        let share = if (b - a).abs() > 0.0 { (major as f32 - a) / (b - a) } else { 0.0 };
        let (x, y) = trail.path.place(first + share * (last - first), 0.0);
        let (minor, across) = if is_flat { (y, clean.height) } else { (x, clean.width) };
        for minor in range(minor - reach, minor + reach, across) {
            let (x, y) = if is_flat { (major, minor) } else { (minor, major) };
            let (t, d) = trail.path.along_and_across(x as f32, y as f32);
            if t < first || t > last || d.abs() > half {
                continue;
            }
            let (model, most) = trail.light_at(t, d);
            let (at, noise) = (y * clean.width + x, clean.background.noise.at(x, y));
            if most < NOTHING * noise {
                continue;
            }
            let scatter = (noise * noise + most / gain_e_per_adu.max(f32::MIN_POSITIVE)).sqrt();
            let stands_out = clean.pixels[at] - most > STAR.0 * scatter + STAR.1 * most;
            found.push(Pixel { at, x: x as isize, y: y as isize, model, is_bright: most > noise, stands_out });
        }
    }
    found
}
