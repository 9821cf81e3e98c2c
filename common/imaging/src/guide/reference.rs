//! The stars of the reference frame, and how far they have moved in another: measured in boxes around the places
//! where they should be, without a search of the whole frame.
//!
//! In each box a Gaussian of the stars' width finds the star and a Gaussian window its place, as in
//! [`crate::measure()`]. All places together give shift and rotation with their covariance. What never moves while the
//! others do is a hot pixel and is dropped.

use super::patch::FramePatch;
use super::usable;
use crate::camera::Camera;
use crate::clean::Clean;
use crate::frame::Frame;
use crate::matched_filter::Kernel;
use crate::parallel;
use crate::profile::StarProfile;
use crate::projection::{self, Profiles};
use crate::shift::{self, NoShift, Shift};
use crate::star::{Flags, Star, spread_evenly};
use crate::window::Window;

/// Stars that are kept.
const STARS: usize = 50;
/// Brightest stars in a box that are looked at.
const LEAST_SIGNIFICANCE: f32 = 5.0;
/// Stars whose significance in the reference is below this are not worth a box.
const WORTH_A_BOX: f64 = 8.0;
/// A star is looked for within this distance of where it should be, px: the reach of guiding between two frames.
const REACH_PX: f64 = 12.0;
/// Sky around that, in FWHM.
const MARGIN_FWHM: f64 = 3.0;
/// A star that stayed within this of its first place while the field moved by more did not move, px.
const STILL_PX: f64 = 0.1;
const MOVED_PX: f64 = 0.5;
/// So many frames in a row show that it never will.
const STILL_FRAMES: u32 = 5;

/// What a frame says of the field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// How far the stars moved since the reference, with covariance, number and transparency.
    pub shift: Shift,
    /// Median width of the stars, px; None where projections were compared.
    pub fwhm_px: Option<f64>,
}

/// Where the stars of a field stand on the detector.
#[derive(Debug, Clone)]
pub struct Reference {
    width: usize,
    height: usize,
    fwhm_px: f64,
    stars: Vec<Star>,
    /// Frames in a row in which each star stayed where it was while the field moved.
    still: Vec<u32>,
    profiles: Option<Profiles>,
}

/// A star that was seen in its box: through the window, and where in the box.
struct InBox {
    star: Star,
    place: (f64, f64),
    patch: FramePatch,
}

/// The stars with their whole flux, as star lists have it: by the frame's own profile, so that neither the wings of the
/// stars nor the seeing look like clouds.
fn whole(seen: Vec<(usize, InBox)>, window: Window) -> Vec<(usize, Star)> {
    let mut widths: Vec<f32> = seen.iter().map(|(_, seen)| seen.star.fwhm_px as f32).collect();
    let width = crate::background::median_in_place(&mut widths).map_or(1.0, f64::from).max(1.0);
    let stack: Vec<_> = seen.iter().map(|(_, s)| (&s.patch.clean, s.place.0, s.place.1, s.star.flux_adu)).collect();
    // of a Gaussian a window of its own width shows half
    let whole = StarProfile::fit(&stack, width).map_or(2.0, |profile| profile.whole_over_window(window.sigma()));
    let star =
        |star: Star| Star { flux_adu: whole * star.flux_adu, flux_error_adu: whole * star.flux_error_adu, ..star };
    seen.into_iter().map(|(n, seen)| (n, star(seen.star))).collect()
}

