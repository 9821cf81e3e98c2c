//! From raw pixels to an image whose sky is zero and whose defects are filled.
//!
//! In order: copy to f32, subtract the dark (signed: nothing wraps), strike out known bad pixels, subtract the sky
//! ([`crate::background`]), take out bands ([`crate::banding`]), find and fill defects ([`crate::defect`]).

use crate::background::Background;
use crate::bad_pixels::BadPixelMap;
use crate::frame::{Frame, FrameError, Pixels};
use crate::{banding, defect, parallel};

/// What is known of a camera and its frames.
#[derive(Debug, Clone, Copy)]
pub struct Camera<'a> {
    /// Greatest count that the camera can give, ADU (ASCOM `MaxADU`); 65535 for raw counts and none for floats
    /// if not told.
    pub max_adu: Option<f32>,
    /// Electrons per ADU (ASCOM `ElectronsPerADU`), for the photon noise of stars.
    pub gain_e_per_adu: f32,
    /// A dark (or bias) of the same shape and exposure time, ADU.
    pub dark: Option<Frame<'a>>,
    /// Pixels known to be bad.
    pub bad_pixels: Option<&'a BadPixelMap>,
}

impl Default for Camera<'_> {
    fn default() -> Self {
        Self { max_adu: None, gain_e_per_adu: 1.0, dark: None, bad_pixels: None }
    }
}

impl Camera<'_> {
    /// Counts at which a star is no longer measured rightly: 0.9 of the greatest, ADU.
    pub fn saturation_adu(&self, frame: &Frame) -> f32 {
        match (self.max_adu, frame.pixels()) {
            (Some(max), _) => 0.9 * max,
            (None, Pixels::U16(_)) => 0.9 * f32::from(u16::MAX),
            (None, Pixels::F32(_)) => f32::INFINITY,
        }
    }
}

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
    /// is sharper than stars of 1.5 px counts as a defect, until [`Clean::fill_defects`] is told more. Stars below
    /// 1.5 px cannot be told from hot pixels: then only known bad pixels are filled.
    ///
    /// # Errors
    /// [`FrameError::NoSky`] when no part of the frame has usable sky; [`FrameError::Mismatch`] when dark or
    /// bad-pixel map have another shape.
    pub fn new(frame: &Frame, camera: &Camera, fwhm_px: Option<f32>) -> Result<Self, FrameError> {
        let (width, height) = (frame.width(), frame.height());
        let saturation = camera.saturation_adu(frame);
        let (mut pixels, Copied { saturated, missing, brightest }) = copy(frame, camera, saturation)?;
        let quantum = if camera.dark.is_none() && are_whole(frame) { 1.0 } else { 0.0 };
        let Some(background) = Background::measure(&pixels, width, quantum, saturation, fwhm_px) else {
            return Err(FrameError::NoSky { pixels: pixels.len(), saturated, missing });
        };
        subtract(&mut pixels, width, &background);
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
        let struck = clean.remove_banding(fwhm_px) + missing + camera.bad_pixels.map_or(0, |map| map.positions().len());
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
    fn remove_banding(&mut self, fwhm_px: Option<f32>) -> usize {
        let found = banding::remove(&mut self.pixels, self.width, self.background.noise.median());
        if found.removed
            && let Some(rest) = Background::measure(&self.pixels, self.width, 0.0, f32::INFINITY, fwhm_px)
        {
            subtract(&mut self.pixels, self.width, &rest);
            self.background.level.add(&rest.level);
            self.background.noise = rest.noise;
        }
        self.banding = found.removed;
        found.bad_rows.len() + found.bad_columns.len()
    }
}

/// What is counted while copying.
struct Copied {
    saturated: usize,
    missing: usize,
    brightest: f32,
}

