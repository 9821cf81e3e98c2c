//! How long a guide measurement takes, and how good it is: `cargo run -p imaging --example bench_guide`.
//!
//! Draws 2048 x 2048 frames with 50 stars of signal-to-noise 50 and prints best and median time (and processor time) of measuring
//! them against their reference, from raw counts to shift with covariance, and the error against the truth. Asked for:
//! 30 ms and 0.02 px. Noise from a sum of uniform numbers is Gaussian enough here.

use std::time::Instant;

use imaging::guide::{Calibration, Exposure, GuideSettings, Guider, Reference};
use imaging::{Camera, Frame, Pixels, StarSearch, measure};

const SIDE: usize = 2048;
const FWHM_PX: f64 = 4.0;
const RUNS: usize = 20;

fn main() -> anyhow::Result<()> {
    let first = draw(0.0, 0.0, 1);
    let camera = Camera::default();
    let frame = Frame::new(SIDE, SIDE, Pixels::U16(&first))?;
    let stars = measure(&frame, &camera, &StarSearch { fwhm_px: Some(4.1), ..StarSearch::default() })?.stars;
    let mut reference = Reference::from_lists(&[stars], SIDE, SIDE)?;
    let calibration = Calibration::from_wcs([[-1e-4, 0.0], [0.0, 1e-4]], [2e-3, 2e-3], None)?;
    let mut guider = Guider::new(GuideSettings::default(), &calibration, 0.0)?;
    let (mut times, mut decisions, mut squares, mut processor) = (Vec::new(), Vec::new(), 0.0, 0.0);
    for n in 0..RUNS {
        let (dx, dy) = (0.13 * n as f64 - 1.0, 0.7 - 0.11 * n as f64);
        let counts = draw(dx, dy, 2 + n as u64);
        let frame = Frame::new(SIDE, SIDE, Pixels::U16(&counts))?;
        let (started, before) = (Instant::now(), processor_ms());
        let seen = reference.measure(&frame, &camera, [0.0, 0.0])?;
        times.push(started.elapsed().as_secs_f64() * 1e3);
        processor += processor_ms() - before;
        squares += (seen.shift.dx_px - dx).powi(2) + (seen.shift.dy_px - dy).powi(2);
        let started = Instant::now();
        let decision = guider.step(Exposure { mid_s: 60.0 * n as f64, length_s: 50.0 }, Ok(&seen.shift));
        std::hint::black_box(decision);
        decisions.push(started.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    decisions.sort_by(f64::total_cmp);
    println!(
        "guide measurement, {SIDE} x {SIDE}, {} stars: {:.1} ms (median {:.1}), processor {:.1} ms; asked for: 30 ms",
        reference.stars().len(),
        times[0],
        times[RUNS / 2],
        processor / RUNS as f64
    );
    println!("its error: {:.4} px per axis; asked for: 0.02 px", (squares / (2 * RUNS) as f64).sqrt());
    println!("the guider's decision: {:.2} ms (median {:.2})", decisions[0], decisions[RUNS / 2]);
    Ok(())
}

/// Time that all threads of this process have run, ms, in steps of 10; 0 where the system does not report it.
fn processor_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // user and system time are fields 14 and 15; the name before them may hold spaces
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() * 10.0
}

fn draw(dx: f64, dy: f64, seed: u64) -> Vec<u16> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    };
    // variance of a sum of four uniform numbers: 1/3
    let mut light: Vec<f64> =
        (0..SIDE * SIDE).map(|_| 600.0 + 18.3 * 3_f64.sqrt() * ((0..4).map(|_| next()).sum::<f64>() - 2.0)).collect();
    let sigma = FWHM_PX / 2.354_82;
    for n in 0..50 {
        let (x, y) = (150.0 + 250.0 * f64::from(n % 8) + dx, 150.0 + 270.0 * f64::from(n / 8) + dy);
        for row in y as usize - 9..y as usize + 11 {
            for column in x as usize - 9..x as usize + 11 {
                let squared = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
                light[row * SIDE + column] += 430.0 * (-0.5 * squared / (sigma * sigma)).exp();
            }
        }
    }
    light.iter().map(|value| value.clamp(0.0, 65_535.0) as u16).collect()
}
