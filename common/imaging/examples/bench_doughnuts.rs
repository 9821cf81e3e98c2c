//! How long defocused frames take, for a comparison with SEP: `cargo run --release -p imaging --example bench_doughnuts`.
//!
//! Draws 2048 x 2048 px (u16) with 200 doughnuts of several outer diameters, a central obscuration of 0.4 of it, and
//! prints the best and the median of several runs in ms: the star list, and half-flux diameters. With a folder as
//! argument it writes each frame there as raw little-endian counts (`D.u16`), so that another program can measure it.

mod timing;

use std::io::Write as _;

use imaging::hfd::{HfdSearch, measure_hfd};
use imaging::{Camera, Clean, Frame, Pixels, StarSearch, measure};

use timing::times_ms;

const RUNS: usize = 9;
const SIDE: usize = 2048;
const STARS: usize = 200;
const OBSCURATION: f64 = 0.4;

fn main() -> anyhow::Result<()> {
    println!("ms, best (median) of {RUNS} runs; {STARS} doughnuts on {SIDE} x {SIDE} px");
    println!(
        "outer px   clean          stars: unknown width           known width             HFD of the 100 brightest"
    );
    for diameter_px in [20.0, 30.0, 40.0, 50.0] {
        let counts = draw(diameter_px);
        if let Some(folder) = std::env::args().nth(1) {
            let mut file = std::fs::File::create(format!("{folder}/{diameter_px}.u16"))?;
            file.write_all(&counts.iter().flat_map(|count| count.to_le_bytes()).collect::<Vec<u8>>())?;
        }
        let frame = Frame::new(SIDE, SIDE, Pixels::U16(&counts))?;
        let camera = Camera::default();
        let blind = StarSearch::default();
        let found = measure(&frame, &camera, &blind)?;
        let known = StarSearch { fwhm_px: found.quality.fwhm_px.map(|width| width.value as f32), ..blind };
        let sizes = HfdSearch { expected_px: Some(0.7 * diameter_px), ..HfdSearch::default() };
        let hfd = measure_hfd(&frame, &camera, &sizes)?;
        println!(
            "{diameter_px:8.0}   {:14} {:15} {:4} stars   {:15} {:4} stars   {:15} {:4} stars {:.2} px",
            time(|| Clean::new(&frame, &camera, known.fwhm_px).map(|clean| clean.saturated)),
            time(|| measure(&frame, &camera, &blind).map(|m| m.stars.len())),
            found.stars.len(),
            time(|| measure(&frame, &camera, &known).map(|m| m.stars.len())),
            measure(&frame, &camera, &known)?.stars.len(),
            time(|| measure_hfd(&frame, &camera, &sizes).map(|hfd| hfd.stars.len())),
            hfd.stars.len(),
            hfd.hfd_px.value
        );
    }
    Ok(())
}

fn time<T>(work: impl Fn() -> T) -> String {
    let times = times_ms(RUNS, work);
    format!("{:.0} ({:.0})", times[0], times[RUNS / 2])
}

/// Rings on a sky of 300 ADU, their edges blurred by a pixel of seeing; noise from a sum of uniform numbers.
fn draw(diameter_px: f64) -> Vec<u16> {
    let mut state = 88_172_645_463_325_252_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let mut light = vec![300.0; SIDE * SIDE];
    let (outer, inner) = (0.5 * diameter_px, 0.5 * OBSCURATION * diameter_px);
    let area = std::f64::consts::PI * (outer * outer - inner * inner);
    for _ in 0..STARS {
        let reach = outer as usize + 4;
        let mut place = || reach as f64 + uniform() * (SIDE - 2 * reach - 1) as f64;
        let (x, y) = (place(), place());
        let flux = 20_000.0 * uniform().max(0.01).powf(-0.8);
        for row in y as usize - reach..=y as usize + reach {
            for column in x as usize - reach..=x as usize + reach {
                let r = (column as f64 - x).hypot(row as f64 - y);
                let edge = |at: f64| 0.5 * (1.0 + ((at - r) / 1.2).tanh());
                light[row * SIDE + column] += flux / area * (edge(outer) - edge(inner)).max(0.0);
            }
        }
    }
    let mut normal = || (0..6).map(|_| uniform() - uniform()).sum::<f64>();
    let counts = light.iter().map(|light| 1000.0 + light + (light + 36.0).sqrt() * normal());
    counts.map(|value| value.round().clamp(0.0, 65_535.0) as u16).collect()
}
