//! How long it takes to size stars: `cargo run -p imaging --example bench_hfd` (imaging has opt-level 3 in dev).
//!
//! Draws 2048 x 2048 px with 100 stars (u16) in and out of focus, and prints the best and the median of several runs in
//! ms: all of it (clean, find, size), and the sizes alone, for which 10 ms are asked.

mod timing;

use imaging::hfd::{HfdSearch, hfd_at, measure_hfd};
use imaging::{Camera, Clean, Frame, Pixels};

use timing::times_ms;

const RUNS: usize = 9;
const SIDE: usize = 2048;

fn main() -> anyhow::Result<()> {
    println!("ms, best (median) of {RUNS} runs; asked for: found and measured 80, of it measuring 10");
    println!("FWHM px   stars  HFD px  binned   all             measuring 100 stars");
    for fwhm_px in [3.0, 5.0, 8.0, 20.0] {
        let (pixels, places) = draw(fwhm_px);
        let frame = Frame::new(SIDE, SIDE, Pixels::U16(&pixels))?;
        let camera = Camera::default();
        let search = HfdSearch { expected_px: Some(fwhm_px), ..HfdSearch::default() };
        let found = measure_hfd(&frame, &camera, &search)?;
        let all = time(|| measure_hfd(&frame, &camera, &search).map(|hfd| hfd.stars.len()));
        let clean = Clean::new(&frame, &camera, Some(fwhm_px as f32))?;
        let sizes = time(|| hfd_at(&clean, 1.0, &places, fwhm_px).len());
        let (stars, hfd_px, binning) = (found.stars.len(), found.hfd_px.value, found.binning);
        println!("{fwhm_px:7.1} {stars:7} {hfd_px:7.2} {binning:7}   {all:15} {sizes}");
    }
    Ok(())
}

fn time<T>(work: impl Fn() -> T) -> String {
    let times = times_ms(RUNS, work);
    format!("{:.1} ({:.1})", times[0], times[RUNS / 2])
}

/// A sky of 300 ADU on a pedestal of 1000 with 10 x 10 Gaussian stars off the pixels' centres.
fn draw(fwhm_px: f64) -> (Vec<u16>, Vec<(f64, f64)>) {
    let sigma = fwhm_px / 2.354_82;
    let mut light = vec![0.0; SIDE * SIDE];
    let place = |n: i32| 110.0 + 200.0 * f64::from(n) + 0.37 * f64::from(n % 3);
    let places: Vec<(f64, f64)> = (0..100).map(|n| (place(n % 10), place(n / 10))).collect();
    let reach = (6.0 * sigma) as isize + 1;
    for (number, (x, y)) in places.iter().enumerate() {
        let peak = (20_000.0 + 1000.0 * number as f64) * (fwhm_px / 4.0) / (std::f64::consts::TAU * sigma * sigma);
        for row in *y as isize - reach..=*y as isize + reach {
            for column in *x as isize - reach..=*x as isize + reach {
                let squared = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                light[row as usize * SIDE + column as usize] += peak * (-0.5 * squared / (sigma * sigma)).exp();
            }
        }
    }
    // a plain congruential generator: twelve halves of a word make a normal number
    let mut state = 88_172_645_463_325_252_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let mut normal = || (0..6).map(|_| uniform() - uniform()).sum::<f64>();
    let pixels = light.iter().map(|light| 1000.0 + 300.0 + light + (light + 336.0).sqrt() * normal());
    (pixels.map(|value| value.round().clamp(0.0, 65_535.0) as u16).collect(), places)
}
