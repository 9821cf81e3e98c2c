//! From a frame to its stars and its quality, in one call.

use crate::background::median_in_place;
use crate::camera::Camera;
use crate::candidates;
use crate::clean::Clean;
use crate::defect::SHARPEST_PX;
use crate::frame::{Frame, FrameError};
use crate::grid::Grid;
use crate::matched_filter::{Kernel, Peak, Peaks};
use crate::parallel;
use crate::profile::StarProfile;
use crate::quality::Quality;
use crate::star::{Flags, Star};
use crate::trails;
use crate::window::{Window, WindowMoments};

/// Width assumed when nobody knows better, px; it is measured and the search repeated if it is wrong.
const FIRST_FWHM_PX: f64 = 4.0;
/// Widths between which stars are looked for, px.
const WIDTHS_PX: (f64, f64) = (1.0, 40.0);
/// A kernel that is wrong by more than this is replaced.
const KERNEL_TOLERANCE: f64 = 1.3;
/// ... and one so wide that it runs over sums of 2 x 2 px or more, px, by more than this: to search again costs little, and
/// the width that is handed on is too great for doughnuts.
const WIDE_KERNEL: (f64, f64) = (10.0, 1.2);
/// Defects are looked for again when the stars are wider than was known by this factor: then more defects can be
/// distinguished.
const DEFECTS_AGAIN: f64 = 1.2;
/// Stars that show the width.
const BEST: usize = 50;
/// Significance that such stars should have.
const WELL_SEEN: f32 = 8.0;
/// Where some of them are as sharp as cosmic rays, so many are looked at ...
const MOST_LOOKED_AT: usize = 1000;
/// ... (the work for one of them is that on so many pixels) ...
const PIXELS_OF_WINDOWS: usize = 1 << 13;
/// ... and so many round wider ones, and this share of the sharp ones, are the stars, if they agree within this share of
/// their width or are within this ratio of the last frame's width.
const FEWEST_WIDE: usize = 5;
const WIDE_SHARE: f32 = 0.1;
const WIDE_SPREAD: f32 = 0.2;
const WIDER: f32 = 1.5;
/// A star is longer than wide by no more than this; rays are, at any angle.
const ROUND: f64 = 2.0;

/// How to look for stars.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StarSearch {
    /// Least significance in the matched filter.
    pub threshold: f32,
    /// Width of the stars in the last frame of this camera, px; saves a second search.
    pub fwhm_px: Option<f32>,
}

impl Default for StarSearch {
    fn default() -> Self {
        Self { threshold: 5.0, fwhm_px: None }
    }
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// All stars, the brightest first, flagged ones included.
    pub stars: Vec<Star>,
    /// The frame as a whole.
    pub quality: Quality,
}

/// Cleans a frame, finds its stars and measures them.
///
/// # Errors
/// [`FrameError`] when the frame has no usable sky, or the dark or bad-pixel map have another shape. A frame without
/// stars is no error.
pub fn measure(frame: &Frame, camera: &Camera, search: &StarSearch) -> Result<Measured, FrameError> {
    measure_and_clean(frame, camera, search).map(|(measured, _)| measured)
}

