//! Alpaca ImageBytes, metadata version 1: a header of eleven little-endian 32-bit numbers, then the elements.

use contract::device::camera::Pixel;

use crate::AlpacaError;
use crate::image::{Image, Shape};

/// Length of the header, bytes.
pub const HEADER: usize = 44;

/// The header of an ImageBytes body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// 0, or the ASCOM error whose message stands in place of the elements.
    pub error_number: i32,
    /// The id of the request that this answers; 0 where the server returns none.
    pub client_transaction: u32,
    start: usize,
    sent: Element,
    shape: Shape,
    /// The camera's own type has 16 bits or fewer.
    narrow: bool,
}

/// ASCOM ImageArrayElementTypes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Element {
    Int16,
    Int32,
    Double,
    Single,
    UInt64,
    Byte,
    Int64,
    UInt16,
    UInt32,
}

impl Element {
    fn new(number: i32) -> Option<Self> {
        Some(match number {
            1 => Self::Int16,
            2 => Self::Int32,
            3 => Self::Double,
            4 => Self::Single,
            5 => Self::UInt64,
            6 => Self::Byte,
            7 => Self::Int64,
            8 => Self::UInt16,
            9 => Self::UInt32,
            _ => return None,
        })
    }

    const fn bytes(self) -> usize {
        match self {
            Self::Byte => 1,
            Self::Int16 | Self::UInt16 => 2,
            Self::Int32 | Self::UInt32 | Self::Single => 4,
            Self::Double | Self::Int64 | Self::UInt64 => 8,
        }
    }

    const fn is_narrow(self) -> bool {
        matches!(self, Self::Byte | Self::Int16 | Self::UInt16)
    }
}

impl Header {
    /// Reads and checks a header; `body` may still be incomplete beyond it.
    pub fn read(body: &[u8]) -> Result<Self, String> {
        let mut numbers = [0_i32; 11];
        let words = body.get(..HEADER).ok_or("the image ends within its header")?.chunks_exact(4);
        for (number, word) in numbers.iter_mut().zip(words) {
            *number = i32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        }
        let [version, error_number, client_transaction, _, start, own, sent, rank, d1, d2, d3] = numbers;
        if version != 1 {
            return Err(format!("ImageBytes version {version}: expected 1"));
        }
        let start = usize::try_from(start).ok().filter(|start| (HEADER..=1 << 20).contains(start));
        let start = start.ok_or("the pixels start outside the image")?;
        let client_transaction = client_transaction as u32;
        if error_number != 0 {
            let shape = Shape { width: 0, height: 0, planes: 0 };
            return Ok(Self { error_number, client_transaction, start, sent: Element::Byte, shape, narrow: true });
        }
        let sent = Element::new(sent).ok_or_else(|| format!("element type {sent}: expected 1 to 9"))?;
        let planes = match rank {
            2 => 1,
            3 => d3,
            _ => return Err(format!("rank {rank}: expected 2 or 3")),
        };
        let shape = Shape::new([d1, d2, planes].map(i64::from))?;
        let narrow = sent.is_narrow() || Element::new(own).is_some_and(Element::is_narrow);
        Ok(Self { error_number, client_transaction, start, sent, shape, narrow })
    }

    /// Length that the whole body must have.
    pub fn bytes(&self) -> usize {
        self.start + self.shape.pixels() * self.sent.bytes()
    }

    /// Columns and rows.
    pub fn size_px(&self) -> (u32, u32) {
        (self.shape.width as u32, self.shape.height as u32)
    }

    /// The error that stands in place of the elements.
    pub fn error(&self, body: &[u8]) -> AlpacaError {
        let message = body.get(self.start..).unwrap_or_default();
        let message = String::from_utf8_lossy(message).trim_matches('\0').chars().take(300).collect();
        let bits = self.error_number as u32;
        let code = if bits & 0xFFFF_F000 == 0x8004_0000 { bits & 0xFFF } else { bits };
        AlpacaError::Ascom { code, message }
    }
}

/// All NaN are one: that of files with compressed tiles, so that pixels have one hash wherever they are.
fn one_nan(value: f64) -> f64 {
    if value.is_nan() { f64::from_bits(u64::MAX) } else { value }
}

/// Turns the elements into rows.
pub fn decode(header: &Header, body: &[u8], max_adu: Option<f64>) -> Result<Image, String> {
    let elements = body.get(header.start..header.bytes()).ok_or_else(|| {
        let (have, want) = (body.len(), header.bytes());
        format!("the image has {have} of {want} bytes")
    })?;
    let sixteen_bits = header.narrow || max_adu.is_some_and(|max| max <= 65535.0);
    let shape = header.shape;
    macro_rules! whole {
        ($type:ty) => {{
            let at = |index: usize| {
                const N: usize = size_of::<$type>();
                let mut word = [0; N];
                word.copy_from_slice(&elements[index * N..(index + 1) * N]);
                <$type>::from_le_bytes(word)
            };
            let count = shape.pixels();
            let (mut low, mut high) = (<$type>::MAX, <$type>::MIN);
            for index in 0..count {
                let value = at(index);
                (low, high) = (low.min(value), high.max(value));
            }
            let range = (i64::try_from(low).unwrap_or(i64::MAX), i64::try_from(high).unwrap_or(i64::MAX));
            let pixel = Shape::pixel_for(range, sixteen_bits);
            let rows = match pixel {
                Pixel::U16 => shape.rows(|index| (at(index) as u16).to_le_bytes()),
                Pixel::I32 => shape.rows(|index| (at(index) as i32).to_le_bytes()),
                Pixel::F64 => shape.rows(|index| (at(index) as f64).to_le_bytes()),
            };
            Ok(shape.image(pixel, rows))
        }};
    }
    match header.sent {
        Element::Byte => whole!(u8),
        Element::Int16 => whole!(i16),
        Element::UInt16 => whole!(u16),
        Element::Int32 => whole!(i32),
        Element::UInt32 => whole!(u32),
        Element::Int64 => whole!(i64),
        Element::UInt64 => whole!(u64),
        Element::Single => {
            let single = |index: usize| {
                let mut word = [0; 4];
                word.copy_from_slice(&elements[index * 4..index * 4 + 4]);
                one_nan(f64::from(f32::from_le_bytes(word))).to_le_bytes()
            };
            Ok(shape.image(Pixel::F64, shape.rows(single)))
        }
        Element::Double => {
            let double = |index: usize| {
                let mut word = [0; 8];
                word.copy_from_slice(&elements[index * 8..index * 8 + 8]);
                one_nan(f64::from_le_bytes(word)).to_le_bytes()
            };
            Ok(shape.image(Pixel::F64, shape.rows(double)))
        }
    }
}

#[cfg(test)]
#[path = "image_tests.rs"]
mod tests;
