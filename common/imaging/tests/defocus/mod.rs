//! Stars in and out of focus: discs and rings, smoothed by seeing.
#![allow(dead_code)] // each test file uses its part

use std::sync::OnceLock;

use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

/// Distance of the radii in the table, px.
const STEP: f64 = 0.1;

/// A ring (or a disc) under a Gaussian, as a table of light over radius; whole flux 1.
pub struct Blur {
    table: Vec<f64>,
}

impl Blur {
    /// Seeing of this FWHM (px), a disc of this diameter (px), of which the inner share (diameter) is dark.
    pub fn new(seeing_px: f64, diameter_px: f64, obstruction: f64) -> Self {
        // the pixel's own width is drawn as part of the seeing
        let sigma = (seeing_px / 2.354_82).hypot((1.0_f64 / 12.0).sqrt());
        let (outer, inner) = (0.5 * diameter_px, 0.5 * diameter_px * obstruction);
        let count = (((outer - inner) / (0.4 * sigma)) as usize).max(24);
        let width = (outer - inner) / count as f64;
        let radii: Vec<f64> = (0..count).map(|n| inner + width * (n as f64 + 0.5)).collect();
        let whole: f64 = radii.iter().sum();
        let light = |r: f64| {
            let parts = radii.iter().map(|rho| {
                let share = if whole > 0.0 { rho / whole } else { 1.0 / count as f64 };
                share * (-0.5 * ((r - rho) / sigma).powi(2)).exp() * scaled_bessel(r * rho / (sigma * sigma))
            });
            parts.sum::<f64>() / (std::f64::consts::TAU * sigma * sigma)
        };
        let length = ((outer + 6.0 * sigma) / STEP) as usize + 2;
        Self { table: (0..length).map(|n| light(STEP * n as f64)).collect() }
    }

    /// True half-flux diameter, px.
    pub fn hfd_px(&self) -> f64 {
        let mut inside = 0.0;
        for n in 1..self.table.len() {
            let (r0, r1) = (STEP * (n - 1) as f64, STEP * n as f64);
            let more = std::f64::consts::PI * (r0 * self.table[n - 1] + r1 * self.table[n]) * STEP;
            if inside + more >= 0.5 {
                return 2.0 * (r0 + STEP * (0.5 - inside) / more);
            }
            inside += more;
        }
        f64::NAN
    }

    /// Adds a star to an image of mean light.
    pub fn draw(&self, light: &mut [f64], width: usize, (x, y): (f64, f64), flux: f64) {
        let height = light.len() / width;
        let reach = STEP * (self.table.len() - 2) as f64;
        let range = |at: f64, length: usize| {
            let bound = |at: f64| at.clamp(0.0, length as f64) as usize;
            bound((at - reach).ceil())..bound(at + reach + 1.0)
        };
        for row in range(y, height) {
            for column in range(x, width) {
                let at = (column as f64 - x).hypot(row as f64 - y) / STEP;
                let n = at as usize;
                if n + 1 < self.table.len() {
                    let part = at - n as f64;
                    light[row * width + column] += flux * ((1.0 - part) * self.table[n] + part * self.table[n + 1]);
                }
            }
        }
    }
}

/// exp(-x) I0(x), Abramowitz and Stegun 9.8.1 and 9.8.2.
fn scaled_bessel(x: f64) -> f64 {
    let sum = |t: f64, terms: &[f64]| terms.iter().rev().fold(0.0, |sum, term| sum * t + term);
    if x < 3.75 {
        let t = (x / 3.75).powi(2);
        let terms = [1.0, 3.515_622_9, 3.089_942_4, 1.206_749_2, 0.265_973_2, 0.036_076_8, 0.004_581_3];
        (-x).exp() * sum(t, &terms)
    } else {
        let terms = [
            0.398_942_28,
            0.013_285_92,
            0.002_253_19,
            -0.001_575_65,
            0.009_162_81,
            -0.020_577_06,
            0.026_355_37,
            -0.016_476_33,
            0.003_923_77,
        ];
        sum(3.75 / x, &terms) / x.sqrt()
    }
}

/// Counts with photon noise (1 e-/ADU) and read noise on a pedestal. The noise comes from a large table, begun
/// anywhere and read with a random odd stride: drawing it anew would take most of a test's time.
pub fn counts(light: &[f64], pedestal: f64, read_noise: f64, rng: &mut StdRng) -> Vec<u16> {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    const LENGTH: usize = 1 << 20;
    let table = TABLE.get_or_init(|| {
        let mut rng = StdRng::seed_from_u64(20_261_121);
        (0..LENGTH).map(|_| Distribution::<f64>::sample(&StandardNormal, &mut rng) as f32).collect()
    });
    let (mut at, stride) = (rng.random_range(0..LENGTH), 2 * rng.random_range(0..LENGTH / 2) + 1);
    let mut value = |light: &f64| {
        at = (at + stride) % LENGTH;
        let noise = (light + read_noise * read_noise).sqrt() * f64::from(table[at]);
        (pedestal + light + noise).round().clamp(0.0, 65_535.0) as u16
    };
    light.iter().map(&mut value).collect()
}

/// Places at least `apart` px from each other.
pub fn places(count: usize, width: f64, edge: f64, apart: f64, rng: &mut StdRng) -> Vec<(f64, f64)> {
    let mut places: Vec<(f64, f64)> = Vec::new();
    for _ in 0..count * 100 {
        let place = (rng.random_range(edge..width - edge), rng.random_range(edge..width - edge));
        if places.len() < count && places.iter().all(|(x, y)| (x - place.0).hypot(y - place.1) > apart) {
            places.push(place);
        }
    }
    places
}
