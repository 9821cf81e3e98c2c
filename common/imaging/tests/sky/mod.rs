//! Frames drawn from a truth that is known: stars on a sky, with noise and with a camera's faults.
#![allow(dead_code)] // each test file uses its part

use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

/// A star as it was drawn.
#[derive(Debug, Clone, Copy)]
pub struct Drawn {
    pub x: f64,
    pub y: f64,
    /// Whole flux, ADU.
    pub flux: f64,
}

/// The light of a point on the detector, whole flux 1.
#[derive(Debug, Clone, Copy)]
pub enum Psf {
    /// Gaussian of this sigma (px), integrated over each pixel.
    Gaussian(f64),
    /// Moffat of this FWHM (px) and beta, sampled on 5 x 5 points of each pixel.
    Moffat(f64, f64),
    /// Gaussian of this sigma drawn out along a line of (dx, dy) px.
    Trail(f64, f64, f64),
}

/// A trail: through (x, y), t px along its direction and d px across it.
#[derive(Debug, Clone, Copy)]
pub struct Trail {
    pub x: f64,
    pub y: f64,
    /// From +x towards +y, rad.
    pub angle: f64,
    /// ADU over the sky, on the middle.
    pub peak: f64,
    /// Of a Moffat profile with beta 3, px.
    pub fwhm: f64,
    /// First and last t, px.
    pub ends: (f64, f64),
    /// Length of a period, px, and the share of it that shines.
    pub period: Option<(f64, f64)>,
    /// How far it bends, d = bend t^2, 1/px.
    pub bend: f64,
}

impl Trail {
    /// From edge to edge.
    pub fn new(x: f64, y: f64, angle: f64, peak: f64, fwhm: f64) -> Self {
        Self { x, y, angle, peak, fwhm, ends: (f64::NEG_INFINITY, f64::INFINITY), period: None, bend: 0.0 }
    }

    /// How far a place lies along the trail and across it, px.
    pub fn along_and_across(&self, x: f64, y: f64) -> (f64, f64) {
        let (dx, dy) = (x - self.x, y - self.y);
        let (sin, cos) = self.angle.sin_cos();
        let t = dx * cos + dy * sin;
        (t, dy * cos - dx * sin - self.bend * t * t)
    }

    /// Distance of a place from the trail, px.
    pub fn distance(&self, x: f64, y: f64) -> f64 {
        let (dx, dy) = (x - self.x, y - self.y);
        let (sin, cos) = self.angle.sin_cos();
        let t = dx * cos + dy * sin;
        let beyond = (self.ends.0 - t).max(t - self.ends.1).max(0.0);
        (dy * cos - dx * sin - self.bend * t * t).hypot(beyond)
    }
}

pub struct Sky {
    pub width: usize,
    pub height: usize,
    /// Mean ADU per pixel, without noise.
    pub light: Vec<f64>,
    pub stars: Vec<Drawn>,
    pub rng: StdRng,
}

impl Sky {
    pub fn new(width: usize, height: usize, level: f64, seed: u64) -> Self {
        let rng = StdRng::seed_from_u64(seed);
        Self { width, height, light: vec![level; width * height], stars: Vec::new(), rng }
    }

    /// Adds what `level(x, y)` gives to the sky.
    pub fn add_light(&mut self, level: impl Fn(f64, f64) -> f64) {
        let width = self.width;
        self.light.iter_mut().enumerate().for_each(|(n, p)| *p += level((n % width) as f64, (n / width) as f64));
    }

    pub fn add_star(&mut self, psf: Psf, x: f64, y: f64, flux: f64) {
        self.stars.push(Drawn { x, y, flux });
        let reach = match psf {
            Psf::Gaussian(sigma) => 6.0 * sigma + 2.0,
            Psf::Moffat(fwhm, _) => 8.0 * fwhm + 2.0,
            Psf::Trail(sigma, dx, dy) => 6.0 * sigma + dx.abs().max(dy.abs()) + 2.0,
        };
        let range = |at: f64, length: usize| {
            (at - reach).ceil().clamp(0.0, length as f64) as usize
                ..(at + reach + 1.0).clamp(0.0, length as f64) as usize
        };
        for row in range(y, self.height) {
            for column in range(x, self.width) {
                self.light[row * self.width + column] += flux * psf.in_pixel(column as f64 - x, row as f64 - y);
            }
        }
    }

