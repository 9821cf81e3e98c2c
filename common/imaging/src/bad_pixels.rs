//! Pixels that are bad in every frame, as a dark shows them.

use crate::background::Background;
use crate::frame::{Frame, FrameError, Pixels};

/// How far a pixel must stand above or below the sky of a frame or a dark, sigma.
pub(crate) const STANDS_OUT: f32 = 8.0;

/// Pixels to be replaced before anything is measured.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadPixelMap {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) positions: Vec<u32>,
}

impl BadPixelMap {
    /// The pixels that stand 8 sigma above or below their surroundings in a dark.
    ///
    /// # Errors
    /// [`FrameError::NoSky`] when the dark is saturated, or has no values, everywhere.
    pub fn from_dark(dark: &Frame) -> Result<Self, FrameError> {
        let (width, height) = (dark.width(), dark.height());
        let pixels: Vec<f32> = match dark.pixels() {
            Pixels::U16(raw) => raw.iter().map(|value| f32::from(*value)).collect(),
            Pixels::F32(raw) => raw.to_vec(),
        };
        let missing = pixels.iter().filter(|value| !value.is_finite()).count();
        let background = Background::measure(&pixels, width, 0.0, f32::INFINITY, None).ok_or(FrameError::NoSky {
            pixels: pixels.len(),
            saturated: 0,
            missing,
        })?;
        let (mut level, mut noise) = (vec![0.0; width], vec![0.0; width]);
        let mut positions = Vec::new();
        for (y, line) in pixels.chunks(width).enumerate() {
            background.level.row(y, &mut level);
            background.noise.row(y, &mut noise);
            let stands_out = |x: usize| line[x].is_nan() || (line[x] - level[x]).abs() > STANDS_OUT * noise[x];
            positions.extend((0..width).filter(|x| stands_out(*x)).map(|x| (y * width + x) as u32));
        }
        Ok(Self { width, height, positions })
    }

    /// Columns of the frames it is for.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of the frames it is for.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, as `y * width + x`, in order.
    pub fn positions(&self) -> &[u32] {
        &self.positions
    }
}
