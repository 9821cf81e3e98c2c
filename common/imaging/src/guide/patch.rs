//! A small piece of a frame around one star, cleaned on its own.
//!
//! Guiding looks at fifty such pieces and not at the other four million pixels.

use crate::background::{Background, Mesh, median_in_place};
use crate::camera::Camera;
use crate::clean::Clean;
use crate::frame::Frame;

/// MAD of a Gaussian, in sigma.
const MAD: f32 = 0.674_49;
/// Pixels further from the median than this many sigma are stars and not sky.
const CLIP: f32 = 3.0;
/// Noise is never below that of counting whole ADU.
const LEAST_NOISE_ADU: f32 = 0.29;

/// A piece of a frame and where it lies.
#[derive(Debug, Clone)]
pub(super) struct FramePatch {
    pub(super) clean: Clean,
    /// Frame coordinates of its first pixel.
    pub(super) left: usize,
    pub(super) top: usize,
}

impl FramePatch {
    /// The pixels within `half_px` of a place, less their sky, defects filled (`fwhm_px` is the stars' width). None
    /// outside of the frame, or where half of the pixels have no value.
    pub(super) fn cut(frame: &Frame, camera: &Camera, centre: (f64, f64), half_px: f64, fwhm_px: f32) -> Option<Self> {
        let range = |at: f64, length: usize| {
            let from = (at - half_px).round().clamp(0.0, length as f64) as usize;
            from..((at + half_px).round() + 1.0).clamp(0.0, length as f64) as usize
        };
        let (columns, rows) = (range(centre.0, frame.width()), range(centre.1, frame.height()));
        let (width, height) = (columns.len(), rows.len());
        if width < 5 || height < 5 {
            return None;
        }
        let saturation = camera.saturation_adu(frame);
        let fits = |width: usize, height: usize| (width, height) == (frame.width(), frame.height());
        let dark = camera.dark.filter(|dark| fits(dark.width(), dark.height()));
        let bad = camera.bad_pixels.filter(|map| fits(map.width(), map.height()));
        let (mut pixels, mut filled) = (Vec::with_capacity(width * height), Vec::new());
        let (mut saturated, mut missing, mut brightest_adu) = (0, 0, f32::NEG_INFINITY);
        for y in rows.clone() {
            for x in columns.clone() {
                let raw = frame.value(x, y);
                let is_bad =
                    bad.is_some_and(|map| map.positions().binary_search(&((y * frame.width() + x) as u32)).is_ok());
                saturated += usize::from(raw >= saturation);
                brightest_adu = brightest_adu.max(raw);
                let value = raw - dark.map_or(0.0, |dark| dark.value(x, y));
                if is_bad || !value.is_finite() {
                    filled.push(pixels.len() as u32);
                    missing += usize::from(!is_bad);
                    pixels.push(f32::NAN);
                } else {
                    pixels.push(value);
                }
            }
        }
        if 2 * filled.len() > pixels.len() {
            return None;
        }
        let (level, noise) = sky(&pixels)?;
        pixels.iter_mut().for_each(|pixel| *pixel -= level);
        let mesh = |value: f32| Mesh::new(1, 1, width, height, vec![Some(value)]);
        let background = Background { level: mesh(level)?, noise: mesh(noise)? };
        let mut clean =
            Clean { width, height, pixels, background, saturated, missing, brightest_adu, filled, banding: false };
        clean.fill_defects(0.8 * fwhm_px);
        Some(Self { clean, left: columns.start, top: rows.start })
    }
}

/// Clipped median and 1.4826 MAD, ADU.
fn sky(pixels: &[f32]) -> Option<(f32, f32)> {
    let mut retained: Vec<f32> = pixels.iter().copied().filter(|value| value.is_finite()).collect();
    let mut found = None;
    for _ in 0..4 {
        let level = median_in_place(&mut retained)?;
        let mut off: Vec<f32> = retained.iter().map(|value| (value - level).abs()).collect();
        let noise = (median_in_place(&mut off)? / MAD).max(LEAST_NOISE_ADU);
        found = Some((level, noise));
        let before = retained.len();
        retained.retain(|value| (value - level).abs() <= CLIP * noise);
        if retained.len() == before {
            break;
        }
    }
    found
}
