//! Half-flux diameters: the size of stars that grows evenly with the defocus, rings included.
//!
//! The HFD is the diameter of the circle that holds half of a star's light. It is the FWHM for a Gaussian, 0.707 D for
//! a disc of diameter D, and for the ring of a telescope with a secondary mirror linear in the defocus too
//! (docs/formulae.md, "Half-flux diameter"). Each frame is searched anew; the sky comes from a ring around each star,
//! neighbours are covered by what lies on the other side of the star, and large stars are looked for in binned frames.

mod aperture;

use crate::camera::Camera;
use crate::clean::Clean;
use crate::frame::{Frame, FrameError, Pixels};
use crate::measure::{StarSearch, measure_and_clean};
use crate::parallel;
use crate::quality::Estimate;
use crate::star::Star;

/// How to look for sizes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HfdSearch {
    /// HFD of the stars as far as known (the last frame, the curve so far), px. It saves time and need not be right.
    pub expected_px: Option<f64>,
    /// At most so many stars, the brightest that are not saturated.
    pub most_stars: usize,
    /// Least signal-to-noise of a star's flux.
    pub least_snr: f64,
}

impl Default for HfdSearch {
    fn default() -> Self {
        Self { expected_px: None, most_stars: 100, least_snr: 10.0 }
    }
}

/// The size of one star. Places and sizes in px of the frame as it was given, binned or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StarHfd {
    /// Column of the centre of light, px.
    pub x_px: f64,
    /// Row of the centre of light, px.
    pub y_px: f64,
    /// Half-flux diameter, px.
    pub hfd_px: f64,
    /// Its standard error from sky and photon noise, px.
    pub error_px: f64,
    /// Flux, ADU.
    pub flux_adu: f64,
    /// Flux over its error.
    pub snr: f64,
}

/// The size of the stars of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameHfd {
    /// Weighted median of the HFD, px.
    pub hfd_px: Estimate,
    /// The stars it was taken from, the brightest first.
    pub stars: Vec<StarHfd>,
    /// Pixels that were added up along each axis before the search.
    pub binning: usize,
}

/// Why a frame has no HFD.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoHfd {
    /// The frame cannot be measured at all.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// No star is bright enough, whole and unsaturated.
    #[error("of {found} stars none can be sized; {saturated} of them are saturated")]
    NoStar {
        /// Stars that were found.
        found: usize,
        /// Those that are saturated.
        saturated: usize,
    },
}

/// Stars larger than this are searched in a frame binned by 2, 4 or 8, px.
const LARGE_PX: f64 = 10.0;
const COARSEST: usize = 8;
/// A binned frame has at least this many px along its shorter side.
const SHORTEST_PX: usize = 48;
/// With fewer stars a coarser search is tried too.
const FEW: usize = 3;
/// HFD that is tried first when nothing is known, px.
const FIRST_PX: f64 = 4.0;
/// Beyond this signal-to-noise a star weighs no more: seeing and neighbours limit it.
const ENOUGH_SNR: f64 = 100.0;
/// Stars whose centres are nearer than this share of the HFD are one (pieces of a ring).
const SAME: f64 = 0.75;

/// The HFD of a frame's stars.
///
/// # Errors
/// [`NoHfd`] when the frame has no sky, or no star that can be sized.
pub fn measure_hfd(frame: &Frame, camera: &Camera, search: &HfdSearch) -> Result<FrameHfd, NoHfd> {
    let mut expected = search.expected_px.filter(|px| px.is_finite() && *px > 0.0);
    let coarsest = [1, 2, 4, COARSEST].into_iter().rfind(|n| frame.width().min(frame.height()) / n >= SHORTEST_PX);
    let coarsest = coarsest.unwrap_or(1);
    let fitting = |hfd_px: f64| [1, 2, 4, COARSEST].into_iter().find(|n| hfd_px <= LARGE_PX * *n as f64);
    let binning_for = |hfd_px: f64| fitting(hfd_px).unwrap_or(COARSEST).min(coarsest);
    let mut binning = expected.map_or(1, binning_for);
    let mut tried: Vec<(usize, BinnedSearch)> = Vec::new();
    loop {
        let attempt = attempt(frame, camera, search, expected, binning)?;
        let count = attempt.stars.len();
        let size = attempt.size();
        tried.push((binning, attempt));
        let is_new = |wanted: &usize| tried.iter().all(|(binning, _)| binning != wanted);
        let next = match size {
            // what is found says how coarse to look
            Some(size) if count >= FEW => Some(binning_for(size.value)).filter(is_new),
            _ => [1, 2, 4, COARSEST].into_iter().filter(|n| *n <= coarsest).find(is_new),
        };
        let Some(next) = next else { break };
        expected = size.filter(|_| count >= FEW).map(|size| size.value).or(Some(FIRST_PX * next as f64));
        binning = next;
    }
    let (found, saturated) = tried.iter().fold((0, 0), |(f, s), (_, a)| (f.max(a.found), s.max(a.saturated)));
    // the search that fits what it found; else the one with the most stars
    let fits = |(binning, attempt): &(usize, BinnedSearch)| {
        attempt.size().is_some_and(|size| binning_for(size.value) == *binning)
    };
    let rating = |tried: &(usize, BinnedSearch)| (tried.1.stars.len() >= FEW && fits(tried), tried.1.stars.len());
    let best = tried.into_iter().max_by_key(rating);
    let sized = best.and_then(|(binning, attempt)| {
        let hfd_px = attempt.size()?;
        Some(FrameHfd { hfd_px, stars: attempt.stars, binning })
    });
    sized.ok_or(NoHfd::NoStar { found, saturated })
}

