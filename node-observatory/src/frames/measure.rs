//! From a frame's bytes to its facts.

use config::{Observatory, Sensor};
use contract::device::camera::{Frame, Pixel};
use contract::observatory::FrameFacts;
use imaging::quality::{Estimate, Quality};
use imaging::{Camera, Clean, FrameError, Measured, Pixels, StarSearch};

/// What is known of a frame before it is measured.
pub fn unmeasured(frame: &Frame) -> FrameFacts {
    FrameFacts {
        frame: frame.id.clone(),
        camera: Some(frame.camera.clone()),
        filter: frame.purpose.filter.clone(),
        image_type: Some(frame.purpose.image_type.clone()),
        started_utc: Some(frame.started_utc),
        ..FrameFacts::default()
    }
}

/// Whether there is light of stars on a frame of this IMAGETYP; darks, biases and flats have none.
pub fn shows_stars(image_type: &str) -> bool {
    let kind = image_type.split_whitespace().next().unwrap_or_default();
    ["light", "acquisition"].iter().any(|starry| kind.eq_ignore_ascii_case(starry))
}

/// Measures the pixels of a frame; `fwhm_px` is the width of the stars on the last frame of this camera and binning.
///
/// Takes a while: not for async threads. A value that cannot be measured is absent, with the reason.
pub fn measure(frame: &Frame, plane: &Plane, camera: &Camera, fwhm_px: Option<f32>) -> (FrameFacts, Option<Measured>) {
    let mut facts = unmeasured(frame);
    let measured = plane.frame(frame).and_then(|pixels| {
        if shows_stars(&frame.purpose.image_type) {
            let search = StarSearch { fwhm_px, ..StarSearch::default() };
            let measured = imaging::measure(&pixels, camera, &search)?;
            describe(&mut facts, &measured.quality);
            Ok(Some(measured))
        } else {
            Clean::new(&pixels, camera, None).map(|clean| describe_level(&mut facts, &clean))?;
            Ok(None)
        }
    });
    let measured = measured.unwrap_or_else(|error| {
        if let FrameError::NoSky { pixels, saturated, .. } = &error {
            facts.saturated_fraction = if_finite(*saturated as f64 / *pixels as f64);
        }
        facts.reason = Some(format!("not measured: {error}"));
        None
    });
    (facts, measured)
}

/// The camera that took a frame, as the configuration and the frame's readings show it.
pub fn camera(config: &Observatory, frame: &Frame) -> Camera<'static> {
    let sensor = Sensor::of(config, frame);
    Camera {
        max_adu: sensor.max_adu.map(|adu| adu as f32),
        saturation_adu: sensor.saturation_adu.map(|adu| adu as f32),
        gain_e_per_adu: sensor.electrons_per_adu.map_or(1.0, |gain| gain as f32),
        ..Camera::default()
    }
}

fn describe(facts: &mut FrameFacts, quality: &Quality) {
    let value = |estimate: Option<Estimate>| estimate.and_then(|estimate| if_finite(estimate.value));
    facts.stars = u32::try_from(quality.stars).ok();
    facts.fwhm_px = value(quality.fwhm_px);
    facts.fwhm_error_px = quality.fwhm_px.and_then(|estimate| if_finite(estimate.error));
    facts.ellipticity = value(quality.ellipticity);
    facts.elongation_deg = quality.elongation_deg.and_then(if_finite);
    facts.trailed = Some(quality.trailed);
    facts.sky_adu = if_finite(quality.background_adu);
    facts.noise_adu = if_finite(quality.noise_adu);
    facts.saturated_fraction = if_finite(quality.saturated_fraction);
    facts.defect_fraction = if_finite(quality.defect_fraction);
}

fn describe_level(facts: &mut FrameFacts, clean: &Clean) {
    let pixels = clean.pixels.len() as f64;
    facts.sky_adu = if_finite(f64::from(clean.background.level.median()));
    facts.noise_adu = if_finite(f64::from(clean.background.noise.median()));
    facts.saturated_fraction = if_finite(clean.saturated as f64 / pixels);
    facts.defect_fraction = if_finite(clean.filled.len() as f64 / pixels);
}

/// A number as it may leave the node: finite, and without digits that no measurement has.
pub(super) fn if_finite(value: f64) -> Option<f64> {
    value.is_finite().then(|| (value * 1e6).round() / 1e6)
}

/// One plane of a frame, in numbers, row by row.
#[derive(Debug, PartialEq)]
pub enum Plane {
    /// Counts as the camera gave them.
    Counts(Vec<u16>),
    /// Numbers that are no counts of 16 bits.
    Floats(Vec<f32>),
}

