//! Frames that show nothing, or nonsense: an answer, never a panic.

use imaging::{Camera, Frame, FrameError, Pixels, StarSearch, measure};
use proptest::prelude::*;

fn look(width: usize, height: usize, pixels: Pixels) -> Result<imaging::Measured, FrameError> {
    measure(&Frame::new(width, height, pixels)?, &Camera::default(), &StarSearch::default())
}

#[test]
fn constant_frames_have_a_sky_and_no_star() {
    for (width, height) in [(1, 1), (1, 2000), (2000, 1), (2, 2), (3, 5), (63, 65), (700, 300), (1600, 1600)] {
        for value in [0, 1, 300, 50_000] {
            let measured = look(width, height, Pixels::U16(&vec![value; width * height])).unwrap();
            assert!(measured.stars.is_empty(), "{width} x {height} of {value}");
            let quality = &measured.quality;
            assert!((quality.background_adu - f64::from(value)).abs() < 0.01, "{quality:?}");
            assert!(quality.noise_adu > 0.0 && quality.noise_adu < 0.5, "{quality:?}");
            assert!(quality.fwhm_px.is_none() && !quality.trailed && quality.saturated_fraction == 0.0);
        }
        let flat = look(width, height, Pixels::F32(&vec![0.1; width * height])).unwrap();
        assert!(flat.stars.is_empty());
    }
}

#[test]
fn an_empty_frame_is_refused() {
    assert!(matches!(look(0, 0, Pixels::U16(&[])), Err(FrameError::Shape { .. })));
}

#[test]
fn saturated_frames_and_frames_of_nan_are_reported() {
    let all = look(100, 80, Pixels::U16(&[65_535; 8000])).unwrap_err();
    assert_eq!(all, FrameError::NoSky { pixels: 8000, saturated: 8000, missing: 0 });
    let none = look(100, 80, Pixels::F32(&[f32::NAN; 8000])).unwrap_err();
    assert_eq!(none, FrameError::NoSky { pixels: 8000, saturated: 0, missing: 8000 });
    assert!(none.to_string().contains("no usable sky"), "{none}");
    assert!(look(1, 1, Pixels::F32(&[f32::INFINITY])).is_err());
}

#[test]
fn a_frame_half_of_nan_is_measured_in_its_other_half() {
    let mut pixels: Vec<f32> = (0..600 * 400).map(|n| ((n * 7919) % 101) as f32 * 0.1).collect();
    for row in pixels.chunks_mut(600) {
        row[..300].fill(f32::NAN);
    }
    let measured = look(600, 400, Pixels::F32(&pixels)).unwrap();
    assert!((measured.quality.background_adu - 5.0).abs() < 0.5);
    assert!((measured.quality.defect_fraction - 0.5).abs() < 0.01);
}

#[test]
fn a_dark_or_a_map_of_another_shape_is_refused() {
    let pixels = vec![100_u16; 64];
    let frame = Frame::new(8, 8, Pixels::U16(&pixels)).unwrap();
    let dark = Frame::new(4, 16, Pixels::U16(&pixels)).unwrap();
    let camera = Camera { dark: Some(dark), ..Camera::default() };
    let refused = measure(&frame, &camera, &StarSearch::default()).unwrap_err();
    assert!(matches!(refused, FrameError::Mismatch { what: "dark", found_width: 4, .. }), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Any bits, any shape.
    #[test]
    fn any_counts_give_an_answer(
        width in 1_usize..90, height in 1_usize..90, values in prop::collection::vec(any::<u16>(), 1..40),
        step in 1_usize..13, fwhm in prop::option::of(any::<f32>()),
    ) {
        let pixels: Vec<u16> = (0..width * height).map(|n| values[(n * step + n / 7) % values.len()]).collect();
        let frame = Frame::new(width, height, Pixels::U16(&pixels)).unwrap();
        let search = StarSearch { fwhm_px: fwhm, ..StarSearch::default() };
        if let Ok(measured) = measure(&frame, &Camera::default(), &search) {
            prop_assert!(measured.quality.noise_adu > 0.0);
            for star in &measured.stars {
                prop_assert!(star.x_px.is_finite() && star.y_px.is_finite() && star.flux_adu.is_finite());
                prop_assert!(star.x_error_px >= 0.01 && star.snr.is_finite() && star.fwhm_px.is_finite(), "{:?}", star);
            }
        }
    }

    #[test]
    fn any_floats_give_an_answer(
        width in 1_usize..60, height in 1_usize..60, values in prop::collection::vec(any::<f32>(), 1..60),
    ) {
        let pixels: Vec<f32> = (0..width * height).map(|n| values[(n * 11 + n / 5) % values.len()]).collect();
        if let Ok(measured) = look(width, height, Pixels::F32(&pixels)) {
            for star in &measured.stars {
                prop_assert!(star.x_px.is_finite() && star.y_px.is_finite(), "{:?}", star);
            }
        }
    }
}
