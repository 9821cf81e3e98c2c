//! A transit of a known depth, from pixels to the light curve.

use contract::Reading;
use contract::observatory::FrameWcs;
use report::events::{FluxRecord, FrameRecord, NightEvents};
use units::Utc;

use super::*;

const SIZE: usize = 256;
const FRAMES: u32 = 60;
const DEPTH: f64 = 0.012;
const GAIN: f64 = 1.5;
const SKY_ADU: f64 = 400.0;
/// Column, row and flux, ADU: the target first.
const STARS: [(f64, f64, f64); 6] = [
    (128.3, 130.6, 4e5),
    (60.2, 70.1, 5e5),
    (190.7, 60.4, 4.5e5),
    (70.5, 190.2, 6e5),
    (200.1, 180.9, 3e5),
    (128.0, 60.0, 3.5e5),
];

/// Numbers of a normal distribution that are the same in each run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

fn is_in_transit(number: u32) -> bool {
    (20..40).contains(&number)
}

/// A frame through thin clouds, with the seeing and the drift of its number.
fn pixels(number: u32, noise: &mut Noise) -> (Vec<u16>, f64, (f64, f64)) {
    let fwhm = 3.0 + 0.6 * f64::from(number % 5) / 5.0;
    let drift = (0.1 * f64::from(number), -0.05 * f64::from(number));
    let clouds = 1.0 - 0.2 * f64::from(number % 7) / 7.0;
    let sigma = fwhm / 2.354_82;
    let mut values = vec![SKY_ADU; SIZE * SIZE];
    for (index, (x0, y0, flux)) in STARS.into_iter().enumerate() {
        let dip = if index == 0 && is_in_transit(number) { 1.0 - DEPTH } else { 1.0 };
        let peak = flux * dip * clouds / (std::f64::consts::TAU * sigma * sigma);
        for y in 0..SIZE {
            for x in 0..SIZE {
                let d2 = (x as f64 - x0 - drift.0).powi(2) + (y as f64 - y0 - drift.1).powi(2);
                if d2 < 64.0 * sigma * sigma {
                    values[y * SIZE + x] += peak * (-d2 / (2.0 * sigma * sigma)).exp();
                }
            }
        }
    }
    let noisy = values.iter().map(|value| (value + noise.normal() * (value / GAIN).sqrt()).round() as u16);
    (noisy.collect(), fwhm, drift)
}

fn frame(number: u32) -> Frame {
    let text = include_str!("../../../common/contract/golden/v1/camera.frame.json");
    let samples: serde_json::Value = serde_json::from_str(text).unwrap();
    let mut frame: Frame = serde_json::from_value(samples.get(0).unwrap_or(&samples).clone()).unwrap();
    frame.id = CommandId(format!("f{number}"));
    (frame.purpose.object, frame.purpose.image_type) = (Some("transit".to_owned()), "Light Frame".to_owned());
    (frame.purpose.action, frame.exposure_s) = ("object".to_owned(), 60.0);
    frame.started_utc = Utc::from_seconds(1_795_220_000.0 + 70.0 * f64::from(number));
    let at_utc = frame.started_utc;
    let mut read = |name: &str, value: f64| {
        let outcome = serde_json::from_value(serde_json::json!({ "value": value })).unwrap();
        frame.readings.insert(name.to_owned(), Reading { outcome, at_utc, age_s: None });
    };
    read("ElectronsPerADU", GAIN);
    read("MaxADU", 65_535.0);
    frame
}

/// The sensor of a frame whose camera has this in its block.
fn sensor(of_block: &str, frame: &Frame) -> Sensor {
    let block = format!("[[camera]]\nname = \"{}\"\nserver = \"h:1\"\n{of_block}", frame.camera);
    Sensor::of(&config::parse(&format!("{}{block}", test_support::PARANAL), Path::new("/")).unwrap(), frame)
}

/// A solution whose error is a few tenths of a pixel.
fn facts(number: u32, fwhm_px: f64, drift: (f64, f64)) -> FrameFacts {
    let off = 0.3 * f64::from(number % 3) - 0.3;
    let wcs = FrameWcs {
        ra_deg: 150.0,
        dec_deg: 2.0,
        x_px: 128.0 + drift.0 + off,
        y_px: 128.0 + drift.1 - off,
        cd_deg_px: [[-1e-4, 0.0], [0.0, 1e-4]],
        sip: None,
    };
    FrameFacts { wcs: Some(wcs), fwhm_px: Some(fwhm_px), ..FrameFacts::default() }
}

