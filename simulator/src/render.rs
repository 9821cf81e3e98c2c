//! From a plan to pixels: stars, sky, flat field, dark current, hot pixels, noise, saturation.

use std::sync::LazyLock;

use imaging::catalogue::CatalogueStar;
use sky::{Icrs, Tangent, separation};
use units::{Angle, Utc};

use crate::chance::Chance;
use crate::exposure::{Plan, Sample};
use crate::frame::Frame;
use crate::{catalogue, faint};

const MAX_ADU: f32 = 65_535.0;
/// Loss of light in the corners.
const VIGNETTING: f32 = 0.12;
/// Scatter of the pixels' sensitivities.
const RESPONSE: f32 = 0.006;
/// Wings of a star are drawn down to this, electrons per pixel.
const FAINTEST_E: f64 = 0.3;
/// ... but not further than this from its middle, pixels.
const WIDEST: f64 = 250.0;
/// Fields narrower than this get invented faint stars unless the options say otherwise.
const NARROW_DEG: f64 = 0.75;

/// Normal noise for all frames: drawing it anew for each pixel would take most of the time.
static NOISE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let mut chance = Chance::new(0, 0x004E_0153);
    (0..=NOISE_MASK).map(|_| chance.normal() as f32).collect()
});
const NOISE_MASK: usize = (1 << 20) - 1;

/// Draws a frame. Takes some 50 ms for four million pixels: not for an async thread.
pub fn render(plan: &Plan) -> Frame {
    let [width, height] = plan.size.map(|n| n as usize);
    let mut electrons = vec![0.0_f32; width * height];
    let stretches = if is_sharp(plan) { mean(&plan.samples).into_iter().collect() } else { plan.samples.clone() };
    if !stretches.is_empty() {
        let stars = visible(plan, &stretches);
        let mut began = plan.started;
        for stretch in &stretches {
            draw_stars(plan, stretch, began.plus_seconds(stretch.duration_s / 2.0), &stars, &mut electrons);
            began = began.plus_seconds(stretch.duration_s);
        }
    }
    let columns = develop(plan, &electrons);
    Frame {
        width: plan.size[0],
        height: plan.size[1],
        columns: columns.into(),
        started: plan.started,
        exposure_s: plan.exposure_s,
        number: plan.number,
    }
}

/// Where a star falls, in unbinned pixels of the whole sensor; None on the other half of the sky.
///
/// With position angle 0, north is +y and east is -x (+x where mirrored); the sensor's middle looks at the sample's
/// centre.
pub fn pixel_of(plan: &Plan, sample: &Sample, star: Icrs) -> Option<(f64, f64)> {
    let (xi, eta) = Tangent::new(sample.center).project(&star)?;
    let (sin, cos) = sample.position_angle.radians().sin_cos();
    let scale = plan.camera.pixel_scale().radians();
    let parity = if plan.camera.mirrored { -1.0 } else { 1.0 };
    let x = parity * (eta.radians() * sin - xi.radians() * cos) / scale;
    let y = (eta.radians() * cos + xi.radians() * sin) / scale;
    Some((f64::from(plan.camera.width - 1) / 2.0 + x, f64::from(plan.camera.height - 1) / 2.0 + y))
}

/// Whether the telescope moved so little during the exposure that one mean position does.
fn is_sharp(plan: &Plan) -> bool {
    let Some(first) = plan.samples.first() else { return true };
    let radius_px = f64::from(plan.camera.width.max(plan.camera.height)) / 2.0;
    plan.samples.iter().all(|sample| {
        let shift_px = separation(&first.center, &sample.center).degrees() / plan.camera.pixel_scale().degrees();
        let turned = (sample.position_angle - first.position_angle).wrapped_signed().radians().abs();
        shift_px + turned * radius_px < 0.3
    })
}

fn mean(samples: &[Sample]) -> Option<Sample> {
    let first = *samples.first()?;
    let total_s: f64 = samples.iter().map(|sample| sample.duration_s).sum();
    if total_s <= 0.0 {
        return Some(first);
    }
    let of = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(|s| s.duration_s * value(s)).sum::<f64>() / total_s;
    let ra = of(&|s| (s.center.ra - first.center.ra).wrapped_signed().degrees());
    Some(Sample {
        duration_s: total_s,
        center: Icrs {
            ra: (first.center.ra + Angle::from_degrees(ra)).wrapped_positive(),
            dec: Angle::from_degrees(of(&|s| s.center.dec.degrees())),
        },
        position_angle: first.position_angle,
        zero_e_per_s: of(&|s| s.zero_e_per_s),
        sky_e_per_s: of(&|s| s.sky_e_per_s),
        fwhm_arcsec: of(&|s| s.fwhm_arcsec),
    })
}

