//! Pixels that are bad in every frame: from darks, or from frames of different fields.
//!
//! In single frames isolated defects are found by their shape; clusters of hot pixels look like stars. But stars
//! move over the sensor from field to field: what stands out at the same place in three pointings is the camera's.

use std::collections::HashMap;

use crate::background::Background;
use crate::clean::Clean;
use crate::frame::{Frame, FrameError, Pixels};

/// Pointings in which a pixel must stand out (algorithms.md 6.1, step 1).
const VOTES: u8 = 3;
/// How far a pixel must stand above or below the sky of a frame or a dark, sigma.
const STANDS_OUT: f32 = 8.0;

/// Pixels to be replaced before anything is measured.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadPixelMap {
    width: usize,
    height: usize,
    positions: Vec<u32>,
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

/// Counts in how many pointings each pixel stood out.
#[derive(Debug, Clone)]
pub struct BadPixelVotes {
    width: usize,
    height: usize,
    votes: HashMap<u32, u8>,
}

impl BadPixelVotes {
    /// No frame seen yet, of a camera with this many columns and rows.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, votes: HashMap::new() }
    }

    /// Counts a frame, cleaned *without* a bad-pixel map. The caller sees to it that each frame shows another
    /// field, or the same one moved by more than a star's size: else its stars become bad pixels.
    ///
    /// # Errors
    /// [`FrameError::Mismatch`] when the frame has another shape.
    pub fn add(&mut self, frame: &Clean) -> Result<(), FrameError> {
        let (width, height) = (self.width, self.height);
        if (frame.width, frame.height) != (width, height) {
            let (found_width, found_height) = (frame.width, frame.height);
            return Err(FrameError::Mismatch { what: "frame to learn from", found_width, found_height, width, height });
        }
        let mut sigma = vec![0.0; width];
        let mut vote = |at: u32| {
            let votes = self.votes.entry(at).or_default();
            *votes = votes.saturating_add(1);
        };
        for (y, line) in frame.pixels.chunks(width).enumerate() {
            frame.background.noise.row(y, &mut sigma);
            let bright =
                line.iter().zip(&sigma).enumerate().filter(|(_, (pixel, sigma))| **pixel > STANDS_OUT * **sigma);
            let at = bright.map(|(x, _)| (y * width + x) as u32);
            at.filter(|at| frame.filled.binary_search(at).is_err()).for_each(&mut vote);
        }
        frame.filled.iter().for_each(|at| vote(*at));
        Ok(())
    }

    /// The pixels that stood out in at least three pointings.
    pub fn map(&self) -> BadPixelMap {
        let mut positions: Vec<u32> =
            self.votes.iter().filter(|(_, votes)| **votes >= VOTES).map(|(at, _)| *at).collect();
        positions.sort_unstable();
        BadPixelMap { width: self.width, height: self.height, positions }
    }
}
