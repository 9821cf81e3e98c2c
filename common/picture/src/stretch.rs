//! From sky counts to grey values that an eye can read.

use crate::{Small, zscale};

/// The darkest and the brightest of these parts of all pixels become black and white.
const BLACK_PART: f64 = 0.02;
const WHITE_PART: f64 = 0.998;
/// How strongly faint light is lifted; `asinh(30 x) / asinh(30)`.
const LIFT: f32 = 30.0;
/// How strongly the logarithm lifts it; `log(1 + 1000 x) / log(1001)`.
const LOG_LIFT: f32 = 1000.0;
/// Steps of the table from counts to grey.
const STEPS: usize = 4096;
/// Pixels of which percentiles are taken: so many give them to a fraction of the noise.
const SAMPLE: usize = 65_536;

/// The curve from black to white.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Curve {
    /// Faint light is lifted, bright stars keep their shape.
    #[default]
    Asinh,
    /// Straight, between the limits of IRAF's zscale.
    Zscale,
    /// Straight.
    Linear,
    /// The square root.
    Sqrt,
    /// The logarithm.
    Log,
}

/// How counts become grey.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Look {
    /// The curve.
    pub curve: Curve,
    /// The count that is black; a percentile of the picture where absent.
    pub low: Option<f32>,
    /// The count that is white; a percentile of the picture where absent.
    pub high: Option<f32>,
    /// Stars are black.
    pub inverted: bool,
}

/// Grey values by an asinh between two percentiles; a flat picture is mid-grey.
pub fn stretch(small: &Small) -> Vec<u8> {
    stretch_as(small, Look::default())
}

/// Grey values; a flat picture is mid-grey, and what has no value is black, or white where stars are black.
pub fn stretch_as(small: &Small, look: Look) -> Vec<u8> {
    let turned = |grey: u8| if look.inverted { 255 - grey } else { grey };
    let nothing = turned(0);
    let Some((low, high)) = limits(small, look) else { return vec![nothing; small.pixels.len()] };
    let flat = turned(128);
    if high <= low {
        return small.pixels.iter().map(|value| if value.is_finite() { flat } else { nothing }).collect();
    }
    let table: Vec<u8> = (0..=STEPS).map(|step| turned(grey(look.curve, step as f32 / STEPS as f32))).collect();
    let steps = STEPS as f32 / (high - low);
    let of = |value: f32| {
        let step = ((value - low) * steps).clamp(0.0, STEPS as f32);
        table.get((step + 0.5) as usize).copied().unwrap_or(nothing)
    };
    small.pixels.iter().map(|value| if value.is_finite() { of(*value) } else { nothing }).collect()
}

fn limits(small: &Small, look: Look) -> Option<(f32, f32)> {
    if let (Some(low), Some(high)) = (look.low, look.high) {
        return Some((low, high));
    }
    let (low, high) =
        if look.curve == Curve::Zscale { zscale::limits(&small.pixels)? } else { percentiles(&small.pixels)? };
    Some((look.low.unwrap_or(low), look.high.unwrap_or(high)))
}

/// The darkest and brightest parts of a sample that is spread over the picture.
fn percentiles(pixels: &[f32]) -> Option<(f32, f32)> {
    // A step that shares no factor with the length of a row meets all columns.
    let step = (pixels.len() / SAMPLE).max(1) | 1;
    let mut sample: Vec<f32> = pixels.iter().step_by(step).copied().filter(|value| value.is_finite()).collect();
    if sample.is_empty() {
        sample = pixels.iter().copied().filter(|value| value.is_finite()).collect();
    }
    let last = sample.len().checked_sub(1)?;
    let mut at = |part: f64| {
        let (_, value, _) = sample.select_nth_unstable_by((last as f64 * part).round() as usize, f32::total_cmp);
        *value
    };
    Some((at(BLACK_PART), at(WHITE_PART)))
}

/// Grey from 0 to 255 of a part from 0 to 1.
fn grey(curve: Curve, part: f32) -> u8 {
    let bright = match curve {
        Curve::Asinh => (LIFT * part).asinh() / LIFT.asinh(),
        Curve::Zscale | Curve::Linear => part,
        Curve::Sqrt => part.sqrt(),
        Curve::Log => (LOG_LIFT * part).ln_1p() / LOG_LIFT.ln_1p(),
    };
    (bright * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVES: [Curve; 5] = [Curve::Asinh, Curve::Zscale, Curve::Linear, Curve::Sqrt, Curve::Log];

    fn small(pixels: Vec<f32>) -> Small {
        Small { width: pixels.len(), height: 1, pixels }
    }

    #[test]
    fn brighter_pixels_are_never_darker_and_the_range_is_used() {
        let mut pixels: Vec<f32> = (0..1000u16).map(|i| 1000.0 + f32::from(i % 50)).collect();
        pixels.extend([1500.0, 30000.0, 60000.0]);
        for curve in CURVES {
            let grey = stretch_as(&small(pixels.clone()), Look { curve, ..Look::default() });
            let mut pairs: Vec<(f32, u8)> = pixels.iter().copied().zip(grey.iter().copied()).collect();
            pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
            assert!(pairs.windows(2).all(|pair| pair[0].1 <= pair[1].1), "{curve:?}");
            assert_eq!((pairs[0].1, pairs[pairs.len() - 1].1), (0, 255), "{curve:?}");
            let inverted = stretch_as(&small(pixels.clone()), Look { curve, inverted: true, ..Look::default() });
            assert!(grey.iter().zip(inverted).all(|(grey, inverted)| 255 - grey == inverted), "{curve:?}");
        }
    }

    #[test]
    fn given_limits_are_black_and_white() {
        let look = Look { curve: Curve::Linear, low: Some(100.0), high: Some(300.0), inverted: false };
        assert_eq!(stretch_as(&small(vec![0.0, 100.0, 200.0, 300.0, 9e9]), look), [0, 0, 128, 255, 255]);
        let low = Look { curve: Curve::Linear, low: Some(-100.0), ..Look::default() };
        assert_eq!(stretch_as(&small(vec![0.0, 100.0]), low), [128, 255]);
    }

    #[test]
    fn a_flat_or_empty_picture_is_no_division_by_zero() {
        for curve in CURVES {
            let look = Look { curve, ..Look::default() };
            assert_eq!(stretch_as(&small(vec![7.0; 4]), look), [128; 4]);
            assert_eq!(stretch_as(&small(vec![f32::NAN; 3]), look), [0; 3]);
            assert!(stretch_as(&small(vec![]), look).is_empty());
        }
        assert_eq!(stretch(&small(vec![f32::MIN, f32::MAX])).len(), 2);
    }
}
