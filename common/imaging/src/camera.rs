//! What is known of a camera before a frame is looked at.

use crate::bad_pixels::BadPixelMap;
use crate::frame::{Frame, Pixels};

/// What is known of a camera and its frames.
#[derive(Debug, Clone, Copy)]
pub struct Camera<'a> {
    /// Greatest count that the camera can give, ADU (ASCOM `MaxADU`); 65535 for raw counts and none for floats
    /// if not given.
    pub max_adu: Option<f32>,
    /// From this count on a pixel is saturated, ADU, where that is known; it counts before `max_adu`.
    pub saturation_adu: Option<f32>,
    /// Electrons per ADU (ASCOM `ElectronsPerADU`), for the photon noise of stars.
    pub gain_e_per_adu: f32,
    /// A dark (or bias) of the same shape and exposure time, ADU.
    pub dark: Option<Frame<'a>>,
    /// Pixels known to be bad.
    pub bad_pixels: Option<&'a BadPixelMap>,
}

impl Default for Camera<'_> {
    fn default() -> Self {
        Self { max_adu: None, saturation_adu: None, gain_e_per_adu: 1.0, dark: None, bad_pixels: None }
    }
}

impl Camera<'_> {
    /// Counts at which a star is no longer measured rightly, ADU: those that are known, else 0.9 of the greatest.
    pub fn saturation_adu(&self, frame: &Frame) -> f32 {
        match (self.saturation_adu, self.max_adu, frame.pixels()) {
            (Some(saturation), ..) => saturation,
            (None, Some(max), _) => 0.9 * max,
            (None, None, Pixels::U16(_)) => 0.9 * f32::from(u16::MAX),
            (None, None, Pixels::F32(_)) => f32::INFINITY,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saturation_that_is_known_counts_before_the_greatest_count() {
        let frame = Frame::new(2, 1, Pixels::U16(&[0, 1])).unwrap();
        let of =
            |max_adu, saturation_adu| Camera { max_adu, saturation_adu, ..Camera::default() }.saturation_adu(&frame);
        assert_eq!(of(Some(65_535.0), Some(50_000.0)), 50_000.0);
        assert_eq!(of(None, Some(50_000.0)), 50_000.0);
        assert_eq!((of(Some(4000.0), None), of(None, None)), (0.9 * 4000.0, 0.9 * 65_535.0));
    }
}