/// All stars that any stretch may show.
fn visible(plan: &Plan, stretches: &[Sample]) -> Vec<CatalogueStar> {
    let center = stretches[0].center;
    let diagonal_px = f64::from(plan.camera.width).hypot(f64::from(plan.camera.height));
    let field = plan.camera.pixel_scale() * (diagonal_px / 2.0 + 60.0);
    let wander = stretches.iter().map(|s| separation(&center, &s.center).degrees()).fold(0.0, f64::max);
    // A telescope that slews during an exposure shows streaks where it began; the rest of its way is not drawn.
    let radius = field + Angle::from_degrees(wander.min(2.0));
    let epoch_year = 2000.0 + (plan.started.jd() - 2_451_545.0) / 365.25;
    let mut found = catalogue::default().cone(center.ra, center.dec, radius, f64::INFINITY, epoch_year);
    let width = plan.camera.pixel_scale().degrees() * f64::from(plan.camera.width);
    if plan.camera.faint_stars.unwrap_or(width < NARROW_DEG) {
        found.extend(faint::cone(plan.seed, center, radius));
    }
    found
}

/// Draws the stars as they are at `middle`, the middle of the stretch.
fn draw_stars(plan: &Plan, stretch: &Sample, middle: Utc, stars: &[CatalogueStar], electrons: &mut [f32]) {
    let bin = f64::from(plan.binning);
    // A Moffat profile of exponent 3: FWHM = 2 alpha sqrt(2^(1/3) - 1).
    let alpha = stretch.fwhm_arcsec / plan.camera.pixel_scale().arcseconds() / bin / 1.019_65;
    for star in stars {
        let place = Icrs { ra: star.ra, dec: star.dec };
        let mag = star.mag + plan.transits.iter().map(|transit| transit.dims_mag(place, middle)).sum::<f64>();
        let total_e = stretch.zero_e_per_s * stretch.duration_s * 10.0_f64.powf(-0.4 * mag);
        let Some((x, y)) = pixel_of(plan, stretch, place) else { continue };
        let x = (x + 0.5) / bin - 0.5 - f64::from(plan.start[0]);
        let y = (y + 0.5) / bin - 0.5 - f64::from(plan.start[1]);
        if total_e > 0.0 {
            draw_star(plan.size, [x, y], total_e, alpha, electrons);
        }
    }
}

fn draw_star(size: [u32; 2], [x, y]: [f64; 2], total_e: f64, alpha: f64, electrons: &mut [f32]) {
    let peak = total_e * 2.0 / (std::f64::consts::PI * alpha * alpha);
    let reach = (alpha * ((peak / FAINTEST_E).cbrt() - 1.0).max(0.0).sqrt()).clamp(2.0, WIDEST);
    let range = |at: f64, n: u32| {
        let low = (at - reach).ceil().max(0.0);
        let high = (at + reach).floor().min(f64::from(n) - 1.0);
        (low <= high).then_some(low as usize..=high as usize)
    };
    let (Some(columns), Some(rows)) = (range(x, size[0]), range(y, size[1])) else { return };
    let height = size[1] as usize;
    let inverse = (1.0 / (alpha * alpha)) as f32;
    let profile = |dx: f32, dy: f32| (1.0 + (dx * dx + dy * dy) * inverse).powi(-3);
    // A star narrower than its pixels must be summed over each of them, else its flux depends on where it stands.
    let fine: &[f32] = if alpha < 1.5 { &[-0.375, -0.125, 0.125, 0.375] } else { &[0.0] };
    let weight = peak as f32 / (fine.len() * fine.len()) as f32;
    for column in columns {
        let dx = (column as f64 - x) as f32;
        for row in rows.clone() {
            let dy = (row as f64 - y) as f32;
            let sum: f32 = fine.iter().flat_map(|i| fine.iter().map(move |j| profile(dx + i, dy + j))).sum();
            electrons[column * height + row] += weight * sum;
        }
    }
}

