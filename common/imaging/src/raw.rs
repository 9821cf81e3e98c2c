//! Rows of a frame as numbers to work with: f32, less the dark, NaN where there is no value.
//!
//! Rows are made when they are asked for, so that no copy of the whole frame is needed: the sky is measured on rows
//! that are still in the cache, and the cleaned image is the only one that is written.

use crate::bad_pixels::BadPixelMap;
use crate::camera::Camera;
use crate::frame::{Frame, FrameError, Pixels};

/// A frame with what is known of its camera.
#[derive(Clone, Copy)]
pub(crate) struct Raw<'a> {
    frame: &'a Frame<'a>,
    dark: Option<Frame<'a>>,
    bad_pixels: Option<&'a BadPixelMap>,
    saturation: f32,
}

/// What is counted in raw pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Counted {
    /// Pixels at or above the saturation limit.
    pub(crate) saturated: usize,
    /// Pixels that are NaN or infinite.
    pub(crate) missing: usize,
    /// Greatest finite value, ADU; minus infinity if there is none.
    pub(crate) brightest: f32,
}

impl Counted {
    pub(crate) const NOTHING: Self = Self { saturated: 0, missing: 0, brightest: f32::NEG_INFINITY };

    pub(crate) fn and(self, other: Self) -> Self {
        Self {
            saturated: self.saturated + other.saturated,
            missing: self.missing + other.missing,
            brightest: self.brightest.max(other.brightest),
        }
    }
}

impl<'a> Raw<'a> {
    /// # Errors
    /// [`FrameError::Mismatch`] when dark or bad-pixel map have another shape than the frame.
    pub(crate) fn new(frame: &'a Frame<'a>, camera: &Camera<'a>) -> Result<Self, FrameError> {
        let (width, height) = (frame.width(), frame.height());
        let fits = |what, found_width, found_height| {
            let mismatch = FrameError::Mismatch { what, found_width, found_height, width, height };
            if (found_width, found_height) == (width, height) { Ok(()) } else { Err(mismatch) }
        };
        camera.dark.map_or(Ok(()), |dark| fits("dark", dark.width(), dark.height()))?;
        camera.bad_pixels.map_or(Ok(()), |map| fits("bad-pixel map", map.width(), map.height()))?;
        let saturation = camera.saturation_adu(frame);
        Ok(Self { frame, dark: camera.dark, bad_pixels: camera.bad_pixels, saturation })
    }

    /// Writes row `y` into `to`, ADU.
    pub(crate) fn read(&self, y: usize, to: &mut [f32]) {
        let width = self.frame.width();
        let range = y * width..(y + 1) * width;
        match self.frame.pixels() {
            Pixels::U16(raw) => to.iter_mut().zip(&raw[range.clone()]).for_each(|(to, from)| *to = f32::from(*from)),
            Pixels::F32(raw) => {
                let value = |from: f32| if from.is_finite() { from } else { f32::NAN };
                to.iter_mut().zip(&raw[range.clone()]).for_each(|(to, from)| *to = value(*from));
            }
        }
        match self.dark.map(|dark| dark.pixels()) {
            Some(Pixels::U16(dark)) => to.iter_mut().zip(&dark[range]).for_each(|(to, dark)| *to -= f32::from(*dark)),
            Some(Pixels::F32(dark)) => to.iter_mut().zip(&dark[range]).for_each(|(to, dark)| *to -= dark),
            None => {}
        }
        if let Some(map) = self.bad_pixels {
            let (first, end) = ((y * width) as u32, ((y + 1) * width) as u32);
            let positions = map.positions();
            let from = positions.partition_point(|at| *at < first);
            let in_row = positions[from..].iter().take_while(|at| **at < end);
            in_row.for_each(|at| to[(at - first) as usize] = f32::NAN);
        }
    }

    /// What is counted in row `y`.
    pub(crate) fn count(&self, y: usize) -> Counted {
        let width = self.frame.width();
        let range = y * width..(y + 1) * width;
        match self.frame.pixels() {
            Pixels::U16(raw) => {
                let raw = &raw[range];
                let brightest = f32::from(raw.iter().fold(0, |most, value| *value.max(&most)));
                let is_saturated = |value: &&u16| f32::from(**value) >= self.saturation;
                let saturated = if brightest >= self.saturation { raw.iter().filter(is_saturated).count() } else { 0 };
                Counted { saturated, missing: 0, brightest }
            }
            Pixels::F32(raw) => raw[range].iter().fold(Counted::NOTHING, |all, value| Counted {
                saturated: all.saturated + usize::from(*value >= self.saturation),
                missing: all.missing + usize::from(!value.is_finite()),
                brightest: if value.is_finite() { all.brightest.max(*value) } else { all.brightest },
            }),
        }
    }

    /// Whether the values are whole counts, judged by a thousand of them.
    pub(crate) fn are_whole(&self) -> bool {
        self.dark.is_none()
            && match self.frame.pixels() {
                Pixels::U16(_) => true,
                Pixels::F32(pixels) => {
                    let some = pixels.iter().step_by((pixels.len() / 1000).max(1));
                    some.filter(|value| value.is_finite()).all(|value| value.fract() == 0.0)
                }
            }
    }
}