/// The HFD of stars at known places of a clean frame, px; None for those without one.
pub fn hfd_at(clean: &Clean, gain_e_per_adu: f32, places: &[(f64, f64)], expected_px: f64) -> Vec<Option<StarHfd>> {
    let neighbours: Vec<aperture::Neighbour> = places.iter().map(|(x, y)| (*x, *y, 1.5 * expected_px)).collect();
    let gain = f64::from(gain_e_per_adu.max(f32::MIN_POSITIVE));
    let look = |place: &(f64, f64)| {
        let near = near(&neighbours, *place, 0.0, 8.0 * expected_px);
        aperture::look(clean, gain, *place, expected_px, &near)
    };
    in_parallel(places, look)
}

/// Pixels that are looked at for one star, with sky and all looks: some thousands.
const PIXELS_A_STAR: usize = 4096;

/// What `look` says of each, in order, on all cores.
fn in_parallel<T: Sync, A: Send>(of: &[T], look: impl Fn(&T) -> A + Sync) -> Vec<A> {
    let parts = parallel::ranges(of.len(), PIXELS_A_STAR, |range| of[range].iter().map(&look).collect::<Vec<A>>());
    parts.into_iter().flatten().collect()
}

/// One search at one binning, in px of the frame as it came.
struct BinnedSearch {
    stars: Vec<StarHfd>,
    found: usize,
    saturated: usize,
}

impl BinnedSearch {
    fn size(&self) -> Option<Estimate> {
        let mut sizes: Vec<(f64, f64)> = self.stars.iter().map(|s| (s.hfd_px, s.snr.min(ENOUGH_SNR))).collect();
        let value = weighted_median(&mut sizes)?;
        let mut off: Vec<(f64, f64)> = self.stars.iter().map(|s| ((s.hfd_px - value).abs(), 1.0)).collect();
        let scatter = 1.25 * 1.482_6 * weighted_median(&mut off)? / (self.stars.len() as f64).sqrt();
        // of one or two stars the scatter says nothing: noise sets the least error
        let weight: f64 = self.stars.iter().map(|s| s.error_px.powi(-2)).sum();
        Some(Estimate { value, error: scatter.max(1.25 / weight.sqrt()) })
    }
}

fn attempt(
    frame: &Frame,
    camera: &Camera,
    search: &HfdSearch,
    expected: Option<f64>,
    binning: usize,
) -> Result<BinnedSearch, FrameError> {
    let scale = binning as f64;
    let hint = StarSearch { fwhm_px: expected.map(|px| (px / scale) as f32), ..StarSearch::default() };
    if binning == 1 {
        let (measured, clean) = measure_and_clean(frame, camera, &hint)?;
        return Ok(size_all(frame, camera, search, &measured.stars, &clean, &clean, expected, 1));
    }
    let clean = Clean::new(frame, camera, expected.map(|px| px as f32))?;
    let (width, pixels) = binned(&clean, binning);
    let small = Frame::new(width, pixels.len() / width.max(1), Pixels::F32(&pixels))?;
    // a mean of n^2 pixels holds n^2 times the electrons per ADU
    let small_camera = Camera { gain_e_per_adu: camera.gain_e_per_adu * (scale * scale) as f32, ..Camera::default() };
    let (measured, small_clean) = measure_and_clean(&small, &small_camera, &hint)?;
    Ok(size_all(frame, camera, search, &measured.stars, &small_clean, &clean, expected, binning))
}

