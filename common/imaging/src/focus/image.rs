//! A frame in f64 for the focus operators: nothing wraps, and the sky can be taken off.

use crate::camera::Camera;
use crate::clean::Clean;
use crate::frame::{Frame, FrameError};

/// Pixels in row order, ADU; all finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<f64>,
}

impl Image {
    /// The frame as it is, pedestal and all, as the predecessor measured it. Pixels without a value become the
    /// median of the others.
    ///
    /// # Errors
    /// [`FrameError::NoSky`] when no pixel has a value.
    pub fn raw(frame: &Frame) -> Result<Self, FrameError> {
        let (width, height) = (frame.width(), frame.height());
        let at = |n: usize| f64::from(frame.value(n % width, n / width));
        let mut pixels: Vec<f64> = (0..width * height).map(at).collect();
        let missing = pixels.iter().filter(|value| !value.is_finite()).count();
        if missing > 0 {
            let finite = pixels.iter().copied().filter(|value| value.is_finite()).collect();
            let Some(median) = super::median(finite) else {
                return Err(FrameError::NoSky { pixels: pixels.len(), saturated: 0, missing });
            };
            pixels.iter_mut().filter(|value| !value.is_finite()).for_each(|value| *value = median);
        }
        Ok(Self { width, height, pixels })
    }

    /// The frame without its sky, bands and defects: what an operator should see, since a pedestal dilutes most of
    /// them (docs/formulae.md, "The predecessor's star sizes").
    ///
    /// # Errors
    /// As [`Clean::new`].
    pub fn without_sky(frame: &Frame, camera: &Camera) -> Result<Self, FrameError> {
        Ok(Self::of(&Clean::new(frame, camera, None)?))
    }

    /// What is above the sky of a frame that is clean already.
    pub fn of(clean: &Clean) -> Self {
        let pixels = clean.pixels.iter().map(|value| f64::from(*value)).collect();
        Self { width: clean.width, height: clean.height, pixels }
    }

    /// Means of `factor` x `factor` pixels; what is left over at the right and lower edge is dropped.
    pub(crate) fn binned(&self, factor: usize) -> Self {
        let factor = factor.clamp(1, self.width.min(self.height));
        let (width, height) = (self.width / factor, self.height / factor);
        let mut pixels = vec![0.0; width * height];
        let share = 1.0 / (factor * factor) as f64;
        for (y, line) in self.pixels.chunks(self.width).take(height * factor).enumerate() {
            let out = &mut pixels[y / factor * width..][..width];
            for (to, from) in out.iter_mut().zip(line.chunks_exact(factor)) {
                *to += share * from.iter().sum::<f64>();
            }
        }
        Self { width, height, pixels }
    }

    /// The value at a place that may lie one or two pixels outside: mirrored at the centre of the edge pixel
    /// (d c b | a b c d | c b a).
    pub(crate) fn mirrored(&self, x: isize, y: isize) -> f64 {
        let inside = |at: isize, length: usize| {
            let last = length as isize - 1;
            let folded = if at > last { 2 * last - at } else { at.abs() };
            folded.clamp(0, last) as usize
        };
        self.pixels[inside(y, self.height) * self.width + inside(x, self.width)]
    }

    pub(crate) fn mean(&self) -> f64 {
        self.pixels.iter().sum::<f64>() / self.pixels.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Pixels;

    #[test]
    fn pixels_without_a_value_take_the_median() {
        let pixels = [1.0, f32::NAN, 3.0, f32::INFINITY, 5.0, 2.0];
        let image = Image::raw(&Frame::new(3, 2, Pixels::F32(&pixels)).unwrap()).unwrap();
        assert_eq!(image.pixels, [1.0, 2.5, 3.0, 2.5, 5.0, 2.0]);
        let none = [f32::NAN; 4];
        assert!(Image::raw(&Frame::new(2, 2, Pixels::F32(&none)).unwrap()).is_err());
    }

    #[test]
    fn binning_takes_means_and_mirrors_fold_at_the_edge() {
        let pixels: Vec<u16> = (0..15).collect();
        let image = Image::raw(&Frame::new(5, 3, Pixels::U16(&pixels)).unwrap()).unwrap();
        let binned = image.binned(2);
        assert_eq!((binned.width, binned.height, binned.pixels), (2, 1, vec![3.0, 5.0]));
        assert_eq!((image.mirrored(-1, 0), image.mirrored(5, 3), image.mirrored(2, -2)), (1.0, 8.0, 12.0));
    }
}