impl Reference {
    /// From the star lists of the first frames (two or three are better than one), of so many columns and rows. All
    /// lists are shifted to the first; a star is kept if most of them show it.
    ///
    /// # Errors
    /// [`NoShift`] when there is no list with a good star, or the lists do not match.
    pub fn from_lists(lists: &[Vec<Star>], width: usize, height: usize) -> Result<Self, NoShift> {
        let good = |star: &&Star| {
            let Flags { saturated, edge, cosmic, blended, trailed: _ } = star.flags;
            !(saturated || edge || cosmic || blended) && star.significance >= WORTH_A_BOX
        };
        let first: Vec<Star> = lists.first().into_iter().flatten().filter(good).copied().collect();
        let mut sums: Vec<(Star, u32)> =
            spread_evenly(&first, width, height, STARS).into_iter().map(|s| (s, 1)).collect();
        if sums.is_empty() {
            return Err(NoShift::TooFewStars { reference: 0, check: 0 });
        }
        for list in &lists[1..] {
            let moved = shift::from_stars(&first, list, width, height)?;
            for (star, count) in &mut sums {
                let (x, y) = moved.apply(star.x_px, star.y_px, width, height);
                let near = list.iter().map(|other| ((other.x_px - x).hypot(other.y_px - y), other));
                if let Some((apart, other)) = near.min_by(|a, b| a.0.total_cmp(&b.0))
                    && apart < 1.0
                {
                    let share = 1.0 / f64::from(*count + 1);
                    star.x_px += share * (other.x_px - x);
                    star.y_px += share * (other.y_px - y);
                    star.flux_adu += share * (other.flux_adu - star.flux_adu);
                    *count += 1;
                }
            }
        }
        let stars: Vec<Star> = sums
            .into_iter()
            .filter(|(_, count)| 2 * *count as usize > lists.len())
            .map(|(mut star, count)| {
                let less = f64::from(count).sqrt();
                (star.x_error_px, star.y_error_px) = (star.x_error_px / less, star.y_error_px / less);
                star
            })
            .collect();
        let mut widths: Vec<f32> = stars.iter().map(|star| star.fwhm_px as f32).collect();
        let none = NoShift::TooFewStars { reference: 0, check: lists.len() };
        let fwhm_px = f64::from(crate::background::median_in_place(&mut widths).ok_or(none)?).max(1.0);
        Ok(Self { width, height, fwhm_px, still: vec![0; stars.len()], stars, profiles: None })
    }

    /// With the sums over rows and columns of the first frame as well, for fields whose stars cannot be distinguished.
    #[must_use]
    pub fn with_profiles(mut self, clean: &Clean) -> Self {
        self.profiles = Some(Profiles::of(clean));
        self
    }

    /// Stars that take part.
    pub fn stars(&self) -> &[Star] {
        &self.stars
    }

    /// How far the stars moved. They are looked for within 12 px of where the reference has them, moved by
    /// `expected_px` (x, y).
    ///
    /// # Errors
    /// [`NoShift`] when the frame has another shape, shows too few of the stars, or the shift is too uncertain to
    /// guide on.
    pub fn measure(&mut self, frame: &Frame, camera: &Camera, expected_px: [f64; 2]) -> Result<Measurement, NoShift> {
        if (frame.width(), frame.height()) != (self.width, self.height) {
            return Err(NoShift::Shapes(self.width, self.height, frame.width(), frame.height()));
        }
        let expected = expected_px.map(|value| if value.is_finite() { value } else { 0.0 });
        let kernel = Kernel::new(self.fwhm_px as f32);
        let seen = parallel::ranges(self.stars.len(), 4096, |range| {
            self.stars[range].iter().map(|star| self.look(frame, camera, &kernel, star, expected)).collect::<Vec<_>>()
        });
        let seen: Vec<(usize, InBox)> =
            seen.into_iter().flatten().enumerate().filter_map(|(n, seen)| Some((n, seen?))).collect();
        self.compare(whole(seen, Window::new(self.fwhm_px, camera.gain_e_per_adu)))
    }

    /// The same from the star list of a whole frame, for a field that moved by any amount.
    ///
    /// # Errors
    /// [`NoShift`] as [`shift::from_stars`].
    pub fn register(&self, stars: &[Star]) -> Result<Measurement, NoShift> {
        let shift = usable(shift::from_stars(&self.stars, stars, self.width, self.height)?)?;
        let mut widths: Vec<f32> = stars.iter().map(|star| star.fwhm_px as f32).collect();
        Ok(Measurement { shift, fwhm_px: crate::background::median_in_place(&mut widths).map(f64::from) })
    }

