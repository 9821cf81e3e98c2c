//! How sharp is the picture as a whole? Sums over differences and moments of pixels.
//!
//! Formulae and sources: docs/formulae.md, "Measures of sharpness". They are computed in f64, because differences and
//! products of 16-bit counts wrap. All of them grow towards focus.

use super::image::Image;

/// Variance over mean. Brightness of the sky enters through the mean.
pub(super) fn normalized_variance(image: &Image) -> f64 {
    variance(&image.pixels) / image.mean()
}

/// Squared differences between rows two apart (vertical only).
pub(super) fn brenner(image: &Image) -> f64 {
    rows_apart(image, 2, |a, b| (a - b).powi(2))
}

/// Squared central differences in x and y, mirrored at the border.
pub(super) fn tenengrad(image: &Image) -> f64 {
    over_all(image, |x, y| {
        let gx = image.mirrored(x + 1, y) - image.mirrored(x - 1, y);
        let gy = image.mirrored(x, y + 1) - image.mirrored(x, y - 1);
        gx * gx + gy * gy
    })
    .sum()
}

/// Absolute values of the Laplacian of four neighbours, mirrored at the border.
pub(super) fn laplacian(image: &Image) -> f64 {
    over_all(image, |x, y| curvature(image, x, y).abs()).sum()
}

/// Variance of that Laplacian.
pub(super) fn variance_laplacian(image: &Image) -> f64 {
    variance(&over_all(image, |x, y| curvature(image, x, y)).collect::<Vec<f64>>())
}

/// Absolute first differences in x and in y.
pub(super) fn absolute_gradient(image: &Image) -> f64 {
    differences(image, f64::abs)
}

/// Squared first differences in x and in y.
pub(super) fn squared_gradient(image: &Image) -> f64 {
    differences(image, |step| step * step)
}

/// Products of rows one apart less products of rows two apart (vertical only).
pub(super) fn auto_correlation(image: &Image) -> f64 {
    rows_apart(image, 1, |a, b| a * b) - rows_apart(image, 2, |a, b| a * b)
}

/// For a focus that is lost: squared gradients over the square of the mean light, of 4 x 4 bins.
/// Exposure and transparency cancel. Pixels below the sky count as none in the mean, so that it cannot vanish.
pub(super) fn relative_gradient(image: &Image) -> f64 {
    let binned = image.binned(4);
    let light = binned.pixels.iter().map(|value| value.max(0.0)).sum::<f64>() / binned.pixels.len() as f64;
    squared_gradient(&binned) / (light * light)
}

fn curvature(image: &Image, x: isize, y: isize) -> f64 {
    let around =
        image.mirrored(x - 1, y) + image.mirrored(x + 1, y) + image.mirrored(x, y - 1) + image.mirrored(x, y + 1);
    around - 4.0 * image.mirrored(x, y)
}

fn over_all(image: &Image, at: impl Fn(isize, isize) -> f64) -> impl Iterator<Item = f64> {
    let width = image.width;
    (0..image.pixels.len()).map(move |n| at((n % width) as isize, (n / width) as isize))
}

fn rows_apart(image: &Image, apart: usize, term: impl Fn(f64, f64) -> f64) -> f64 {
    let below = image.pixels.iter().skip(apart * image.width);
    image.pixels.iter().zip(below).map(|(a, b)| term(*a, *b)).sum()
}

fn differences(image: &Image, term: impl Fn(f64) -> f64) -> f64 {
    let along: f64 =
        image.pixels.chunks(image.width).flat_map(|row| row.windows(2)).map(|two| term(two[1] - two[0])).sum();
    along + rows_apart(image, 1, |a, b| term(b - a))
}

fn variance(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64
}
