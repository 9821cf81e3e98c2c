//! The pixels of an image, as exact as its file has them.

/// Pixels in row order, the first row of the file first, scaled by BSCALE and BZERO.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// Counts of 0 to 65535, without loss: 16 bits with BZERO 32768, and 8 bits.
    U16(Vec<u16>),
    /// All else. NaN where there is no value (BLANK). 32 and 64 bits are rounded to the 24 that a float keeps.
    F32(Vec<f32>),
}

impl Pixels {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U16(counts) => counts.len(),
            Self::F32(floats) => floats.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
