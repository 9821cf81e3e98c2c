//! Level and noise against what was drawn.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal};

use super::*;

/// A sky with a gradient and white noise.
fn sky(width: usize, height: usize, sigma: f32, seed: u64, level: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    let mut rng = StdRng::seed_from_u64(seed);
    let noise = Normal::new(0.0, sigma).unwrap();
    (0..width * height).map(|n| level((n % width) as f32, (n / width) as f32) + noise.sample(&mut rng)).collect()
}

/// Mean and greatest difference of the level from what was drawn, in sigma.
fn difference(
    background: &Background,
    width: usize,
    height: usize,
    sigma: f32,
    level: impl Fn(f32, f32) -> f32,
) -> (f32, f32) {
    let (mut sum, mut greatest) = (0.0, 0.0_f32);
    let mut row = vec![0.0; width];
    for y in 0..height {
        background.level.row(y, &mut row);
        for (x, found) in row.iter().enumerate() {
            let apart = (found - level(x as f32, y as f32)) / sigma;
            sum += apart;
            greatest = greatest.max(apart.abs());
        }
    }
    (sum / (width * height) as f32, greatest)
}

#[test]
fn level_and_noise_follow_a_steep_gradient_to_the_edges() {
    for (width, height) in [(1024, 1024), (700, 333), (2048, 1600)] {
        let level = |x: f32, y: f32| 300.0 + 0.25 * x - 0.1 * y + 5e-5 * x * y;
        let image = sky(width, height, 12.0, 1, level);
        let background = Background::measure(&image, width, 0.0, f32::INFINITY, None).unwrap();
        let (bias, greatest) = difference(&background, width, height, 12.0, level);
        assert!(bias.abs() < 0.02 && greatest < 0.35, "{width} x {height}: bias {bias}, greatest {greatest} sigma");
        // a gradient of up to 20 ADU across a cell widens its histogram
        let noise = background.noise.median() / 12.0;
        assert!((0.97..1.25).contains(&noise), "{noise}");
    }
}

#[test]
fn whole_counts_of_a_quiet_camera_do_not_round_the_level() {
    for fraction in [0.0, 0.2, 0.5, 0.8] {
        let image: Vec<f32> = sky(512, 512, 1.3, 2, |_, _| 300.0 + fraction).iter().map(|v| v.round()).collect();
        let background = Background::measure(&image, 512, 1.0, 60_000.0, None).unwrap();
        let (level, noise) = (background.level.median() - 300.0 - fraction, background.noise.median());
        assert!(level.abs() < 0.03, "level is off by {level} ADU at {fraction}");
        assert!((noise - 1.33).abs() < 0.07, "{noise}");
    }
}

#[test]
fn stars_defects_and_missing_pixels_do_not_move_the_sky() {
    let mut image = sky(640, 640, 5.0, 3, |_, _| 1000.0);
    let mut rng = StdRng::seed_from_u64(4);
    for _ in 0..640 * 64 {
        image[rng.random_range(0..640 * 640)] = rng.random_range(1100.0..60_000.0);
    }
    for y in 100..200 {
        image[y * 640 + 300..y * 640 + 420].fill(f32::NAN);
        image[y * 640 + 20..y * 640 + 120].fill(65_535.0);
    }
    let background = Background::measure(&image, 640, 0.0, 60_000.0, None).unwrap();
    let (bias, greatest) = difference(&background, 640, 640, 5.0, |_, _| 1000.0);
    // one pixel in ten lies above: the median of what is kept moves by little
    assert!(bias.abs() < 0.1 && greatest < 0.6, "{bias} {greatest}");
    assert!((background.noise.median() / 5.0 - 1.0).abs() < 0.08);
}

#[test]
fn frames_without_sky_or_without_noise_have_an_answer() {
    let measure = |image: &[f32], width| Background::measure(image, width, 1.0, 60_000.0, None);
    assert!(measure(&[f32::NAN; 64], 8).is_none());
    assert!(measure(&[65_535.0; 4096], 64).is_none());
    let one = measure(&[7.0], 1).unwrap();
    assert!((one.level.at(0, 0) - 7.0).abs() < 0.5 && one.noise.at(0, 0) > 0.0);
    let flat = measure(&[500.0; 100 * 3], 100).unwrap();
    assert!((flat.level.at(99, 2) - 500.0).abs() < 0.01 && flat.noise.at(50, 1) > 0.0);
    let float = Background::measure(&[0.0; 50], 50, 0.0, f32::INFINITY, None).unwrap();
    assert!(float.level.at(3, 0).abs() < 1e-20 && float.noise.at(3, 0) > 0.0);
}

#[test]
fn a_camera_that_cuts_off_the_lower_half_of_the_noise_is_measured_by_mean_and_spread() {
    let image: Vec<f32> = sky(512, 512, 35.0, 6, |_, _| 0.0).iter().map(|v| v.max(0.0).round()).collect();
    let background = Background::measure(&image, 512, 1.0, 60_000.0, None).unwrap();
    // half of a Gaussian at zero: mean sigma / sqrt(2 pi), standard deviation 0.584 sigma
    let (level, noise) = (background.level.median() / 35.0, background.noise.median() / 35.0);
    assert!((level - 0.4).abs() < 0.03 && (noise - 0.584).abs() < 0.04, "{level} {noise}");
}
