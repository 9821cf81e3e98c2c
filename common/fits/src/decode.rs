//! Bytes of a plain image turned into pixels (FITS Standard 4.0, sections 4.4.2.5 and 5): big endian, scaled.

use crate::header::{Header, KeywordError};
use crate::pixels::Pixels;

/// From the numbers in the file to values: `zero + scale * number`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scaling {
    scale: f64,
    zero: f64,
    /// The number that stands for no value.
    blank: Option<i64>,
}

impl Scaling {
    /// BSCALE, BZERO and BLANK; in tiles ZBLANK counts too.
    pub(crate) fn of(header: &Header) -> Result<Self, KeywordError> {
        let or = |keyword: &str, default: f64| match header.value(keyword) {
            None => Ok(default),
            Some(_) => header.number(keyword),
        };
        let blank = ["BLANK", "ZBLANK"].into_iter().find(|keyword| header.value(keyword).is_some());
        Ok(Self {
            scale: or("BSCALE", 1.0)?,
            zero: or("BZERO", 0.0)?,
            blank: blank.map(|keyword| header.whole(keyword)).transpose()?,
        })
    }

    /// Whether numbers of so many bits are counts of 0 to 65535, all with a value.
    pub(crate) fn are_counts(&self, bitpix: i64) -> bool {
        self.scale == 1.0 && self.blank.is_none() && matches!((bitpix, self.zero), (8, 0.0) | (16, 32_768.0))
    }

    fn value(&self, number: i64) -> f32 {
        if self.blank == Some(number) { f32::NAN } else { self.scaled(number as f64) }
    }

    fn scaled(&self, number: f64) -> f32 {
        (self.zero + self.scale * number) as f32
    }
}

/// The pixels of `bytes`, in the file's order. `bitpix` must be one that the standard has; others give no pixels.
pub(crate) fn decode(bytes: &[u8], bitpix: i64, scaling: &Scaling) -> Pixels {
    if scaling.are_counts(bitpix) {
        return Pixels::U16(match bitpix {
            8 => pages::collect(bytes.iter().map(|byte| u16::from(*byte))),
            // 32768 more than the signed number: its highest bit turned round.
            _ => pages::collect(numbers(bytes, u16::from_be_bytes).map(|number| number ^ 0x8000)),
        });
    }
    Pixels::F32(match bitpix {
        8 => pages::collect(bytes.iter().map(|byte| scaling.value(i64::from(*byte)))),
        16 => pages::collect(numbers(bytes, i16::from_be_bytes).map(|number| scaling.value(i64::from(number)))),
        32 => pages::collect(numbers(bytes, i32::from_be_bytes).map(|number| scaling.value(i64::from(number)))),
        64 => pages::collect(numbers(bytes, i64::from_be_bytes).map(|number| scaling.value(number))),
        -32 => pages::collect(numbers(bytes, f32::from_be_bytes).map(|number| scaling.scaled(f64::from(number)))),
        -64 => pages::collect(numbers(bytes, f64::from_be_bytes).map(|number| scaling.scaled(number))),
        _ => Vec::new(),
    })
}

/// `read` by its type, not by a pointer: that would be a call for each pixel.
fn numbers<const N: usize, T>(bytes: &[u8], read: impl Fn([u8; N]) -> T) -> impl ExactSizeIterator<Item = T> {
    bytes.as_chunks().0.iter().map(move |bytes| read(*bytes))
}