/// Sky, flat field, dark current, noise and the converter; counts as little-endian bytes, column by column.
fn develop(plan: &Plan, electrons: &[f32]) -> Vec<u8> {
    let [width, height] = plan.size.map(|n| n as usize);
    let noise = NOISE.as_slice();
    let mut chance = Chance::new(plan.seed, plan.started.micros().unsigned_abs() ^ plan.number);
    let bin = plan.binning as f32;
    let sky = plan.samples.iter().map(|s| s.sky_e_per_s * s.duration_s).sum::<f64>() as f32 * bin * bin;
    let dark = (plan.dark_e_per_s * plan.exposure_s) as f32 * bin * bin;
    let hot = hot_pixels(plan);
    let full = plan.camera.full_well_e as f32 * bin * bin;
    let read = (plan.camera.read_noise_e as f32).powi(2);
    let (gain, bias) = (1.0 / plan.electrons_per_adu as f32, plan.bias_adu as f32);
    let [sensor_x, sensor_y] = [plan.camera.width as f32 / bin, plan.camera.height as f32 / bin];
    let corner2 = (sensor_x * sensor_x + sensor_y * sensor_y) / 4.0;
    // The sensor's own pattern stays where it is on the sensor, whatever part of it is read.
    let pattern = Chance::new(plan.seed, 0x0F1A7).next() as usize;

    let mut bytes = vec![0_u8; 2 * width * height];
    for x in 0..width {
        let sensor_column = x + plan.start[0] as usize;
        let dx = sensor_column as f32 + 0.5 - sensor_x / 2.0;
        let draw = chance.next() as usize;
        let fixed = pattern.wrapping_add(sensor_column.wrapping_mul(7919)) + plan.start[1] as usize;
        let column = &electrons[x * height..(x + 1) * height];
        let out = &mut bytes[2 * x * height..2 * (x + 1) * height];
        for (y, (light, out)) in column.iter().zip(out.chunks_exact_mut(2)).enumerate() {
            let dy = (y + plan.start[1] as usize) as f32 + 0.5 - sensor_y / 2.0;
            let flat = (1.0 - VIGNETTING * (dx * dx + dy * dy) / corner2)
                * (1.0 + RESPONSE / bin * noise[(fixed + y) & NOISE_MASK]);
            let charge = ((light + sky) * flat + dark).max(0.0);
            let spread = (charge + read).sqrt() * noise[(draw.wrapping_add(y)) & NOISE_MASK];
            let counts = bias + (charge + spread).min(full) * gain;
            out.copy_from_slice(&(counts.clamp(0.0, MAX_ADU) as u16).to_le_bytes());
        }
    }
    for (x, y, rate) in hot {
        let at = 2 * (x * height + y);
        let counts = f32::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let charge = (rate * plan.exposure_s) as f32;
        let hotter = (counts + charge * gain).min(bias + full * gain).min(MAX_ADU) as u16;
        bytes[at..at + 2].copy_from_slice(&hotter.to_le_bytes());
    }
    bytes
}