/// The same, with the cleaned frame for those who look closer.
pub(crate) fn measure_and_clean(
    frame: &Frame,
    camera: &Camera,
    search: &StarSearch,
) -> Result<(Measured, Clean), FrameError> {
    // what is as sharp as a defect is no guide for distinguishing stars from defects: it must be seen anew on each
    // frame
    let search = &StarSearch { fwhm_px: search.fwhm_px.filter(|px| px.is_finite() && *px >= SHARPEST_PX), ..*search };
    let mut clean = Clean::new(frame, camera, search.fwhm_px)?;
    let light = RawPixels { frame, saturation: camera.saturation_adu(frame), brightest: clean.brightest_adu };
    let (mut trails, mut found);
    if let Some((as_doughnuts, doughnuts)) = doughnuts(&clean, camera, search, &light)? {
        (clean, trails, found) = (as_doughnuts, trails::FoundTrails::default(), doughnuts);
    } else {
        trails = trails::remove(&mut clean, camera, light.saturation, search.fwhm_px);
        found = find(&mut clean, camera, search, &light, true);
    }
    if let Some(width) = found.width
        && (clean.takes_for_sky(width as f32) || clean.took_for_defects(width as f32, found.objects.len()))
    {
        let again = StarSearch { fwhm_px: Some(width as f32), ..*search };
        clean = Clean::new(frame, camera, again.fwhm_px)?;
        trails = trails::remove(&mut clean, camera, light.saturation, again.fwhm_px);
        found = find(&mut clean, camera, &again, &light, false);
    }
    let mut stars = describe(&clean, camera, &light, &found);
    let quality = Quality::of(&clean, &stars, found.width.is_some(), trails);
    if let Some(trail_px) = quality.trail_px {
        // the star was anywhere on its trail
        let (sin, cos) = quality.elongation_deg.unwrap_or_default().to_radians().sin_cos();
        let along = trail_px / 12.0_f64.sqrt();
        for star in &mut stars {
            star.x_error_px = star.x_error_px.hypot(along * cos);
            star.y_error_px = star.y_error_px.hypot(along * sin);
        }
    }
    Ok((Measured { stars, quality }, clean))
}

/// The stars of a frame that shows, at first sight, wide doughnuts and no trail, by a camera of which nothing is known.
/// Doughnuts in a row look like trails: to know their width first saves looking along all these rows.
fn doughnuts(
    clean: &Clean,
    camera: &Camera,
    search: &StarSearch,
    light: &RawPixels,
) -> Result<Option<(Clean, FoundObjects)>, FrameError> {
    if search.fwhm_px.is_some() {
        return Ok(None);
    }
    let kernel = Kernel::new(FIRST_FWHM_PX as f32);
    let objects = objects(clean, &kernel, &kernel.peaks(clean, search.threshold), light);
    let width = typical_width(clean, camera, light, &objects, (FIRST_FWHM_PX, None)).map(|width| width as f32);
    let Some(width) = width.filter(|width| clean.takes_for_sky(*width)) else {
        return Ok(None);
    };
    let search = StarSearch { fwhm_px: Some(width), ..*search };
    let mut clean = Clean::new(light.frame, camera, search.fwhm_px)?;
    if trails::remove(&mut clean, camera, light.saturation, search.fwhm_px) != trails::FoundTrails::default() {
        // a wide trail may be what the width was measured of
        return Ok(None);
    }
    let found = find(&mut clean, camera, &search, light, false);
    Ok(Some((clean, found)))
}

/// The raw pixels, asked about saturation.
struct RawPixels<'a> {
    frame: &'a Frame<'a>,
    saturation: f32,
    brightest: f32,
}

impl RawPixels<'_> {
    /// Brightest raw pixel within `reach` px, and whether the star is saturated there: at the limit, or with three
    /// pixels at the one value that is the greatest of the whole frame.
    fn peak(&self, x: usize, y: usize, reach: usize) -> (f32, bool) {
        let (mut peak, mut at_top) = (f32::NEG_INFINITY, 0);
        for row in y.saturating_sub(reach)..=y + reach {
            for column in x.saturating_sub(reach)..=x + reach {
                let value = self.frame.value(column, row);
                peak = peak.max(value);
                at_top += usize::from(value == self.brightest);
            }
        }
        (peak, peak >= self.saturation || at_top >= 3)
    }
}

/// Objects, and the width of their stars.
struct FoundObjects {
    objects: Vec<Peak>,
    /// Width of the kernel they were found with, px.
    kernel_px: f64,
    /// Width that was measured, px.
    width: Option<f64>,
}