#[test]
fn a_transit_of_known_depth_has_this_depth_in_the_light_curve() {
    let mut noise = Noise(7);
    let base = imaging::Wcs {
        ra: Angle::from_degrees(150.0),
        dec: Angle::from_degrees(2.0),
        ..wcs(&facts(1, 3.0, (0.0, 0.0)).wcs.unwrap())
    };
    let (ra, dec) = base.pixel_to_sky(STARS[0].0, STARS[0].1);
    let start = Utc::from_seconds(1_795_210_000.0);
    let mut events = NightEvents::new(start, start.plus_seconds(86_400.0), start.plus_seconds(80_000.0));
    let mut known = Vec::new();
    for number in 0..FRAMES {
        let (values, fwhm, drift) = pixels(number, &mut noise);
        let (mut frame, facts) = (frame(number), facts(number, fwhm, drift));
        (frame.purpose.ra_deg, frame.purpose.dec_deg) = (Some(ra.degrees()), Some(dec.degrees()));
        let image = imaging::Frame::new(SIZE, SIZE, Pixels::U16(&values)).unwrap();
        let measured =
            measure(&image, &frame, sensor("", &frame), &facts, known.clone(), series("callisto", &frame)).unwrap();
        if number == 0 {
            known = measured.new_stars.clone();
            assert_eq!(known.len(), STARS.len(), "the target and all five stars");
        } else {
            assert!(measured.new_stars.is_empty());
        }
        events.fluxes.extend(measured.fluxes.iter().map(|flux| FluxRecord {
            frame: frame.id.0.clone(),
            series: measured.series.clone(),
            star: flux.star,
            x_px: flux.x_px,
            y_px: flux.y_px,
            flux_adu: flux.flux_adu,
            error_adu: flux.error_adu,
            is_saturated: flux.is_saturated,
        }));
        events.frames.push(FrameRecord {
            id: frame.id.0.clone(),
            file: String::new(),
            camera: frame.camera.clone(),
            action: "object".to_owned(),
            image_type: "Light Frame".to_owned(),
            object: Some("transit".to_owned()),
            filter: None,
            row: None,
            started: frame.started_utc,
            exposure_s: 60.0,
            bin: frame.bin,
            bytes: 0,
            is_complete: true,
            refused: None,
            unmeasured: None,
            is_solved: true,
            fwhm_px: Some(fwhm),
            scale_arcsec_px: Some(0.36),
            ellipticity: None,
            sky_adu: None,
            transparency: None,
            off_target_arcmin: None,
            airmass: None,
        });
    }
    let curves = report::make(&events).curves;
    let curve = &curves[0];
    assert_eq!((curve.points.len(), curve.comparison_stars), (FRAMES as usize, 5));
    let (mut inside, mut outside, mut error) = (Vec::new(), Vec::new(), 0.0_f64);
    for (number, point) in (0..FRAMES).zip(&curve.points) {
        if is_in_transit(number) {
            inside.push(point.flux)
        } else {
            outside.push(point.flux)
        }
        error += point.flux_error / f64::from(FRAMES);
    }
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
    let scatter = |of: &[f64]| (of.iter().map(|v| (v - mean(of)).powi(2)).sum::<f64>() / (of.len() - 1) as f64).sqrt();
    let depth = 1.0 - mean(&inside) / mean(&outside);
    let depth_error = error * (1.0 / inside.len() as f64 + 1.0 / outside.len() as f64).sqrt();
    println!("depth {depth:.5} +- {depth_error:.5}, scatter {:.5}, error of a point {error:.5}", scatter(&outside));
    assert!((depth - DEPTH).abs() < 3.0 * depth_error, "{depth} +- {depth_error}, simulated {DEPTH}");
    // The errors are those of the photons: the points scatter as much, no more and no less.
    assert!((0.7..1.4).contains(&(scatter(&outside) / error)), "{} and {error}", scatter(&outside));
    let last = curve.points.last().unwrap();
    assert!((last.dx_px - 5.9).abs() < 0.1 && (last.dy_px + 2.95).abs() < 0.1, "{last:?}");
}

#[test]
fn a_star_has_the_same_light_wherever_in_its_pixel_it_stands() {
    // The profile that the simulator draws too, a Moffat function of exponent 3, for each width of stars that are sampled well.
    for (fwhm, most) in [(2.4, 8e-4), (3.3, 4e-4), (5.0, 1.5e-4)] {
        let fluxes = (0..36).map(|step| {
            let (x0, y0) = (64.0 + 0.17 * f64::from(step % 6), 64.0 + 0.17 * f64::from(step / 6));
            let alpha2 = (fwhm / 1.019_65_f64).powi(2);
            let light =
                |x: usize, y: usize| (1.0 + ((x as f64 - x0).powi(2) + (y as f64 - y0).powi(2)) / alpha2).powi(-3);
            let values: Vec<f32> = (0..128 * 128).map(|at| (400.0 + 4e4 * light(at % 128, at / 128)) as f32).collect();
            let image = imaging::Frame::new(128, 128, Pixels::F32(&values)).unwrap();
            aperture::measure(&image, (x0, y0), fwhm, 1.0, 6e4).unwrap().flux_adu
        });
        let fluxes: Vec<f64> = fluxes.collect();
        let [least, greatest] =
            [fluxes.iter().copied().fold(f64::MAX, f64::min), fluxes.iter().copied().fold(0.0, f64::max)];
        println!("{fwhm} px: from the least to the greatest {:.6}", greatest / least - 1.0);
        assert!(greatest / least - 1.0 < most, "{fwhm} px: {least} to {greatest}");
    }
}