impl Plane {
    /// The middle plane of a frame's bytes as they come from the spool (green of colour frames). The bytes are gone
    /// when it is made: a frame is in memory twice only for a moment.
    pub fn of(frame: &Frame, bytes: Vec<u8>) -> Self {
        let length = (frame.width_px as usize).saturating_mul(frame.height_px as usize);
        let length = length.saturating_mul(frame.pixel.bytes());
        let start = (frame.planes.max(1) as usize / 2).saturating_mul(length);
        let plane = bytes.get(start..start.saturating_add(length)).unwrap_or_default();
        match frame.pixel {
            Pixel::U16 => Self::Counts(pages::collect(plane.as_chunks().0.iter().map(|two| u16::from_le_bytes(*two)))),
            Pixel::I32 => {
                Self::Floats(pages::collect(plane.as_chunks().0.iter().map(|four| i32::from_le_bytes(*four) as f32)))
            }
            Pixel::F64 => {
                Self::Floats(pages::collect(plane.as_chunks().0.iter().map(|eight| f64::from_le_bytes(*eight) as f32)))
            }
        }
    }

    /// The plane with the shape that was announced.
    ///
    /// # Errors
    /// [`FrameError`] when there are not as many pixels as announced.
    pub fn frame(&self, frame: &Frame) -> Result<imaging::Frame<'_>, FrameError> {
        let pixels = match self {
            Self::Counts(counts) => Pixels::U16(counts),
            Self::Floats(floats) => Pixels::F32(floats),
        };
        imaging::Frame::new(frame.width_px as usize, frame.height_px as usize, pixels)
    }
}

#[cfg(test)]
mod tests {
    use contract::datum::ReadingOutcome;
    use contract::{Reading, Scalar};
    use units::Utc;

    use super::super::tests::{drawn, frame};
    use super::*;

    fn light(width_px: u32, height_px: u32, pixel: Pixel) -> Frame {
        let mut light = Frame { width_px, height_px, pixel, ..frame("f") };
        light.purpose.image_type = "Light Frame".to_owned();
        light
    }

    fn measure(frame: &Frame, bytes: Vec<u8>, fwhm_px: Option<f32>) -> FrameFacts {
        super::measure(frame, &Plane::of(frame, bytes), &Camera::default(), fwhm_px).0
    }

    fn bytes(pixels: &[u16]) -> Vec<u8> {
        pixels.iter().flat_map(|pixel| pixel.to_le_bytes()).collect()
    }

    #[test]
    fn stars_sky_and_noise_are_those_that_were_drawn() {
        let drawn = drawn(400, 300, 3.2, 40);
        let facts = measure(&light(400, 300, Pixel::U16), bytes(&drawn), None);
        assert_eq!(facts.reason, None);
        assert!(facts.stars.is_some_and(|stars| (36..=42).contains(&stars)), "{facts:?}");
        assert!((facts.fwhm_px.unwrap() - 3.2).abs() < 0.1, "{facts:?}");
        assert!((facts.sky_adu.unwrap() - 1000.0).abs() < 1.0, "{facts:?}");
        assert!((facts.noise_adu.unwrap() - 8.0).abs() < 0.4, "{facts:?}");
        assert_eq!((facts.trailed, facts.saturated_fraction), (Some(false), Some(0.0)));
        let again = measure(&light(400, 300, Pixel::U16), bytes(&drawn), facts.fwhm_px.map(|fwhm| fwhm as f32));
        assert!((again.fwhm_px.unwrap() - 3.2).abs() < 0.1, "with the last frame's width: {again:?}");
    }

    /// What the header says of the sensor is what the stars are measured by.
    #[test]
    fn stars_are_saturated_and_noisy_as_the_sensor_is_configured_before_what_its_driver_reports() {
        // Drawn on 1000 ADU, the brightest peaks at 3000.
        let drawn: Vec<u16> = drawn(400, 300, 3.2, 40).iter().map(|count| (count - 900) * 26).collect();
        let greatest = *drawn.iter().max().unwrap();
        assert!((52_000..58_000).contains(&greatest), "{greatest}");
        let mut frame = light(400, 300, Pixel::U16);
        for (name, value) in [("MaxADU", 65_535.0), ("ElectronsPerADU", 0.0)] {
            let outcome = ReadingOutcome::Value { value: Scalar::Float(value), unit: String::new() };
            frame.readings.insert(name.to_owned(), Reading { outcome, at_utc: Utc::EPOCH, age_s: None });
        }
        let measured = |of_block: &str| {
            let text = format!(
                "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0.0\nlongitude_deg = 0.0\nelevation_m = \
                 0.0\n[[camera]]\nname = \"cam\"\nserver = \"h:1\"\n{of_block}"
            );
            let config = config::parse(&text, std::path::Path::new(".")).unwrap();
            let camera = camera(&config, &frame);
            let (facts, measured) = super::measure(&frame, &Plane::of(&frame, bytes(&drawn)), &camera, None);
            (facts.saturated_fraction.unwrap(), measured.unwrap().stars)
        };
        let saturated = |stars: &[imaging::Star]| stars.iter().filter(|star| star.flags.saturated).count();
        let (fraction, stars) = measured("");
        assert_eq!((fraction, saturated(&stars)), (0.0, 0), "the driver's greatest count is not reached");
        let (fraction, burnt) = measured("saturation_adu = 50000.0\n");
        assert!(fraction > 0.0 && (1..10).contains(&saturated(&burnt)), "{fraction}, {}", saturated(&burnt));
        let (_, noisy) = measured("electrons_per_adu = 0.01\n");
        let error = |stars: &[imaging::Star]| stars[0].flux_error_adu;
        assert!(error(&noisy) > 2.0 * error(&stars), "{} and {}", error(&noisy), error(&stars));
    }