/// Searches with the expected width, measures the true one, and searches again if they differ too much. Where the frame
/// `may_be_cleaned_again`, a width for which it has to be is the answer: what else is found will be found anew.
fn find(
    clean: &mut Clean,
    camera: &Camera,
    search: &StarSearch,
    light: &RawPixels,
    may_be_cleaned_again: bool,
) -> FoundObjects {
    let expected = search.fwhm_px.map_or(FIRST_FWHM_PX, f64::from);
    let mut kernel_px = if expected.is_finite() { expected.clamp(WIDTHS_PX.0, WIDTHS_PX.1) } else { FIRST_FWHM_PX };
    let mut left = 2;
    loop {
        let kernel = Kernel::new(kernel_px as f32);
        let peaks = kernel.peaks(clean, search.threshold);
        let mut objects = objects(clean, &kernel, &peaks, light);
        let width = typical_width(clean, camera, light, &objects, (kernel_px, search.fwhm_px));
        if may_be_cleaned_again && width.is_some_and(|width| clean.takes_for_sky(width as f32)) {
            return FoundObjects { objects, kernel_px, width };
        }
        let factor = width.map_or(1.0, |width| (width / kernel_px).max(kernel_px / width));
        if let Some(width) = width
            && width >= f64::from(SHARPEST_PX)
            && width > DEFECTS_AGAIN * search.fwhm_px.map_or(0.0, f64::from)
            && clean.fill_defects(0.8 * width as f32) > 0
        {
            // what stood on a defect is gone now
            let least = search.threshold * kernel.sampling_loss() * peaks.scatter;
            objects.retain(|peak| kernel.significance(clean, peak.x, peak.y) > least);
        }
        let tolerance = if kernel_px >= WIDE_KERNEL.0 { WIDE_KERNEL.1 } else { KERNEL_TOLERANCE };
        if factor <= tolerance || left == 0 {
            return FoundObjects { objects, kernel_px, width };
        }
        kernel_px = width.map_or(kernel_px, |width| width.clamp(WIDTHS_PX.0, WIDTHS_PX.1));
        left -= 1;
    }
}

fn objects(clean: &Clean, kernel: &Kernel, peaks: &Peaks, light: &RawPixels) -> Vec<Peak> {
    candidates::objects(clean, kernel, peaks, |peak| light.peak(peak.x, peak.y, 1).1)
}

/// Median width of the best unsaturated stars, px, each seen through a window that grows or shrinks to its size. Known
/// are the kernel's width and, perhaps, that of the stars on the last frame.
fn typical_width(
    clean: &Clean,
    camera: &Camera,
    light: &RawPixels,
    objects: &[Peak],
    (kernel_px, last_px): (f64, Option<f32>),
) -> Option<f64> {
    let good = objects.iter().filter(|peak| peak.significance >= WELL_SEEN);
    let unsaturated = good.filter(|peak| !light.peak(peak.x, peak.y, kernel_px as usize).1);
    let looked_at: Vec<&Peak> = unsaturated.take(MOST_LOOKED_AT).collect();
    let look = |peak: &&Peak| own_width(clean, camera, peak, kernel_px);
    // the first ones are always needed; the others seldom
    let (first, others) = looked_at.split_at(BEST.min(looked_at.len()));
    let first =
        parallel::ranges(first.len(), PIXELS_OF_WINDOWS, |range| first[range].iter().map(look).collect::<Vec<_>>());
    let mut looked = first.into_iter().flatten().chain(others.iter().map(look));
    let best: Vec<Width> = looked.by_ref().take(4 * BEST).flatten().take(BEST).collect();
    let mut widths: Vec<f32> = best.iter().map(|width| width.fwhm as f32).collect();
    let none_is_sharp = widths.iter().all(|width| *width >= SHARPEST_PX);
    let all = median_in_place(&mut widths)?;
    if none_is_sharp {
        return Some(f64::from(all));
    }
    let others = best.into_iter().chain(looked.flatten());
    let (mut rays, mut wide) = (Vec::new(), Vec::new());
    for other in others {
        let width = other.fwhm as f32;
        if width < SHARPEST_PX {
            rays.push(width);
        } else if other.axis_ratio <= ROUND {
            wide.push(width);
        }
        if wide.len() >= BEST {
            break;
        }
    }
    Some(f64::from(width_beside_rays(&mut rays, &wide, last_px).unwrap_or(all)))
}