    /// The same from the sums over rows and columns of a cleaned frame.
    ///
    /// # Errors
    /// [`NoShift`] when the reference has no profiles, or a correlation has no clear peak.
    pub fn project(&self, clean: &Clean) -> Result<Measurement, NoShift> {
        let profiles = self.profiles.as_ref().ok_or(NoShift::TooFewStars { reference: 0, check: 0 })?;
        let shift = usable(projection::between(profiles, &Profiles::of(clean))?)?;
        Ok(Measurement { shift, fwhm_px: None })
    }

    /// Looks for one star.
    fn look(&self, frame: &Frame, camera: &Camera, kernel: &Kernel, star: &Star, expected: [f64; 2]) -> Option<InBox> {
        let centre = (star.x_px + expected[0], star.y_px + expected[1]);
        let half_px = REACH_PX + MARGIN_FWHM * self.fwhm_px;
        let patch = FramePatch::cut(frame, camera, centre, half_px, self.fwhm_px as f32)?;
        let (left, top) = (patch.left as f64, patch.top as f64);
        let there = (centre.0 - left, centre.1 - top);
        let peaks = kernel.peaks(&patch.clean, LEAST_SIGNIFICANCE).peaks;
        let near = peaks.iter().filter(|p| (p.x as f64 - there.0).hypot(p.y as f64 - there.1) <= REACH_PX);
        let window = Window::new(self.fwhm_px, camera.gain_e_per_adu);
        let peak = near.max_by(|a, b| a.significance.total_cmp(&b.significance))?;
        let seen = window.look(&patch.clean, (peak.x as f64, peak.y as f64), self.fwhm_px.max(2.0))?;
        let peak_adu = f64::from(frame.value((left + seen.x).round() as usize, (top + seen.y).round() as usize));
        let saturated = peak_adu >= f64::from(camera.saturation_adu(frame));
        let is_good = !saturated && !seen.cut && seen.flux.is_finite();
        let star = || Star {
            x_px: left + seen.x,
            y_px: top + seen.y,
            x_error_px: seen.error.0,
            y_error_px: seen.error.1,
            flux_adu: seen.flux,
            flux_error_adu: seen.flux_error,
            snr: seen.flux / seen.flux_error,
            significance: f64::from(peak.significance),
            peak_adu,
            fwhm_px: seen.fwhm(),
            ellipticity: 1.0 - 1.0 / seen.axis_ratio(),
            angle_deg: seen.angle.to_degrees(),
            flags: Flags::default(),
        };
        is_good.then(|| InBox { star: star(), place: (seen.x, seen.y), patch })
    }

    /// The shift of the stars that were found, each with its number in the reference; and who stayed behind.
    fn compare(&mut self, found: Vec<(usize, Star)>) -> Result<Measurement, NoShift> {
        let movers = found.iter().filter(|(n, _)| self.still[*n] < STILL_FRAMES);
        let pairs: Vec<(&Star, &Star)> = movers.map(|(n, star)| (&self.stars[*n], star)).collect();
        let shift = usable(shift::from_pairs(&pairs, self.stars.len(), found.len(), self.width, self.height)?)?;
        let mut widths: Vec<f32> = pairs.iter().map(|(_, star)| star.fwhm_px as f32).collect();
        let fwhm_px = crate::background::median_in_place(&mut widths).map(f64::from);
        if shift.dx_px.hypot(shift.dy_px) > MOVED_PX {
            for (n, star) in &found {
                let first = &self.stars[*n];
                let stayed = (star.x_px - first.x_px).hypot(star.y_px - first.y_px) < STILL_PX;
                self.still[*n] = if stayed { self.still[*n] + 1 } else { 0 };
            }
        }
        Ok(Measurement { shift, fwhm_px })
    }
}
