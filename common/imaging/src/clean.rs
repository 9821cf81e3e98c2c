//! From raw pixels to an image whose sky is zero and whose defects are filled.
//!
//! In order: read as f32, subtract the dark (signed: nothing wraps), strike out known bad pixels ([`crate::raw`]), subtract
//! the sky ([`crate::background`]), take out bands ([`crate::banding`]), find and fill defects ([`crate::defect`]).

use crate::background::{Background, Mesh};
use crate::banding::{BandingMeans, BandingSums};
use crate::camera::Camera;
use crate::frame::{Frame, FrameError};
use crate::raw::{Counted, Raw};
use crate::{banding, defect, parallel};

/// A frame without its sky and its defects.
#[derive(Debug, Clone)]
pub struct Clean {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Excess over the sky, ADU; all finite.
    pub pixels: Vec<f32>,
    /// Sky and noise.
    pub background: Background,
    /// Pixels at or above the saturation limit.
    pub saturated: usize,
    /// Pixels that came as NaN or infinite.
    pub missing: usize,
    /// Greatest raw value, ADU; minus infinity if there is none.
    pub brightest_adu: f32,
    /// Positions (`y * width + x`) of filled pixels, in order.
    pub filled: Vec<u32>,
    /// Whether rows or columns had offsets that were taken out.
    pub banding: bool,
}

impl Clean {
    /// Cleans a frame; `fwhm_px` is the width of its stars if it is known (the last frame's). Without it only what
    /// is sharper than stars of 1.5 px counts as a defect, until [`Clean::fill_defects`] is given the width. Stars
    /// below 1.5 px cannot be distinguished from hot pixels: then only known bad pixels are filled.
    ///
    /// # Errors
    /// [`FrameError::NoSky`] when no part of the frame has usable sky; [`FrameError::Mismatch`] when dark or
    /// bad-pixel map have another shape.
    pub fn new(frame: &Frame, camera: &Camera, fwhm_px: Option<f32>) -> Result<Self, FrameError> {
        let (width, height) = (frame.width(), frame.height());
        let raw = Raw::new(frame, camera)?;
        let quantum = if raw.are_whole() { 1.0 } else { 0.0 };
        let saturation = camera.saturation_adu(frame);
        let read = |y: usize, to: &mut [f32]| raw.read(y, to);
        // first, so that what outlives the image does not lie before it in memory and keep it from being given back
        let mut pixels = pages::zeros(width * height);
        let Some(background) = Background::of_rows((width, height), read, quantum, saturation, fwhm_px) else {
            let all = (0..height).map(|y| raw.count(y)).fold(Counted::NOTHING, Counted::and);
            let Counted { saturated, missing, .. } = all;
            return Err(FrameError::NoSky { pixels: width * height, saturated, missing });
        };
        let (Counted { saturated, missing, brightest }, means) =
            read_without_sky(&raw, &background, &mut pixels, width);
        let mut clean = Self {
            width,
            height,
            pixels,
            background,
            saturated,
            missing,
            brightest_adu: brightest,
            filled: Vec::new(),
            banding: false,
        };
        let struck =
            clean.remove_banding(means, fwhm_px) + missing + camera.bad_pixels.map_or(0, |map| map.positions().len());
        if struck > 0 {
            let nan = clean.pixels.iter().enumerate().filter(|(_, value)| value.is_nan());
            clean.filled = nan.map(|(at, _)| at as u32).collect();
        }
        // known widths are trusted to 20 %: seeing may have improved since
        if fwhm_px.is_none_or(|fwhm| fwhm >= defect::SHARPEST_PX) {
            clean.fill_defects(fwhm_px.map_or(0.0, |fwhm| 0.8 * fwhm));
        } else {
            defect::fill(&mut clean.pixels, width, &clean.filled);
        }
        Ok(clean)
    }

    /// Fills what is sharper than stars of `fwhm_px` (and, once more, what had no value); answers how many pixels
    /// were found.
    pub fn fill_defects(&mut self, fwhm_px: f32) -> usize {
        let found = defect::find(&self.pixels, self.width, &self.background.noise, fwhm_px);
        let count = found.len();
        self.filled.extend(found);
        self.filled.sort_unstable();
        self.filled.dedup();
        defect::fill(&mut self.pixels, self.width, &self.filled);
        count
    }

    /// Whether stars of this width (px) are so wide that the sky's cells have taken part of their light.
    pub(crate) fn takes_for_sky(&self, fwhm_px: f32) -> bool {
        let cell = self.width.div_ceil(self.background.level.shape().0);
        crate::background::side(self.width, self.height, Some(fwhm_px)) as f32 > 1.5 * cell as f32
    }

    /// Whether stars of this width (px), of which so many were found, are as sharp as the pixels that were filled,
    /// and many enough to think that those were stars too.
    pub(crate) fn took_for_defects(&self, fwhm_px: f32, stars: usize) -> bool {
        fwhm_px < defect::SHARPEST_PX && stars > self.filled.len().saturating_sub(self.missing)
    }

    /// Takes offsets of rows and columns out, and measures the sky again if there were any. Answers how many lines
    /// were struck out.
    fn remove_banding(&mut self, means: BandingMeans, fwhm_px: Option<f32>) -> usize {
        let found = banding::remove(&mut self.pixels, self.width, self.background.noise.median(), means);
        if found.removed
            && let Some(rest) = Background::measure(&self.pixels, self.width, 0.0, f32::INFINITY, fwhm_px)
        {
            subtract(&mut self.pixels, self.width, &rest.level);
            self.background.level.add(&rest.level);
            self.background.noise = rest.noise;
        }
        self.banding = found.removed;
        found.bad_rows.len() + found.bad_columns.len()
    }
}

/// Reads the frame, takes its sky away, and looks at the rows and columns of what is left, all in one pass.
fn read_without_sky(raw: &Raw, background: &Background, pixels: &mut [f32], width: usize) -> (Counted, BandingMeans) {
    let (steps, sigma, height) = (background.level.steps(), background.noise.median(), pixels.len() / width);
    let bands = parallel::bands_mut(pixels, width, |first, band| {
        let mut counted = Counted::NOTHING;
        let mut sums = BandingSums::new(width, height, sigma);
        for (n, line) in band.chunks_mut(width).enumerate() {
            let y = first + n;
            raw.read(y, line);
            counted = counted.and(raw.count(y));
            background.level.subtract(y, &steps, line);
            sums.add(y, line);
        }
        (counted, sums)
    });
    let (counted, sums): (Vec<Counted>, Vec<BandingSums>) = bands.into_iter().unzip();
    (counted.into_iter().fold(Counted::NOTHING, Counted::and), BandingSums::means(sums, width, height))
}

fn subtract(pixels: &mut [f32], width: usize, level: &Mesh) {
    let steps = level.steps();
    parallel::bands_mut(pixels, width, |first, band| {
        for (n, line) in band.chunks_mut(width).enumerate() {
            level.subtract(first + n, &steps, line);
        }
    });
}
