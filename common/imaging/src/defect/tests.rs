//! Defects and stars drawn as grids of numbers.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::background::Background;

const SIGMA: f32 = 5.0;

fn noise(width: usize, height: usize, seed: u64) -> Vec<f32> {
    let mut rng = StdRng::seed_from_u64(seed);
    (0..width * height).map(|_| SIGMA * Distribution::<f32>::sample(&StandardNormal, &mut rng)).collect()
}

fn noise_map(width: usize, height: usize) -> Mesh {
    Background::measure(&noise(width, height, 99), width, 0.0, f32::INFINITY, None).unwrap().noise
}

/// A Gaussian sampled at pixel centres, the narrowest that a star of that width can be.
fn add_star(image: &mut [f32], width: usize, x: f32, y: f32, fwhm: f32, peak: f32) {
    for (n, pixel) in image.iter_mut().enumerate() {
        let squared = ((n % width) as f32 - x).powi(2) + ((n / width) as f32 - y).powi(2);
        *pixel += peak * (-4.0 * std::f32::consts::LN_2 * squared / (fwhm * fwhm)).exp();
    }
}

#[test]
fn no_star_is_a_defect_wherever_it_falls_on_the_pixels() {
    let map = noise_map(64, 64);
    for fwhm in [1.5, 1.8, 2.5, 4.0, 8.0] {
        let mut lost = 0;
        for n in 0..400_u64 {
            let mut image = noise(64, 64, n);
            let (x, y) = (20.0 + (n % 20) as f32 / 20.0, 30.0 + (n / 20) as f32 / 20.0);
            let peak = SIGMA * [8.0, 30.0, 300.0, 9000.0][n as usize % 4];
            add_star(&mut image, 64, x, y, fwhm, peak);
            lost += find(&image, 64, &map, fwhm).len();
        }
        assert!(lost <= 4, "{lost} pixels of 400 stars of {fwhm} px");
    }
}

#[test]
fn hot_and_dead_pixels_pairs_and_columns_are_found() {
    let map = noise_map(64, 64);
    let mut image = noise(64, 64, 7);
    let mut drawn = vec![(10, 10), (30, 5), (31, 5), (50, 20), (50, 21), (0, 40), (12, 50)];
    drawn.extend((0..64).map(|y| (40, y)));
    for (x, y) in &drawn {
        image[y * 64 + x] = 400.0;
    }
    image[50 * 64 + 12] = -150.0;
    let mut expected: Vec<u32> = drawn.iter().map(|(x, y)| (y * 64 + x) as u32).collect();
    expected.sort_unstable();
    for fwhm in [1.5, 3.0, 6.0] {
        assert_eq!(find(&image, 64, &map, fwhm), expected, "at {fwhm} px");
    }
    fill(&mut image, 64, &expected);
    assert!(image.iter().all(|value| value.abs() < 6.0 * SIGMA));
}

#[test]
fn fillings_come_from_the_neighbours_and_holes_from_their_rim() {
    let mut image = vec![7.0; 30 * 30];
    let hole: Vec<u32> = (0..81).map(|n| (10 + n / 9) * 30 + 10 + n % 9).collect();
    fill(&mut image, 30, &hole);
    assert!(image.iter().all(|value| value.is_finite()));
    assert_eq!(image[10 * 30 + 10], 7.0);
    // three rounds reach three pixels deep; the heart of the hole is sky
    assert_eq!((image[12 * 30 + 12], image[14 * 30 + 14]), (7.0, 0.0));
    let mut one = vec![f32::NAN];
    fill(&mut one, 1, &[0]);
    assert_eq!(one, [0.0]);
}

#[test]
fn a_flat_sky_has_no_defects() {
    let map = noise_map(200, 200);
    let mut rng = StdRng::seed_from_u64(3);
    for seed in 0..10 {
        assert!(find(&noise(200, 200, 1000 + seed), 200, &map, rng.random_range(1.5..9.0)).is_empty());
    }
}
