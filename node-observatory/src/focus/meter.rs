//! What a frame shows of the focus: one value, by the operator that the row asks for. Pure, and slow.

use contract::observatory::FocusValue;
use imaging::focus::{Image, Operator};
use imaging::hfd::{HfdSearch, measure_hfd};
use imaging::quality::Estimate;
use imaging::{Star, StarSearch};
use schedule::focus_meter::Meter;

use crate::frames::looked::Fetched;

/// Stars that are measured, the brightest.
const STARS: usize = 100;
/// Stars whose peaks show that an exposure is too long.
const BRIGHTEST: usize = 5;

/// What a frame shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Read {
    /// Its value, if it has one.
    pub value: Option<Estimate>,
    /// Why not.
    pub reason: Option<String>,
    /// Stars that the value was taken from.
    pub stars: Option<u32>,
    /// One of the brightest stars is saturated.
    pub saturated: bool,
    /// What else was computed.
    pub others: Vec<FocusValue>,
}

/// Measures a frame; `expected_px` is the size of the stars as far as it is known. Takes a while.
pub fn measure(meter: &Meter, fetched: &Fetched, expected_px: Option<f64>) -> Read {
    let Fetched { frame, plane, camera } = fetched;
    let pixels = match plane.frame(frame) {
        Ok(pixels) => pixels,
        Err(error) => return Read::nothing(error.to_string()),
    };
    let needs_stars = |operator: &&Operator| operator.needs_stars;
    let wants_stars = meter.looks_for_saturation || meter.operator.iter().chain(&meter.others).any(needs_stars);
    let search = StarSearch { fwhm_px: expected_px.map(|px| px as f32), ..StarSearch::default() };
    let stars = match wants_stars.then(|| imaging::measure(&pixels, camera, &search)).transpose() {
        Ok(measured) => measured.map(|measured| measured.stars).unwrap_or_default(),
        Err(error) => return Read::nothing(error.to_string()),
    };
    let places = places(&stars, meter.least_snr);
    let needs_image = meter.operator.is_some() || !meter.others.is_empty();
    let image = match needs_image.then(|| Image::without_sky(&pixels, camera)).transpose() {
        Ok(image) => image,
        Err(error) => return Read::nothing(error.to_string()),
    };
    let others = meter.others.iter().zip(image.iter().cycle()).filter_map(|(operator, image)| {
        let value = operator.measure(image, &places)?;
        Some(FocusValue { operator: operator.name.to_owned(), value })
    });
    let saturated = stars.iter().filter(|star| !star.flags.cosmic).take(BRIGHTEST).any(|star| star.flags.saturated);
    let others = others.collect();
    let found = match (meter.operator, &image) {
        (Some(operator), Some(image)) => by_operator(operator, image, &places),
        _ => {
            let search = HfdSearch { expected_px, most_stars: STARS, least_snr: meter.least_snr };
            let sized = measure_hfd(&pixels, camera, &search).map_err(|error| error.to_string());
            sized.map(|sized| (sized.hfd_px, u32::try_from(sized.stars.len()).ok()))
        }
    };
    match found {
        Ok((value, stars)) => Read { value: Some(value), reason: None, stars, saturated, others },
        Err(reason) => Read { saturated, others, ..Read::nothing(reason) },
    }
}

impl Read {
    /// Nothing, and why.
    pub fn nothing(reason: String) -> Self {
        Self { reason: Some(reason), ..Self::default() }
    }
}

/// Where whole, unsaturated stars are, the brightest first.
fn places(stars: &[Star], least_snr: f64) -> Vec<(f64, f64)> {
    let is_good = |star: &&Star| {
        let flags = star.flags;
        star.snr >= least_snr && !flags.saturated && !flags.cosmic && !flags.edge
    };
    stars.iter().filter(is_good).take(STARS).map(|star| (star.x_px, star.y_px)).collect()
}

/// The operator's value. For sizes of stars, the two halves of the stars give the error.
fn by_operator(operator: &Operator, image: &Image, places: &[(f64, f64)]) -> Result<(Estimate, Option<u32>), String> {
    let none = || format!("{} has no value for this frame; {} stars", operator.name, places.len());
    if !operator.needs_stars {
        let value = operator.measure(image, &[]).ok_or_else(none)?;
        return Ok((Estimate { value, error: f64::NAN }, None));
    }
    if places.is_empty() {
        return Err("no star is bright enough, whole and unsaturated".to_owned());
    }
    let value = operator.measure(image, places).ok_or_else(none)?;
    let half = |odd: usize| -> Vec<(f64, f64)> { places.iter().skip(odd).step_by(2).copied().collect() };
    let halves = operator.measure(image, &half(0)).zip(operator.measure(image, &half(1)));
    // One star shows no scatter: its size is then as sure as seeing lets it be.
    let error = halves.map_or(0.05 * value.abs(), |(a, b)| 0.5 * (a - b).abs());
    Ok((Estimate { value, error }, u32::try_from(places.len()).ok()))
}