    /// Adds the trail of a satellite or an aircraft.
    pub fn add_trail(&mut self, trail: &Trail) {
        let (sin, cos) = trail.angle.sin_cos();
        let light = |x: f64, y: f64| {
            let (dx, dy) = (x - trail.x, y - trail.y);
            let (t, d) = (dx * cos + dy * sin, dy * cos - dx * sin - trail.bend * (dx * cos + dy * sin).powi(2));
            let shines = trail.period.is_none_or(|(period, share)| (t / period).rem_euclid(1.0) < share);
            let (first, last) = trail.ends;
            if !shines || d.abs() > 8.0 * trail.fwhm + 2.0 || t < first - 20.0 || t > last + 20.0 {
                return 0.0;
            }
            // the ends are as soft as a star
            let edge = |t: f64| 0.5 * (1.0 + error_function(t / (std::f64::consts::SQRT_2 * sigma(trail.fwhm))));
            let across = (1.0 + (2_f64.powf(1.0 / 3.0) - 1.0) * (2.0 * d / trail.fwhm).powi(2)).powi(-3);
            trail.peak * across * edge(t - first) * edge(last - t)
        };
        self.add_light(light);
    }

    /// Random places, at least `apart` px from one another and from the edge.
    pub fn places(&mut self, count: usize, apart: f64) -> Vec<(f64, f64)> {
        let mut places: Vec<(f64, f64)> = Vec::new();
        for _ in 0..count * 200 {
            if places.len() == count {
                break;
            }
            let x = self.rng.random_range(apart..self.width as f64 - apart);
            let y = self.rng.random_range(apart..self.height as f64 - apart);
            if places.iter().all(|(px, py)| (px - x).hypot(py - y) > apart) {
                places.push((x, y));
            }
        }
        places
    }

    /// Photon noise (1 e-/ADU, Gaussian) and read noise, ADU.
    pub fn noisy(&mut self, bias: f64, read_noise: f64) -> Vec<f32> {
        let rng = &mut self.rng;
        let noise = |light: &f64| {
            let sigma = (light.max(0.0) + read_noise * read_noise).sqrt();
            (bias + light + sigma * Distribution::<f64>::sample(&StandardNormal, rng)) as f32
        };
        self.light.iter().map(noise).collect()
    }

    /// The same as counts.
    pub fn counts(&mut self, bias: f64, read_noise: f64) -> Vec<u16> {
        self.noisy(bias, read_noise).iter().map(|value| value.round().clamp(0.0, 65_535.0) as u16).collect()
    }
}

impl Psf {
    fn in_pixel(self, dx: f64, dy: f64) -> f64 {
        match self {
            Self::Gaussian(sigma) => slice(dx, sigma) * slice(dy, sigma),
            Self::Trail(sigma, along_x, along_y) => {
                let steps = (2.0 * along_x.hypot(along_y)).max(40.0) as i32;
                let at = (0..steps).map(|n| (f64::from(n) + 0.5) / f64::from(steps) - 0.5);
                at.map(|t| slice(dx - t * along_x, sigma) * slice(dy - t * along_y, sigma)).sum::<f64>()
                    / f64::from(steps)
            }
            Self::Moffat(fwhm, beta) => {
                let squared = (0.5 * fwhm).powi(2) / (2_f64.powf(1.0 / beta) - 1.0);
                let fifth = |n: i32| f64::from(n - 2) / 5.0;
                let points = (0..25).map(|n| (dx + fifth(n % 5)).powi(2) + (dy + fifth(n / 5)).powi(2));
                let sum: f64 = points.map(|r2| (1.0 + r2 / squared).powf(-beta)).sum();
                sum / 25.0 * (beta - 1.0) / (std::f64::consts::PI * squared)
            }
        }
    }
}

/// Share of a Gaussian in a pixel-wide slice at distance `d`.
fn slice(d: f64, sigma: f64) -> f64 {
    let scale = std::f64::consts::SQRT_2 * sigma;
    0.5 * (error_function((d + 0.5) / scale) - error_function((d - 0.5) / scale))
}

/// Abramowitz and Stegun 7.1.26, to 1.5e-7.
fn error_function(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs());
    let poly =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    (1.0 - poly * (-x * x).exp()).copysign(x)
}

/// Sigma of the pixel-integrated Gaussian of the given FWHM, as it looks in the image: the pixel adds 1/12 px^2.
pub fn seen_fwhm(fwhm: f64) -> f64 {
    (fwhm.powi(2) + 2.354_82_f64.powi(2) / 12.0).sqrt()
}

pub fn sigma(fwhm: f64) -> f64 {
    fwhm / 2.354_82
}

/// Replaces a share of the pixels by hot ones, from 20 sigma to full scale, evenly in the logarithm.
pub fn make_hot(pixels: &mut [u16], share: f64, noise: f64, rng: &mut StdRng) {
    for _ in 0..(share * pixels.len() as f64) as usize {
        let excess = (20.0 * noise) * (60_000.0 / (20.0 * noise)).powf(rng.random_range(0.0..1.0));
        let at = rng.random_range(0..pixels.len());
        pixels[at] = (f64::from(pixels[at]) + excess).min(65_535.0) as u16;
    }
}

/// Mean and standard deviation.
pub fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
    (mean, variance.sqrt())
}