/// The pixels as f32 less the dark, NaN where there is no value.
fn copy(frame: &Frame, camera: &Camera, saturation: f32) -> Result<(Vec<f32>, Copied), FrameError> {
    let (width, height) = (frame.width(), frame.height());
    let fits = |what, found_width, found_height| {
        let mismatch = FrameError::Mismatch { what, found_width, found_height, width, height };
        if (found_width, found_height) == (width, height) { Ok(()) } else { Err(mismatch) }
    };
    let mut pixels = vec![0.0; width * height];
    let counts = parallel::bands_mut(&mut pixels, width, |first, band| {
        let range = first * width..first * width + band.len();
        match frame.pixels() {
            Pixels::U16(raw) => copy_counts(&raw[range], band, width, saturation),
            Pixels::F32(raw) => copy_floats(&raw[range], band, saturation),
        }
    });
    if let Some(dark) = camera.dark {
        fits("dark", dark.width(), dark.height())?;
        parallel::bands_mut(&mut pixels, width, |first, band| {
            let range = first * width..first * width + band.len();
            match dark.pixels() {
                Pixels::U16(dark) => band.iter_mut().zip(&dark[range]).for_each(|(to, dark)| *to -= f32::from(*dark)),
                Pixels::F32(dark) => band.iter_mut().zip(&dark[range]).for_each(|(to, dark)| *to -= dark),
            }
        });
    }
    if let Some(map) = camera.bad_pixels {
        fits("bad-pixel map", map.width(), map.height())?;
        map.positions().iter().for_each(|at| pixels[*at as usize] = f32::NAN);
    }
    let all = Copied { saturated: 0, missing: 0, brightest: f32::NEG_INFINITY };
    let all = counts.into_iter().fold(all, |all, band| Copied {
        saturated: all.saturated + band.saturated,
        missing: all.missing + band.missing,
        brightest: all.brightest.max(band.brightest),
    });
    Ok((pixels, all))
}

/// Row by row, so that what is counted is still in the cache.
fn copy_counts(raw: &[u16], to: &mut [f32], width: usize, saturation: f32) -> Copied {
    // the least whole number at or above the limit; beyond u16 nothing is saturated
    let limit = saturation.ceil().max(0.0);
    let limit = (limit <= f32::from(u16::MAX)).then_some(limit as u16);
    let (mut saturated, mut brightest) = (0, 0);
    for (raw, to) in raw.chunks(width).zip(to.chunks_mut(width)) {
        to.iter_mut().zip(raw).for_each(|(to, from)| *to = f32::from(*from));
        brightest = raw.iter().fold(brightest, |most, value| most.max(*value));
        if let Some(limit) = limit.filter(|limit| brightest >= *limit) {
            saturated += raw.iter().filter(|value| **value >= limit).count();
        }
    }
    Copied { saturated, missing: 0, brightest: f32::from(brightest) }
}

fn copy_floats(raw: &[f32], to: &mut [f32], saturation: f32) -> Copied {
    to.copy_from_slice(raw);
    let saturated = to.iter().filter(|value| **value >= saturation).count();
    let missing = to.iter().filter(|value| !value.is_finite()).count();
    if missing > 0 {
        to.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = f32::NAN);
    }
    Copied { saturated, missing, brightest: parallel::highest(to) }
}

/// Whether the values are whole counts, judged by a thousand of them.
fn are_whole(frame: &Frame) -> bool {
    match frame.pixels() {
        Pixels::U16(_) => true,
        Pixels::F32(pixels) => {
            let mut finite = pixels.iter().step_by((pixels.len() / 1000).max(1)).filter(|value| value.is_finite());
            finite.all(|value| value.fract() == 0.0)
        }
    }
}

fn subtract(pixels: &mut [f32], width: usize, background: &Background) {
    parallel::bands_mut(pixels, width, |first, band| {
        let mut level = vec![0.0; width];
        for (n, line) in band.chunks_mut(width).enumerate() {
            background.level.row(first + n, &mut level);
            line.iter_mut().zip(&level).for_each(|(pixel, level)| *pixel -= level);
        }
    });
}