/// Several frames at one position as one value: their mean, with the scatter or their own errors, whichever is larger.
pub fn together(values: &[Estimate]) -> Option<Estimate> {
    let count = values.len() as f64;
    if values.is_empty() {
        return None;
    }
    let value = values.iter().map(|one| one.value).sum::<f64>() / count;
    let own = values.iter().map(|one| one.error.powi(2)).sum::<f64>().sqrt() / count;
    let squares: f64 = values.iter().map(|one| (one.value - value).powi(2)).sum();
    let scatter = if values.len() > 1 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
    Some(Estimate { value, error: own.max(scatter) })
}

#[cfg(test)]
mod tests {
    use contract::device::camera::Frame;
    use imaging::Camera;
    use imaging::focus::Better;

    use super::*;
    use crate::frames::measure::Plane;
    use crate::frames::tests::{drawn, frame};

    fn measured(meter: &Meter, frame: &Frame, pixels: Vec<u16>) -> Read {
        let (frame, plane) = (frame.clone(), Plane::Counts(pixels));
        measure(meter, &Fetched { frame, plane, camera: Camera::default() }, None)
    }

    fn read(operator: Option<&str>, others: &[&str], fwhm_px: f64, saturated: bool) -> Read {
        let mut pixels = drawn(400, 300, fwhm_px, 40);
        if saturated {
            pixels.iter_mut().for_each(|pixel| *pixel = if *pixel > 2500 { 65_535 } else { *pixel });
        }
        let named = |name: &str| Operator::named(name).unwrap();
        let meter = Meter {
            operator: operator.map(named),
            least_snr: 10.0,
            others: others.iter().map(|name| named(name)).collect(),
            looks_for_saturation: true,
        };
        let mut light = Frame { width_px: 400, height_px: 300, ..frame("f") };
        light.purpose.image_type = "Light Frame".to_owned();
        measured(&meter, &light, pixels)
    }

    #[test]
    fn the_half_flux_diameter_of_gaussians_is_their_width() {
        for fwhm_px in [3.0, 6.0] {
            let read = read(None, &["tenengrad"], fwhm_px, false);
            let hfd = read.value.unwrap();
            assert!((hfd.value / fwhm_px - 1.0).abs() < 0.05 && hfd.error < 0.1, "{fwhm_px}: {hfd:?}");
            assert!(read.stars > Some(30) && !read.saturated, "{read:?}");
            assert!(read.others.len() == 1 && read.others[0].operator == "tenengrad", "{read:?}");
        }
    }

    #[test]
    fn the_predecessors_operators_distinguish_sharp_from_blurred() {
        for (name, better) in
            [("hfr", Better::Smaller), ("gauss", Better::Smaller), ("relative_gradient", Better::Larger)]
        {
            let value = |fwhm_px| read(Some(name), &[], fwhm_px, false).value.unwrap().value;
            let (sharp, blurred) = (value(2.5), value(5.0));
            assert_eq!(sharp < blurred, better == Better::Smaller, "{name}: {sharp} {blurred}");
        }
    }

    #[test]
    fn saturated_stars_are_reported_and_an_empty_frame_gives_the_reason_for_no_value() {
        assert!(read(None, &[], 3.0, true).saturated);
        let meter = Meter { operator: None, least_snr: 10.0, others: vec![], looks_for_saturation: false };
        let mut light = Frame { width_px: 100, height_px: 80, ..frame("f") };
        light.purpose.image_type = "Light Frame".to_owned();
        let empty = measured(&meter, &light, drawn(100, 80, 3.0, 0));
        assert!(empty.value.is_none() && empty.reason.unwrap().contains("none can be sized"));
        let short = measured(&meter, &light, vec![7; 10]);
        assert!(short.value.is_none() && short.reason.is_some());
    }

    #[test]
    fn several_frames_are_one_value_whose_error_knows_their_scatter() {
        let one = |value| Estimate { value, error: 0.1 };
        assert_eq!(together(&[]), None);
        assert_eq!(together(&[one(3.0)]), Some(one(3.0)));
        let alike = together(&[one(3.0), one(3.0), one(3.0), one(3.0)]).unwrap();
        assert!((alike.value - 3.0).abs() < 1e-12 && (alike.error - 0.05).abs() < 1e-12);
        let apart = together(&[one(2.0), one(4.0)]).unwrap();
        assert!((apart.value - 3.0).abs() < 1e-12 && (apart.error - 1.0).abs() < 1e-12, "{apart:?}");
    }
}
