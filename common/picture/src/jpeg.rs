//! Grey values as a JPEG.

use jpeg_encoder::{ColorType, Encoder, EncodingError};

use crate::Small;
use crate::stretch::{Look, stretch_as};

/// The usual quality, percent.
pub const QUALITY_PERCENT: u8 = 82;

/// Why there is no JPEG.
#[derive(Debug, thiserror::Error)]
pub enum JpegError {
    /// JPEG has sides of 16 bits.
    #[error("a picture of {0} x {1} px; expected 1 to 65535 columns and rows")]
    Size(usize, usize),
    /// The encoder failed.
    #[error("the picture cannot be encoded: {0}")]
    Encode(#[from] EncodingError),
    /// It has too many bytes at the lowest quality too.
    #[error("the picture has {0} bytes; ask for a smaller one")]
    TooLarge(usize),
}

/// The JPEG of a picture.
///
/// # Errors
/// It has no pixel, or too many.
pub fn encode(small: &Small, look: Look) -> Result<Vec<u8>, JpegError> {
    encoded(small, &stretch_as(small, look), QUALITY_PERCENT)
}

/// The JPEG of a picture in at most so many bytes, at a lower quality where it needs that.
///
/// # Errors
/// As [`encode`], or it does not fit at any quality.
pub fn encode_within(small: &Small, look: Look, most_bytes: usize) -> Result<Vec<u8>, JpegError> {
    let grey = stretch_as(small, look);
    let mut bytes = encoded(small, &grey, QUALITY_PERCENT)?;
    for quality_percent in [60, 35, 15] {
        if bytes.len() <= most_bytes {
            break;
        }
        bytes = encoded(small, &grey, quality_percent)?;
    }
    if bytes.len() > most_bytes { Err(JpegError::TooLarge(bytes.len())) } else { Ok(bytes) }
}

fn encoded(small: &Small, grey: &[u8], quality_percent: u8) -> Result<Vec<u8>, JpegError> {
    let (Ok(width @ 1..), Ok(height @ 1..)) = (u16::try_from(small.width), u16::try_from(small.height)) else {
        return Err(JpegError::Size(small.width, small.height));
    };
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, quality_percent).encode(grey, width, height, ColorType::Luma)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(side: usize) -> Small {
        let pixels = (0..side * side).map(|i| (i as u32).wrapping_mul(2_654_435_761).rotate_left(9) as f32).collect();
        Small { width: side, height: side, pixels }
    }

    #[test]
    fn a_picture_of_noise_becomes_smaller_where_it_has_to() {
        let small = noise(512);
        let usual = encode(&small, Look::default()).unwrap();
        assert_eq!(usual[..3], [0xFF, 0xD8, 0xFF]);
        let fits = encode_within(&small, Look::default(), usual.len() / 2).unwrap();
        assert!(fits.len() <= usual.len() / 2);
        assert!(matches!(encode_within(&small, Look::default(), 100), Err(JpegError::TooLarge(_))));
    }

    #[test]
    fn no_pixels_or_too_many_columns_are_refused() {
        for (width, height) in [(0, 0), (70_000, 1)] {
            let small = Small { width, height, pixels: vec![1.0; width * height] };
            assert!(matches!(encode(&small, Look::default()), Err(JpegError::Size(..))));
        }
    }
}