/// The width of the stars of a frame with rays as well: that of the last frame, if enough have it, or one in which
/// enough agree. None when the sharp ones may be the stars.
fn width_beside_rays(rays: &mut [f32], wide: &[f32], last_px: Option<f32>) -> Option<f32> {
    let rays_px = median_in_place(rays)?;
    let enough = |some: &[f32]| some.len() >= FEWEST_WIDE && some.len() as f32 >= WIDE_SHARE * rays.len() as f32;
    let is_last = |width: &f32| last_px.is_some_and(|last| *width < WIDER * last && last < WIDER * *width);
    let mut as_last: Vec<f32> = wide.iter().copied().filter(is_last).collect();
    let surely_wider = |width: &f32| *width >= WIDER * rays_px;
    if enough(&as_last)
        && let Some(width) = median_in_place(&mut as_last).filter(surely_wider)
    {
        return Some(width);
    }
    let mut wide = wide.to_vec();
    let width = median_in_place(&mut wide).filter(surely_wider)?;
    let mut apart: Vec<f32> = wide.iter().map(|other| (other - width).abs()).collect();
    let spread = 1.4826 * median_in_place(&mut apart)?;
    (enough(&wide) && spread <= WIDE_SPREAD * width).then_some(width)
}

/// The size of one star, px.
struct Width {
    fwhm: f64,
    axis_ratio: f64,
}

fn own_width(clean: &Clean, camera: &Camera, peak: &Peak, kernel_px: f64) -> Option<Width> {
    let mut width = Width { fwhm: kernel_px, axis_ratio: 1.0 };
    let peak = (peak.x as f64, peak.y as f64);
    let mut near = peak;
    for _ in 0..8 {
        let window = Window::new(width.fwhm, camera.gain_e_per_adu);
        let reach = width.fwhm.max(kernel_px);
        // the window before has come near to the middle already
        let seen = window.look(clean, near, reach).filter(|seen| (seen.x - peak.0).hypot(seen.y - peak.1) <= reach)?;
        near = (seen.x, seen.y);
        let new = Width { fwhm: seen.fwhm().clamp(WIDTHS_PX.0, WIDTHS_PX.1), axis_ratio: seen.axis_ratio() };
        if (new.fwhm / width.fwhm - 1.0).abs() < 0.02 {
            return (!seen.cut).then_some(new);
        }
        width = new;
    }
    Some(width)
}

/// Measures all objects through one window and turns them into stars.
fn describe(clean: &Clean, camera: &Camera, light: &RawPixels, found: &FoundObjects) -> Vec<Star> {
    let width = found.width.unwrap_or(found.kernel_px);
    let window = Window::new(width, camera.gain_e_per_adu);
    let seen = parallel::ranges(found.objects.len(), 512, |range| {
        let look = |peak: &Peak| {
            let (peak_adu, saturated) = light.peak(peak.x, peak.y, (0.5 * width).ceil() as usize);
            // only a window that reaches over a flat top finds its middle
            let own =
                if saturated { own_width(clean, camera, peak, width).map_or(width, |own| own.fwhm) } else { width };
            let window = if saturated { Window::new(own, camera.gain_e_per_adu) } else { window };
            let seen = window.look(clean, (peak.x as f64, peak.y as f64), own.max(found.kernel_px))?;
            Some(Object { peak: *peak, seen, peak_adu, saturated })
        };
        found.objects[range].iter().filter_map(look).collect::<Vec<_>>()
    });
    let objects = without_doubles(clean, seen.into_iter().flatten(), 0.5 * width);

    let stackable = |o: &&Object| !o.saturated && !o.seen.cut && o.peak.significance >= WELL_SEEN;
    // rays may be brighter than all stars
    let is_wide = |o: &&Object| o.seen.variance() > 0.36 * (width / 2.354_82).powi(2);
    let best: Vec<&Object> = objects.iter().filter(stackable).filter(is_wide).take(BEST).collect();
    let mut variances: Vec<f32> = best.iter().map(|o| o.seen.variance() as f32).collect();
    let variance = median_in_place(&mut variances).map_or((width / 2.354_82).powi(2), f64::from);
    let starlike = best.iter().filter(|o| o.seen.variance() > 0.36 * variance);
    let stack: Vec<_> = starlike.map(|o| (clean, o.seen.x, o.seen.y, o.seen.flux)).collect();
    // a Gaussian under a window of its own size shows half of its flux
    let gaussian = StarProfile { fwhm_px: width, beta: 30.0 };
    let profile = StarProfile::fit(&stack, width).unwrap_or(gaussian);
    let stretch = profile.fwhm_px / (2.354_82 * variance.sqrt()).max(0.1);
    let whole = profile.whole_over_window(window.sigma());

    let mut stars: Vec<Star> =
        objects.iter().map(|object| object.star(variance, stretch.clamp(0.5, 2.0), whole)).collect();
    stars.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    mark_blended(clean, &mut stars, 2.0 * profile.fwhm_px);
    stars
}

