//! The flux of a star in a circle around it, above the sky of a ring around that.

use imaging::Frame;

/// Radius of the circle in units of the stars' width, and its least value, px.
const RADIUS_FWHM: f64 = 1.7;
const LEAST_RADIUS_PX: f64 = 3.0;
/// The ring begins so many radii away and is so many radii wide.
const RING: (f64, f64) = (2.0, 1.5);
/// The place that a solution gives is off by less than this share of the radius.
const MOST_OFF: f64 = 0.8;
/// From the middle of a pixel to its corner, px, and a little more.
const HALF_DIAGONAL_PX: f64 = 0.7072;
/// A pixel on the edge of the circle is divided into so many parts along each axis. Where it counts by the share that is inside alone, a star
/// of 3 px that moves by a part of a pixel changes by 0.0013, a tenth of a transit; so by 0.0003.
const PARTS: u32 = 10;
/// A sky needs so many pixels.
const FEWEST_SKY: usize = 30;

/// A star that was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aperture {
    /// Column of the star, px.
    pub x_px: f64,
    /// Row of the star, px.
    pub y_px: f64,
    /// Flux above the sky, ADU.
    pub flux_adu: f64,
    /// Its standard error from the photons of star and sky, ADU.
    pub error_adu: f64,
    /// A pixel is at or above the limit.
    pub is_saturated: bool,
}

/// Radius of the circle for stars of a width, px.
pub fn circle_px(fwhm_px: f64) -> f64 {
    (RADIUS_FWHM * fwhm_px).max(LEAST_RADIUS_PX)
}

/// So far from the edge of the frame a star can be measured, px.
pub fn margin_px(fwhm_px: f64) -> f64 {
    circle_px(fwhm_px) * (RING.0 + RING.1 + MOST_OFF) + 1.0
}

/// Measures the star at a place; absent where circle and ring are not within the frame, or there is no star.
pub fn measure(frame: &Frame, place: (f64, f64), fwhm_px: f64, gain: f64, limit_adu: f64) -> Option<Aperture> {
    let (radius, margin) = (circle_px(fwhm_px), margin_px(fwhm_px));
    let inside = |at: f64, size: usize| at >= margin && at + margin <= size as f64 - 1.0;
    if !(inside(place.0, frame.width()) && inside(place.1, frame.height())) {
        return None;
    }
    let sky = sky(frame, place, radius)?;
    let mut at = place;
    for _ in 0..3 {
        at = centroid(frame, at, radius, sky.level)?;
        if (at.0 - place.0).hypot(at.1 - place.1) > MOST_OFF * radius {
            return None;
        }
    }
    let (mut flux, mut area, mut is_saturated) = (0.0, 0.0, false);
    each(at, radius + 1.0, |x, y, _| {
        let (share, moment) = overlap((x as f64 - at.0, y as f64 - at.1), radius);
        if share > 0.0 {
            let value = |x: usize, y: usize| f64::from(frame.value(x, y));
            // The part that is inside is brighter than the rest of its pixel, by the slope of the light there.
            let slope = ((value(x + 1, y) - value(x - 1, y)) / 2.0, (value(x, y + 1) - value(x, y - 1)) / 2.0);
            flux += share * (value(x, y) - sky.level) + moment.0 * slope.0 + moment.1 * slope.1;
            area += share;
            is_saturated |= value(x, y) >= limit_adu;
        }
    });
    let variance = flux.max(0.0) / gain + area * sky.noise.powi(2) * (1.0 + area / sky.pixels);
    let measured = Aperture { x_px: at.0, y_px: at.1, flux_adu: flux, error_adu: variance.sqrt(), is_saturated };
    (flux.is_finite() && variance > 0.0).then_some(measured)
}

/// The share of a pixel that is inside of a circle, and the first moment of that share about the pixel's middle, px; `off` is from the
/// circle's middle to the pixel's.
fn overlap(off: (f64, f64), radius: f64) -> (f64, (f64, f64)) {
    let distance = off.0.hypot(off.1);
    if (distance - radius).abs() > HALF_DIAGONAL_PX {
        return (f64::from(distance < radius), (0.0, 0.0));
    }
    let part = |index: u32| (f64::from(index) + 0.5) / f64::from(PARTS) - 0.5;
    let inside = (0..PARTS).flat_map(|i| (0..PARTS).map(move |j| (part(i), part(j))));
    let inside = inside.filter(|(x, y)| (off.0 + x).hypot(off.1 + y) <= radius);
    let weight = 1.0 / f64::from(PARTS * PARTS);
    inside.fold((0.0, (0.0, 0.0)), |(share, moment), (x, y)| {
        (share + weight, (moment.0 + weight * x, moment.1 + weight * y))
    })
}

struct Sky {
    level: f64,
    noise: f64,
    pixels: f64,
}

/// The median of the ring; stars in it are more than three deviations above it and are left out.
fn sky(frame: &Frame, at: (f64, f64), radius: f64) -> Option<Sky> {
    let (inner, outer) = (RING.0 * radius, (RING.0 + RING.1) * radius);
    let mut values = Vec::new();
    each(at, outer, |x, y, distance| {
        let value = f64::from(frame.value(x, y));
        if (inner..=outer).contains(&distance) && value.is_finite() {
            values.push(value);
        }
    });
    for _ in 0..2 {
        values.sort_by(f64::total_cmp);
        let level = *values.get(values.len() / 2)?;
        let mut off: Vec<f64> = values.iter().map(|value| (value - level).abs()).collect();
        off.sort_by(f64::total_cmp);
        // Whole counts may agree in more than half of the pixels: half a count is their least scatter.
        let noise = (1.4826 * off.get(off.len() / 2)?).max(0.5);
        values.retain(|value| (value - level).abs() <= 3.0 * noise);
    }
    if values.len() < FEWEST_SKY {
        return None;
    }
    let pixels = values.len() as f64;
    // What is left has no outliers: its mean is a better level than the median of whole counts.
    let level = values.iter().sum::<f64>() / pixels;
    let noise = (values.iter().map(|value| (value - level).powi(2)).sum::<f64>() / pixels).sqrt();
    Some(Sky { level, noise, pixels })
}

/// The centre of the light in the circle.
fn centroid(frame: &Frame, at: (f64, f64), radius: f64, level: f64) -> Option<(f64, f64)> {
    let (mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
    each(at, radius, |x, y, distance| {
        let value = f64::from(frame.value(x, y)) - level;
        if distance <= radius && value > 0.0 {
            sum += value;
            x_sum += value * x as f64;
            y_sum += value * y as f64;
        }
    });
    (sum > 0.0).then(|| (x_sum / sum, y_sum / sum))
}

/// Hands over the pixels around a place with their distance from it, px.
fn each(at: (f64, f64), radius_px: f64, mut take: impl FnMut(usize, usize, f64)) {
    // `as` saturates; what is outside of the frame is NaN there.
    let range = |at: f64| ((at - radius_px).floor().max(0.0) as usize)..=((at + radius_px).ceil().max(0.0) as usize);
    for y in range(at.1) {
        for x in range(at.0) {
            take(x, y, (x as f64 - at.0).hypot(y as f64 - at.1));
        }
    }
}
