//! Pixels that are bad in every frame, from frames of different fields.
//!
//! In single frames isolated defects are found by their shape; clusters of hot pixels look like stars. But stars
//! move over the sensor from field to field: what stands out at the same place in three pointings is the camera's.

use std::collections::HashMap;

use crate::bad_pixels::{BadPixelMap, STANDS_OUT};
use crate::clean::Clean;
use crate::frame::FrameError;

/// Pointings in which a pixel must stand out.
const VOTES: u8 = 3;

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
