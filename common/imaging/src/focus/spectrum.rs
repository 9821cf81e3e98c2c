//! Sharpness in the frequencies of the picture (docs/formulae.md, "Measures of sharpness").

use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use super::image::Image;

/// What magnitudes have above their mean in the middle of the plane, where the highest frequencies are
/// (Tan and others 2022); the constant part is among them.
pub(super) fn power(image: &Image) -> f64 {
    let (width, height) = (image.width, image.height);
    let magnitudes: Vec<f64> = transform(image).iter().map(|value| value.norm()).collect();
    let (rows, columns) = (height / 2 / 2..height / 2, width / 2 / 2..width / 2);
    let middle = rows.flat_map(|y| &magnitudes[y * width..][columns.clone()]);
    let (count, sum) = middle.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value));
    let noise = if count == 0 { 0.0 } else { sum / f64::from(count) };
    magnitudes.iter().map(|value| (value - noise).max(0.0)).sum()
}

/// Absolute phase times magnitude, over all frequencies.
pub(super) fn phase_magnitude_product(image: &Image) -> f64 {
    transform(image).iter().map(|value| value.arg().abs() * value.norm()).sum()
}

/// The two-dimensional Fourier transform, in row order, frequency zero first; not normalised.
fn transform(image: &Image) -> Vec<Complex<f64>> {
    let (width, height) = (image.width, image.height);
    let mut plane: Vec<Complex<f64>> = image.pixels.iter().map(|value| Complex::new(*value, 0.0)).collect();
    let mut planner = FftPlanner::new();
    planner.plan_fft_forward(width).process(&mut plane);
    let along_columns = planner.plan_fft_forward(height);
    let mut column = vec![Complex::new(0.0, 0.0); height];
    for x in 0..width {
        column.iter_mut().enumerate().for_each(|(y, value)| *value = plane[y * width + x]);
        along_columns.process(&mut column);
        column.iter().enumerate().for_each(|(y, value)| plane[y * width + x] = *value);
    }
    plane
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_is_the_sum_that_it_is_defined_by() {
        let (width, height) = (5, 3);
        let pixels: Vec<f64> = (0..15).map(|n| f64::from(n * n % 7)).collect();
        let image = Image { width, height, pixels: pixels.clone() };
        let found = transform(&image);
        for (n, value) in found.iter().enumerate() {
            let (u, v) = ((n % width) as f64, (n / width) as f64);
            let expected: Complex<f64> = (0..15)
                .map(|m| {
                    let (x, y) = ((m % width) as f64, (m / width) as f64);
                    let turn = -std::f64::consts::TAU * (u * x / width as f64 + v * y / height as f64);
                    Complex::from_polar(pixels[m], turn)
                })
                .sum();
            assert!((value - expected).norm() < 1e-9, "{n}: {value} {expected}");
        }
    }
}
