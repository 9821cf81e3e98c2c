//! What is known of a camera before a frame is looked at.

use crate::bad_pixels::BadPixelMap;
use crate::frame::{Frame, Pixels};

/// What is known of a camera and its frames.
#[derive(Debug, Clone, Copy)]
pub struct Camera<'a> {
    /// Greatest count that the camera can give, ADU (ASCOM `MaxADU`); 65535 for raw counts and none for floats
    /// if not given.
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
