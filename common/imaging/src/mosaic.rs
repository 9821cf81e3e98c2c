//! Frames of cameras with colour filters on their pixels (RGGB and its turns), measured as a whole.
//!
//! Neighbouring pixels see different colours, so the sky has a pattern of 2 x 2 px that a search takes for noise or
//! for stars. The mean of each 2 x 2 px has one red, one blue and two green pixels wherever the pattern begins; that
//! image is measured, and places, widths and brightness are given back for the frame itself.

use crate::background::median_in_place;
use crate::bad_pixels::BadPixelMap;
use crate::camera::Camera;
use crate::frame::{Frame, FrameError, Pixels};
use crate::measure::{Measured, StarSearch, measure};
use crate::quality::Estimate;
use crate::star::Star;

/// Cells of 2 x 2 px that are looked at to see a pattern; fewer than the least show none.
const CELLS: std::ops::Range<usize> = 100..50_000;
/// A pattern weaker than this share of a pixel's noise disturbs nothing.
const WEAKEST: f64 = 0.5;

/// Whether the sky's level has the pattern of a colour mosaic: two of the four pixels of a cell, on one diagonal, are
/// alike, and the others are not. Rows or columns that are off as a whole are no mosaic.
pub fn is_mosaic(frame: &Frame) -> bool {
    let (columns, rows) = (frame.width() / 2, frame.height() / 2);
    let count = columns * rows;
    let (mut across, mut down, mut up) = (Vec::new(), Vec::new(), Vec::new());
    // a step that is not a divisor of the row's length comes to all columns
    for cell in (0..count).step_by((count / CELLS.end).max(1) | 1) {
        let (x, y) = (2 * (cell % columns), 2 * (cell / columns));
        let [a, b, c, d] = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| frame.value(x, y));
        if [a, b, c, d].iter().all(|value| value.is_finite()) {
            across.push(0.5 * (a + d - b - c));
            down.push(a - d);
            up.push(c - b);
        }
    }
    if across.len() < CELLS.start {
        return false;
    }
    let (Some(across), Some(down), Some(up)) = (typical(across), typical(down), typical(up)) else { return false };
    // the difference of two like pixels has the noise of both
    let noise = down.spread.min(up.spread) / std::f64::consts::SQRT_2;
    let [across, down, up] = [across, down, up].map(|difference| difference.mean.abs());
    let contrast = across.max(down).max(up);
    contrast > WEAKEST * noise && down.min(up) < 0.25 * contrast
}

struct Typical {
    mean: f64,
    spread: f64,
}

/// Mean of the values within three sigma of their median (finer than a median of whole counts), and sigma by the MAD.
fn typical(mut values: Vec<f32>) -> Option<Typical> {
    let middle = median_in_place(&mut values)?;
    let mut apart: Vec<f32> = values.iter().map(|value| (value - middle).abs()).collect();
    let sigma = 1.4826 * median_in_place(&mut apart)?;
    values.retain(|value| (value - middle).abs() <= 3.0 * sigma);
    let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
    Some(Typical { mean, spread: f64::from(sigma) })
}

/// As [`measure`], of a frame with a colour mosaic. Places are px of the frame itself, fluxes sums over its pixels,
/// background and noise those of its single pixels in the mean of the colours.
///
/// # Errors
/// As [`measure`]; [`FrameError::Shape`] for a frame of one column or row.
pub fn measure_mosaic(frame: &Frame, camera: &Camera, search: &StarSearch) -> Result<Measured, FrameError> {
    if let Some(map) = camera.bad_pixels {
        fitting(frame, "bad-pixel map", map.width(), map.height())?;
    }
    let saturation_adu = camera.saturation_adu(frame);
    let means = BinnedMeans::new(frame, saturation_adu, camera.bad_pixels);
    let dark = camera.dark.map(|dark| {
        fitting(frame, "dark", dark.width(), dark.height())?;
        Ok(BinnedMeans::new(&dark, f32::INFINITY, None))
    });
    let dark = dark.transpose()?;
    let camera = Camera {
        max_adu: camera.max_adu,
        saturation_adu: Some(saturation_adu),
        // the mean of four has a quarter of the photon noise's square
        gain_e_per_adu: 4.0 * camera.gain_e_per_adu,
        dark: dark.as_ref().map(BinnedMeans::frame).transpose()?,
        bad_pixels: None,
    };
    let search = StarSearch { fwhm_px: search.fwhm_px.map(|width| 0.5 * width), ..*search };
    let mut measured = measure(&means.frame()?, &camera, &search)?;
    measured.stars.iter_mut().for_each(|star| *star = in_frame(star));
    let quality = &mut measured.quality;
    quality.fwhm_px = quality.fwhm_px.map(|width| Estimate { value: 2.0 * width.value, error: 2.0 * width.error });
    quality.noise_adu *= 2.0;
    Ok(measured)
}

/// A star of the means, as it stands in the frame.
fn in_frame(star: &Star) -> Star {
    Star {
        // pixel 0 of the means covers 0 and 1
        x_px: 2.0 * star.x_px + 0.5,
        y_px: 2.0 * star.y_px + 0.5,
        x_error_px: 2.0 * star.x_error_px,
        y_error_px: 2.0 * star.y_error_px,
        flux_adu: 4.0 * star.flux_adu,
        flux_error_adu: 4.0 * star.flux_error_adu,
        fwhm_px: 2.0 * star.fwhm_px,
        ..*star
    }
}

/// Means of 2 x 2 px; a last odd column or row is left out.
struct BinnedMeans {
    width: usize,
    height: usize,
    pixels: Vec<f32>,
}

impl BinnedMeans {
    /// Where one of the four is saturated, the greatest of them stands: saturation must not hide in a mean.
    fn new(frame: &Frame, saturation: f32, bad: Option<&BadPixelMap>) -> Self {
        let (width, height) = (frame.width() / 2, frame.height() / 2);
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| frame.value(2 * x + i, 2 * y + j));
                let most = four.iter().fold(f32::NEG_INFINITY, |most, value| most.max(*value));
                pixels.push(if most >= saturation { most } else { 0.25 * four.iter().sum::<f32>() });
            }
        }
        for at in bad.map_or(&[][..], BadPixelMap::positions) {
            let (x, y) = (*at as usize % frame.width() / 2, *at as usize / frame.width() / 2);
            if x < width && y < height {
                pixels[y * width + x] = f32::NAN;
            }
        }
        Self { width, height, pixels }
    }

    fn frame(&self) -> Result<Frame<'_>, FrameError> {
        Frame::new(self.width, self.height, Pixels::F32(&self.pixels))
    }
}

fn fitting(frame: &Frame, what: &'static str, found_width: usize, found_height: usize) -> Result<(), FrameError> {
    let (width, height) = (frame.width(), frame.height());
    if (found_width, found_height) == (width, height) {
        return Ok(());
    }
    Err(FrameError::Mismatch { what, found_width, found_height, width, height })
}