/// The target's peak is at 37,000 ADU, and one comparison star is below 30,000.
#[test]
fn a_light_curve_goes_by_the_sensor_as_configured_before_what_its_driver_reports() {
    let (values, fwhm, drift) = pixels(0, &mut Noise(7));
    let image = imaging::Frame::new(SIZE, SIZE, Pixels::U16(&values)).unwrap();
    let (mut frame, facts) = (frame(0), facts(0, fwhm, drift));
    let (ra, dec) = wcs(facts.wcs.as_ref().unwrap()).pixel_to_sky(STARS[0].0, STARS[0].1);
    (frame.purpose.ra_deg, frame.purpose.dec_deg) = (Some(ra.degrees()), Some(dec.degrees()));
    let target = |of_block: &str| {
        let measured = measure(&image, &frame, sensor(of_block, &frame), &facts, vec![], "s".to_owned()).unwrap();
        (measured.fluxes[0].is_saturated, measured.fluxes[0].error_adu, measured.fluxes.len())
    };
    let (is_saturated, error, stars) = target("");
    assert!(!is_saturated && stars == STARS.len());
    let (is_saturated, _, stars) = target("saturation_adu = 32000.0\n");
    assert!(is_saturated && stars == 2, "the target and the one star that is good: {stars}");
    let (_, noisy, _) = target("electrons_per_adu = 0.25\n");
    assert!(noisy > 2.0 * error, "{noisy} and {error}");
}

#[test]
fn a_star_outside_of_the_frame_or_no_star_is_not_measured() {
    let flat = vec![400_u16; SIZE * SIZE];
    let image = imaging::Frame::new(SIZE, SIZE, Pixels::U16(&flat)).unwrap();
    for place in [(5.0, 100.0), (100.0, 254.0), (-10.0, 100.0), (f64::NAN, 100.0), (128.0, 128.0)] {
        assert_eq!(aperture::measure(&image, place, 3.0, 1.0, 6e4), None, "{place:?}");
    }
    let frame = frame(0);
    let sensor = sensor("", &frame);
    assert_eq!(measure(&image, &frame, sensor, &FrameFacts::default(), vec![], "s".to_owned()), None);
    assert_eq!(measure(&image, &frame, sensor, &facts(0, 3.0, (0.0, 0.0)), vec![], "s".to_owned()), None);
}

#[test]
fn a_frame_that_fails_is_tried_five_times_and_one_without_a_target_once() {
    let (mut tried, begin) = (Tried::default(), MachineTime::from_boot(Duration::from_secs(1000)));
    let [failing, empty] = ["failing", "empty"].map(|id| CommandId(id.to_owned()));
    tried.finish(&empty);
    let (mut tries, mut second) = (Vec::new(), 0);
    while second < 86_400 {
        let now = begin.plus(Duration::from_secs(second));
        assert!(!tried.is_due(&empty, now));
        if tried.is_due(&failing, now) {
            tries.push(second);
            assert_eq!(tried.fail(&failing, now), tries.len() < 5);
        }
        second += 2;
    }
    assert_eq!(tries, [0, 10, 70, 670, 4270]);
    assert_eq!(tried.len(), 2);
}

#[test]
fn series_of_different_frames_have_different_keys_whatever_their_names() {
    let of = |telescope: &str, object: Option<&str>, filter: Option<&str>, camera: &str| {
        let [object, filter] = [object, filter].map(|name| name.map(str::to_owned));
        let base = frame(0);
        let purpose = contract::device::camera::Purpose { object, filter, ..base.purpose.clone() };
        series(telescope, &Frame { camera: camera.to_owned(), purpose, ..base })
    };
    let keys = [
        of("callisto", Some("M 1"), Some("V"), "a"),
        of("callisto", Some("M"), Some("1 V"), "a"),
        of("callisto", Some("M 1 V"), None, "a"),
        of("callisto", Some("M 1 V"), Some(""), "a"),
        of("callisto", Some("M\",\"1"), Some("V"), "a"),
        of("callisto", Some("M"), Some("1\",\"V"), "a"),
        of("callisto", None, Some("M 1 V"), "a"),
        of("callisto", Some("M 1"), None, "V a"),
        of("io", Some("M 1"), Some("V"), "a"),
    ];
    let different: std::collections::BTreeSet<&String> = keys.iter().collect();
    assert_eq!(different.len(), keys.len(), "{keys:?}");
}