    #[test]
    fn every_kind_of_pixel_gives_the_same_facts() {
        let drawn = drawn(300, 200, 3.0, 20);
        let counts = measure(&light(300, 200, Pixel::U16), bytes(&drawn), None);
        let whole = drawn.iter().flat_map(|pixel| i32::from(*pixel).to_le_bytes()).collect();
        let float = drawn.iter().flat_map(|pixel| f64::from(*pixel).to_le_bytes()).collect();
        for (pixel, bytes) in [(Pixel::I32, whole), (Pixel::F64, float)] {
            let facts = measure(&light(300, 200, pixel), bytes, None);
            assert_eq!((facts.stars, facts.fwhm_px), (counts.stars, counts.fwhm_px), "{pixel:?}");
        }
        let mut colour = light(300, 200, Pixel::U16);
        colour.planes = 3;
        let planes = [bytes(&vec![9; 60_000]), bytes(&drawn), bytes(&vec![9; 60_000])].concat();
        assert_eq!(measure(&colour, planes, None).stars, counts.stars, "green is in the middle");
    }

    #[test]
    fn a_dark_has_level_and_noise_and_no_stars() {
        let mut dark = light(300, 200, Pixel::U16);
        dark.purpose.image_type = "Dark Frame".to_owned();
        let facts = measure(&dark, bytes(&drawn(300, 200, 3.0, 20)), None);
        assert!((facts.sky_adu.unwrap() - 1000.0).abs() < 1.0 && facts.noise_adu.is_some());
        assert_eq!((facts.stars, facts.fwhm_px, facts.trailed, facts.reason), (None, None, None, None));
    }

    #[test]
    fn what_cannot_be_measured_gives_the_reason() {
        let burnt = measure(&light(100, 100, Pixel::U16), bytes(&[65_535; 10_000]), None);
        assert!(burnt.reason.unwrap().contains("10000 are saturated"));
        assert_eq!(burnt.saturated_fraction, Some(1.0));
        let short = measure(&light(100, 100, Pixel::U16), vec![0; 10], None);
        assert!(short.reason.unwrap().contains("frame of 100 x 100 px"));
        let nothing = measure(&light(16, 16, Pixel::F64), [f64::NAN.to_le_bytes(); 256].concat(), None);
        assert!(nothing.reason.is_some() && serde_json::to_string(&nothing.sky_adu).unwrap() == "null");
    }

    #[test]
    fn bad_frames_between_good_ones_teach_nothing() {
        use super::super::widths::Widths;
        let good = drawn(400, 300, 3.9, 40);
        let mut rays = good.clone();
        (0..300).for_each(|n| (0..4).for_each(|step| rays[(13 + 397 * n + 401 * step) % good.len()] = 30_000));
        let mut trail = good.clone();
        (0..300).for_each(|y| (0..4).for_each(|x| trail[400 * y + 40 + y + x] = 9_000));
        let bad = [rays, trail, vec![1000; good.len()], vec![65_535; good.len()], drawn(400, 300, 15.0, 6)];
        let mut widths = Widths::default();
        let mut look = |counts: &[u16]| {
            let facts =
                measure(&light(400, 300, Pixel::U16), bytes(counts), widths.known_px().map(|width| width as f32));
            widths.observe_facts(&facts);
            (facts, widths.known_px().unwrap())
        };
        for counts in [&good].into_iter().chain(bad.iter().flat_map(|bad| [bad, bad, &good])) {
            let (facts, known_px) = look(counts);
            assert!((known_px / 3.9 - 1.0).abs() < 0.1, "{known_px} px is handed on after {facts:?}");
        }
        // A focus that is lost is followed at the third frame.
        let lost = drawn(400, 300, 9.0, 20);
        let known: Vec<f64> = (0..3).map(|_| look(&lost).1).collect();
        assert!(known[1] < 4.5 && (known[2] / 9.0 - 1.0).abs() < 0.1, "{known:?}");
    }
}
