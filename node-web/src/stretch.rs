//! From sky counts to grey values that an eye can read.

use crate::shrink::Small;

/// The darkest and the brightest of these parts of all pixels become black and white.
const BLACK_PART: f64 = 0.02;
const WHITE_PART: f64 = 0.998;
/// How strongly faint light is lifted; `asinh(30 x) / asinh(30)`.
const LIFT: f32 = 30.0;

/// Grey values by an asinh between two percentiles; a flat picture is mid-grey.
pub fn stretch(small: &Small) -> Vec<u8> {
    let mut sorted: Vec<f32> = small.pixels.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let at = |part: f64| sorted.get(((sorted.len().saturating_sub(1)) as f64 * part).round() as usize).copied();
    let (Some(black), Some(white)) = (at(BLACK_PART), at(WHITE_PART)) else {
        return vec![0; small.pixels.len()];
    };
    if white <= black {
        return small.pixels.iter().map(|value| if value.is_finite() { 128 } else { 0 }).collect();
    }
    let grey = |value: f32| {
        let x = ((value - black) / (white - black)).clamp(0.0, 1.0);
        ((LIFT * x).asinh() / LIFT.asinh() * 255.0).round() as u8
    };
    small.pixels.iter().map(|value| if value.is_finite() { grey(*value) } else { 0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small(pixels: Vec<f32>) -> Small {
        Small { width: pixels.len(), height: 1, pixels }
    }

    #[test]
    fn brighter_pixels_are_never_darker_and_the_range_is_used() {
        let mut pixels: Vec<f32> = (0..1000u16).map(|i| 1000.0 + f32::from(i % 50)).collect();
        pixels.extend([1500.0, 30000.0, 60000.0]);
        let grey = stretch(&small(pixels.clone()));
        let mut pairs: Vec<(f32, u8)> = pixels.into_iter().zip(grey).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert!(pairs.windows(2).all(|pair| pair[0].1 <= pair[1].1));
        assert_eq!((pairs[0].1, pairs[pairs.len() - 1].1), (0, 255));
    }

    #[test]
    fn a_flat_or_empty_picture_is_no_division_by_zero() {
        assert_eq!(stretch(&small(vec![7.0; 4])), [128; 4]);
        assert_eq!(stretch(&small(vec![f32::NAN; 3])), [0; 3]);
        assert!(stretch(&small(vec![])).is_empty());
    }
}