struct Object {
    peak: Peak,
    seen: WindowMoments,
    peak_adu: f32,
    saturated: bool,
}

impl Object {
    /// `variance` is the typical star's, `stretch` turns widths by moments into FWHM, `whole` is the flux of a star
    /// over that in the window.
    fn star(&self, variance: f64, stretch: f64, whole: f64) -> Star {
        let seen = &self.seen;
        let ratio = seen.axis_ratio();
        Star {
            x_px: seen.x,
            y_px: seen.y,
            x_error_px: seen.error.0,
            y_error_px: seen.error.1,
            flux_adu: whole * seen.flux,
            flux_error_adu: whole * seen.flux_error,
            snr: seen.flux / seen.flux_error,
            significance: f64::from(self.peak.significance),
            peak_adu: f64::from(self.peak_adu),
            fwhm_px: stretch * seen.fwhm(),
            ellipticity: 1.0 - 1.0 / ratio,
            angle_deg: seen.angle.to_degrees(),
            flags: Flags {
                saturated: self.saturated,
                // widths of faint stars scatter: sharper than 0.6 of the width beyond doubt
                cosmic: seen.variance() + 1.5 * seen.variance_error < 0.36 * variance,
                trailed: ratio > 1.6 && seen.major - seen.minor > 3.0 * seen.variance_error,
                edge: seen.cut,
                blended: false,
            },
        }
    }
}

/// Drops objects whose windows ran into the same star, keeping the more significant.
fn without_doubles(clean: &Clean, objects: impl Iterator<Item = Object>, reach: f64) -> Vec<Object> {
    let mut grid = Grid::new(clean.width, clean.height, reach as f32);
    let mut retained = Vec::new();
    for object in objects {
        let (x, y) = (object.seen.x as f32, object.seen.y as f32);
        if grid.near(x, y, reach as f32).next().is_none() {
            grid.add(x, y);
            retained.push(object);
        }
    }
    retained
}

/// Flags stars with a neighbour of at least a tenth of their flux within `reach` px.
fn mark_blended(clean: &Clean, stars: &mut [Star], reach: f64) {
    let mut grid = Grid::new(clean.width, clean.height, reach as f32);
    stars.iter().for_each(|star| grid.add(star.x_px as f32, star.y_px as f32));
    let blended: Vec<bool> = stars
        .iter()
        .enumerate()
        .map(|(n, star)| {
            let mut near = grid.near(star.x_px as f32, star.y_px as f32, reach as f32);
            near.any(|other| other != n && stars[other].flux_adu > 0.1 * star.flux_adu)
        })
        .collect();
    stars.iter_mut().zip(blended).for_each(|(star, blended)| star.flags.blended = blended);
}