/// Sizes the stars found in `looked_at`, which is `whole` binned.
#[allow(clippy::too_many_arguments)] // one search in one place
fn size_all(
    frame: &Frame,
    camera: &Camera,
    search: &HfdSearch,
    stars: &[Star],
    looked_at: &Clean,
    whole: &Clean,
    expected: Option<f64>,
    binning: usize,
) -> BinnedSearch {
    let scale = binning as f64;
    let gain = f64::from(camera.gain_e_per_adu.max(f32::MIN_POSITIVE)) * scale * scale;
    let usual = expected.map_or(FIRST_PX, |px| px / scale);
    let saturation = camera.saturation_adu(frame);
    let (mut sized, mut others): (Vec<StarHfd>, Vec<aperture::Neighbour>) = (Vec::new(), Vec::new());
    let mut saturated = 0;
    let stars: Vec<&Star> = stars.iter().filter(|star| !star.flags.cosmic).collect();
    let look = |star: &&Star| {
        let start = usual.max(star.fwhm_px.min(2.0 * usual));
        aperture::look(looked_at, gain, (star.x_px, star.y_px), start, &[])
    };
    // as many at once as are wanted: most of them will do
    for some in stars.chunks(search.most_stars.max(1)) {
        for (star, found) in some.iter().zip(in_parallel(some, look)) {
            if sized.len() >= search.most_stars {
                break;
            }
            let Some(found) = found else {
                others.push((star.x_px, star.y_px, 1.5 * usual));
                continue;
            };
            let is_same = |other: &StarHfd| {
                (other.x_px - found.x_px).hypot(other.y_px - found.y_px) < SAME * other.hfd_px.max(found.hfd_px)
            };
            if sized.iter().any(is_same) {
                continue;
            }
            if star.flags.saturated || is_saturated(frame, whole, saturation, &found, scale) {
                saturated += 1;
                others.push((found.x_px, found.y_px, 2.0 * found.hfd_px));
            } else {
                sized.push(found);
            }
        }
        if sized.len() >= search.most_stars {
            break;
        }
    }
    others.extend(sized.iter().map(|star| (star.x_px, star.y_px, 1.5 * star.hfd_px)));
    let again = |star: &StarHfd| {
        let near = near(&others, (star.x_px, star.y_px), SAME * star.hfd_px, 8.0 * star.hfd_px);
        let alone = if near.is_empty() { Some(*star) } else { None };
        alone.or_else(|| aperture::look(looked_at, gain, (star.x_px, star.y_px), star.hfd_px, &near))
    };
    let seen = in_parallel(&sized, again).into_iter().flatten().filter(|star| star.snr >= search.least_snr);
    let stars = seen.map(|star| unbinned(&star, scale)).collect();
    BinnedSearch { stars, found: sized.len() + saturated, saturated }
}

/// Neighbours between two distances from a place.
fn near(all: &[aperture::Neighbour], place: (f64, f64), from: f64, to: f64) -> Vec<aperture::Neighbour> {
    let apart = |other: &&aperture::Neighbour| (other.0 - place.0).hypot(other.1 - place.1);
    all.iter().filter(|other| apart(other) > from && apart(other) < to).copied().collect()
}

/// In px of the whole frame: the middle of the first n x n pixels lies at (n - 1) / 2. A mean's flux is n^2 times less.
fn unbinned(star: &StarHfd, scale: f64) -> StarHfd {
    let place = |at: f64| scale * at + 0.5 * (scale - 1.0);
    StarHfd {
        x_px: place(star.x_px),
        y_px: place(star.y_px),
        hfd_px: scale * star.hfd_px,
        error_px: scale * star.error_px,
        flux_adu: scale * scale * star.flux_adu,
        snr: star.snr,
    }
}

/// Whether a pixel of the star, other than those known to be bad, is at or above the limit.
fn is_saturated(frame: &Frame, whole: &Clean, limit: f32, star: &StarHfd, scale: f64) -> bool {
    if whole.brightest_adu < limit {
        return false;
    }
    let star = unbinned(star, scale);
    let reach = 0.75 * star.hfd_px + 1.0;
    let range = |at: f64, length: usize| {
        let bound = |at: f64| (at.max(0.0) as usize).min(length);
        bound((at - reach).ceil())..bound(at + reach + 1.0)
    };
    range(star.y_px, frame.height()).any(|y| {
        range(star.x_px, frame.width()).any(|x| {
            let number = (y * frame.width() + x) as u32;
            frame.value(x, y) >= limit && whole.filled.binary_search(&number).is_err()
        })
    })
}

/// Means of n x n pixels with the sky left in, defects filled; answers the width, too.
fn binned(clean: &Clean, binning: usize) -> (usize, Vec<f32>) {
    let (width, height) = (clean.width / binning, clean.height / binning);
    let mut pixels = vec![0.0; width * height];
    let mut level = vec![0.0; clean.width];
    let share = 1.0 / (binning * binning) as f32;
    for row in 0..height * binning {
        clean.background.level.row(row, &mut level);
        let line = clean.pixels[row * clean.width..][..clean.width].chunks_exact(binning);
        let out = &mut pixels[row / binning * width..][..width];
        for ((to, from), level) in out.iter_mut().zip(line).zip(level.chunks_exact(binning)) {
            *to += share * (from.iter().sum::<f32>() + level.iter().sum::<f32>());
        }
    }
    (width, pixels)
}

/// The value at which half of the weight is reached, half-way between two if it falls between them.
fn weighted_median(values: &mut [(f64, f64)]) -> Option<f64> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    for (n, (value, weight)) in values.iter().enumerate() {
        below += weight;
        if below > half * (1.0 + 1e-12) {
            return Some(*value);
        }
        if below >= half * (1.0 - 1e-12) {
            return Some(values.get(n + 1).map_or(*value, |next| 0.5 * (value + next.0)));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weighted_median_splits_the_weight() {
        assert_eq!(weighted_median(&mut [(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]), Some(2.0));
        assert_eq!(weighted_median(&mut [(4.0, 1.0), (1.0, 1.0)]), Some(2.5));
        assert_eq!(weighted_median(&mut [(1.0, 1.0), (2.0, 1.0), (9.0, 5.0)]), Some(9.0));
        assert_eq!(weighted_median(&mut []), None);
    }
}