/// The hot pixels within the part that is read: binned column and row of it, electrons per second.
fn hot_pixels(plan: &Plan) -> Vec<(usize, usize, f64)> {
    let camera = &plan.camera;
    let mut chance = Chance::new(plan.seed, 0x0407);
    let count = (camera.hot_per_million * f64::from(camera.width) * f64::from(camera.height) / 1e6) as usize;
    let all = (0..count).map(|_| {
        let x = (chance.even() * f64::from(camera.width)) as u32 / plan.binning;
        let y = (chance.even() * f64::from(camera.height)) as u32 / plan.binning;
        // 10 to 1000 times as dark as the rest, few of them the worst.
        (x, y, plan.dark_e_per_s * 10.0_f64.powf(1.0 + 2.0 * chance.even().powi(2)))
    });
    let [from_x, from_y] = plan.start;
    all.filter(|(x, y, _)| (from_x..from_x + plan.size[0]).contains(x) && (from_y..from_y + plan.size[1]).contains(y))
        .map(|(x, y, rate)| ((x - from_x) as usize, (y - from_y) as usize, rate))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::options::CameraOptions;

    fn plan(samples: Vec<Sample>) -> Plan {
        let camera = CameraOptions::default();
        Plan {
            device: crate::kind::Kind::Camera,
            number: 1,
            started: "2026-11-21T03:00:00Z".parse().unwrap_or(Utc::EPOCH),
            exposure_s: 10.0,
            samples,
            binning: 1,
            start: [0, 0],
            size: [camera.width, camera.height],
            electrons_per_adu: 1.3,
            bias_adu: 500.0,
            dark_e_per_s: 0.1,
            camera,
            seed: 1,
            transits: [].into(),
        }
    }

    fn sample() -> Sample {
        Sample {
            duration_s: 10.0,
            center: Icrs::from_degrees(83.8, -5.4),
            position_angle: Angle::from_degrees(0.0),
            zero_e_per_s: 3e8,
            sky_e_per_s: 5.0,
            fwhm_arcsec: 6.0,
        }
    }

    #[test]
    fn a_star_gives_the_same_light_wherever_in_its_pixel_it_stands() {
        for alpha in [0.6, 1.4, 1.6, 5.0] {
            for (x, y) in [(100.0, 100.0), (100.5, 100.0), (100.3, 99.8)] {
                let mut electrons = vec![0.0; 200 * 200];
                draw_star([200, 200], [x, y], 1e6, alpha, &mut electrons);
                let sum: f32 = electrons.iter().sum();
                assert!((sum - 1e6).abs() < 1.5e4, "{alpha} {x} {y}: {sum}");
            }
        }
    }

    #[test]
    fn north_is_up_and_east_is_left_and_the_rotator_turns_it() {
        let (plan, sample) = (plan(vec![]), sample());
        let north = Icrs { dec: sample.center.dec + plan.camera.pixel_scale() * 100.0, ..sample.center };
        let (x, y) = pixel_of(&plan, &sample, north).unwrap();
        assert!((x - 1023.5).abs() < 0.01 && (y - 1123.5).abs() < 0.01, "{x} {y}");
        let east = Icrs { ra: sample.center.ra + plan.camera.pixel_scale() * 100.0, ..sample.center };
        let (x, _) = pixel_of(&plan, &sample, east).unwrap();
        assert!(x < 930.0, "{x}");
        // With the y axis to the east, a star in the east is up.
        let turned = Sample { position_angle: Angle::from_degrees(90.0), ..sample };
        let (x, y) = pixel_of(&plan, &turned, east).unwrap();
        assert!((x - 1023.5).abs() < 0.1 && y > 1115.0, "{x} {y}");
    }

    #[test]
    fn a_moving_telescope_smears_its_stars() {
        let moved = Sample { center: Icrs::from_degrees(83.82, -5.4), ..sample() };
        assert!(is_sharp(&plan(vec![sample(), sample()])));
        assert!(!is_sharp(&plan(vec![sample(), moved])));
    }

    #[test]
    fn a_transit_takes_its_light_from_one_star_at_its_time() {
        // A star of the catalogue, in a narrow field without invented stars around it.
        let transit: crate::Transit =
            "ra=24.3543,dec=-45.6779,depth-mmag=500,mid=2026-11-21T03:00:00Z,duration-min=60,ingress-min=0"
                .parse()
                .unwrap();
        let light = |after_min: f64, transits: &[crate::Transit]| {
            let center = Icrs { ra: transit.place.ra + Angle::from_degrees(0.01), ..transit.place };
            let sample = Sample { center, ..sample() };
            let mut plan = plan(vec![sample]);
            (plan.transits, plan.started) = (transits.into(), plan.started.plus_seconds(60.0 * after_min));
            let frame = render(&plan);
            let (x, y) = pixel_of(&plan, &sample, transit.place).unwrap();
            let (x, y) = (x.round() as usize, y.round() as usize);
            let at = |x: usize, y: usize| {
                let first = 2 * (2048 * x + y);
                f64::from(u16::from_le_bytes([frame.columns[first], frame.columns[first + 1]]))
            };
            let square =
                |x: usize, y: usize| (x - 6..=x + 6).flat_map(|x| (y - 6..=y + 6).map(move |y| at(x, y))).sum::<f64>();
            square(x, y) - square(x + 60, y + 60)
        };
        let (full, low, after) = (light(0.0, &[]), light(0.0, &[transit]), light(40.0, &[transit]));
        assert!((low / full - 0.631).abs() < 0.01 && (after / full - 1.0).abs() < 0.01, "{full} {low} {after}");
    }

    #[test]
    fn a_frame_is_the_same_each_time_it_is_drawn() {
        let plan = plan(vec![sample()]);
        let first = render(&plan);
        let started = Instant::now();
        let second = render(&plan);
        println!("2048 x 2048 drawn in {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
        assert!(first.columns == second.columns && first.columns.len() == 2 * 2048 * 2048);
    }
}
