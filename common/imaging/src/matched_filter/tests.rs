//! The running filter against the plain sum, and significance against noise.

use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::camera::Camera;
use crate::frame::{Frame, Pixels};

fn clean(width: usize, height: usize, seed: u64) -> Clean {
    let mut rng = StdRng::seed_from_u64(seed);
    let pixels: Vec<f32> =
        (0..width * height).map(|_| 100.0 + 3.0 * Distribution::<f32>::sample(&StandardNormal, &mut rng)).collect();
    let frame = Frame::new(width, height, Pixels::F32(&pixels)).unwrap();
    Clean::new(&frame, &Camera::default(), None).unwrap()
}

#[test]
fn the_running_filter_agrees_with_the_plain_sum() {
    for (width, height, fwhm) in [(300, 400, 4.0), (70, 9, 12.0), (1, 50, 2.0), (33, 1, 3.0), (1, 1, 1.5)] {
        let clean = clean(width, height, 1);
        let kernel = Kernel::new(fwhm);
        let found = kernel.peaks(&clean, 1.0);
        let plain: Vec<f32> =
            (0..width * height).map(|n| kernel.significance(&clean, n % width, n / width) / found.scatter).collect();
        let at = |x: usize, y: usize| plain[y * width + x];
        // four rows share one noise, so that neighbours may change places
        let is_peak = |x: usize, y: usize, share: f32| {
            let columns = x.saturating_sub(1)..(x + 2).min(width);
            let rows = y.saturating_sub(1)..(y + 2).min(height);
            let highest = rows.flat_map(|r| columns.clone().map(move |c| at(c, r))).fold(f32::MIN, f32::max);
            at(x, y) >= share * highest
        };
        // all that are above the threshold at a pixel's centre, and some that are above it between the pixels
        let missing = (0..width * height).map(|n| (n % width, n / width)).filter(|(x, y)| {
            let near = |p: &Peak| p.x.abs_diff(*x) <= 1 && p.y.abs_diff(*y) <= 1;
            is_peak(*x, *y, 1.0) && at(*x, *y) > 1.02 && !found.peaks.iter().any(near)
        });
        assert_eq!(missing.count(), 0, "{width} x {height} at {fwhm} px");
        for peak in &found.peaks {
            assert!(is_peak(peak.x, peak.y, 0.98));
            // a peak of noise may be sharper than a star
            let gain = peak.significance / at(peak.x, peak.y);
            assert!(gain > 0.98 && gain < 1.15 / kernel.sampling_loss(), "{gain} at {fwhm} px");
        }
    }
}

#[test]
fn significance_of_noise_has_a_scatter_of_one() {
    for fwhm in [1.5, 4.0, 12.0] {
        let clean = clean(600, 500, 5);
        let kernel = Kernel::new(fwhm);
        let values: Vec<f32> = (0..3000).map(|n| kernel.significance(&clean, 50 + n % 500, 50 + n * 7 % 400)).collect();
        let rms = (values.iter().map(|v| v * v).sum::<f32>() / values.len() as f32).sqrt();
        assert!((0.9..1.12).contains(&rms), "{rms} at {fwhm} px");
    }
}
