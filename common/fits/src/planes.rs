//! One plane out of the three of a colour image.

use crate::pixels::Pixels;

/// Planes of a colour image.
pub(crate) const COLOURS: u64 = 3;
/// The greatest count, as a share of what so many bits hold, that is no sign of saturation.
const FULL: f32 = 0.9;

/// The mean of the planes that follow one another, `length` pixels each. Where one of them is saturated the greatest
/// value is taken: a mean must not hide saturation. A pixel without a value in one plane has none.
pub(crate) fn mean(pixels: &Pixels, length: usize, bitpix: i64) -> Pixels {
    let full = match bitpix {
        8 => FULL * 255.0,
        16 => FULL * 65_535.0,
        _ => f32::INFINITY,
    };
    let value = |at: usize| match pixels {
        Pixels::U16(counts) => counts.get(at).copied().map_or(f32::NAN, f32::from),
        Pixels::F32(floats) => floats.get(at).copied().unwrap_or(f32::NAN),
    };
    let count = pixels.len() / length.max(1);
    Pixels::F32(pages::collect((0..length).map(|n| {
        let planes = (0..count).map(|plane| value(plane * length + n));
        let (sum, most) = planes.fold((0.0, f32::NEG_INFINITY), |(sum, most): (f32, f32), v| (sum + v, most.max(v)));
        if most >= full { most } else { sum / count as f32 }
    })))
}
