//! A frame as the camera gave it: borrowed pixels with their shape.
//!
//! Pixel `(0, 0)` is the centre of the first pixel, x the column, y the row; FITS numbers are greater by one.
//! Values are ADU, in row order (`pixels[y * width + x]`).

/// Pixels of one of the kinds that cameras and FITS files hold, ADU.
#[derive(Debug, Clone, Copy)]
pub enum Pixels<'a> {
    /// Raw camera counts, 0 to 65535.
    U16(&'a [u16]),
    /// Calibrated or float data; NaN and infinity mark pixels without a value.
    F32(&'a [f32]),
}

impl Pixels<'_> {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        match self {
            Self::U16(pixels) => pixels.len(),
            Self::F32(pixels) => pixels.len(),
        }
    }

    /// Whether there is no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Why nothing can be measured in a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// The number of pixels is not width x height, or is zero.
    #[error(
        "frame of {width} x {height} px came with {pixels} pixel values; give width x height of them, at least one"
    )]
    Shape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Pixels that were given.
        pixels: usize,
    },
    /// A dark frame or bad-pixel map was made for another shape.
    #[error("{what} is {found_width} x {found_height} px, the frame {width} x {height}; take one of the same binning")]
    Mismatch {
        /// What does not fit.
        what: &'static str,
        /// Its columns.
        found_width: usize,
        /// Its rows.
        found_height: usize,
        /// Columns of the frame.
        width: usize,
        /// Rows of the frame.
        height: usize,
    },
    /// Nowhere in the frame is there half a cell of usable pixels.
    #[error("no usable sky in the frame: of {pixels} px {saturated} are saturated and {missing} have no value")]
    NoSky {
        /// Pixels in all.
        pixels: usize,
        /// Pixels at or above the saturation limit.
        saturated: usize,
        /// Pixels that are NaN or infinite.
        missing: usize,
    },
}

/// Pixels that are known to fill a rectangle.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    width: usize,
    height: usize,
    pixels: Pixels<'a>,
}

impl<'a> Frame<'a> {
    /// A frame of `width` columns and `height` rows.
    ///
    /// # Errors
    /// [`FrameError::Shape`] when the number of pixels is not `width * height`, or is zero.
    pub fn new(width: usize, height: usize, pixels: Pixels<'a>) -> Result<Self, FrameError> {
        let fits = width.checked_mul(height).is_some_and(|n| n == pixels.len() && n > 0);
        if fits {
            Ok(Self { width, height, pixels })
        } else {
            Err(FrameError::Shape { width, height, pixels: pixels.len() })
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, ADU.
    pub fn pixels(&self) -> Pixels<'a> {
        self.pixels
    }

    /// The value at column `x` and row `y`, ADU; NaN outside of the frame.
    pub fn value(&self, x: usize, y: usize) -> f32 {
        if x >= self.width || y >= self.height {
            return f32::NAN;
        }
        match self.pixels {
            Pixels::U16(pixels) => f32::from(pixels[y * self.width + x]),
            Pixels::F32(pixels) => pixels[y * self.width + x],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_must_fill_its_rectangle() {
        assert!(Frame::new(3, 2, Pixels::U16(&[0; 6])).is_ok());
        for (width, height) in [(3, 3), (0, 6), (6, 0), (usize::MAX, 2)] {
            let refused = Frame::new(width, height, Pixels::U16(&[0; 6])).unwrap_err();
            assert_eq!(refused, FrameError::Shape { width, height, pixels: 6 });
        }
        assert!(Frame::new(0, 0, Pixels::F32(&[])).is_err());
    }

    #[test]
    fn a_value_outside_of_the_frame_is_none() {
        let frame = Frame::new(2, 2, Pixels::F32(&[1.0, 2.0, 3.0, 4.0])).unwrap();
        assert_eq!(frame.value(1, 0), 2.0);
        assert_eq!(frame.value(0, 1), 3.0);
        assert!(frame.value(2, 0).is_nan() && frame.value(0, 2).is_nan());
    }
}
