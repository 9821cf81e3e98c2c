//! The predecessor's two star sizes, kept for comparison: pixels as they are, no sky taken off unless the image comes
//! without it (docs/formulae.md, "The predecessor's star sizes"). [`crate::hfd`] is what to focus with.

use super::image::Image;
use super::least_squares;

/// Pixels to either side of a star's place: rows and columns from `int(place - 15)` to `int(place + 15) - 1`.
const HALF: f64 = 15.0;
/// FWHM over sigma of a Gaussian.
const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949;

/// Four times the mean radius, weighed with the light: a pedestal draws it to that of the empty cutout, 45.9.
pub(super) fn hfr(image: &Image, places: &[(f64, f64)]) -> f64 {
    mean(image, places, |cutout| {
        let sum: f64 = cutout.pixels().map(|(_, _, value)| value).sum();
        let x = cutout.pixels().map(|(x, _, value)| x * value).sum::<f64>() / sum;
        let y = cutout.pixels().map(|(_, y, value)| y * value).sum::<f64>() / sum;
        4.0 * cutout.pixels().map(|(px, py, value)| (px - x).hypot(py - y) * value).sum::<f64>() / sum
    })
}

/// Mean of both FWHM of an elliptical Gaussian without a constant, px.
pub(super) fn gauss(image: &Image, places: &[(f64, f64)]) -> f64 {
    mean(image, places, |cutout| {
        let (width, height) = (cutout.width as f64, cutout.height as f64);
        let brightest = cutout.pixels().map(|(_, _, value)| value).fold(f64::MIN, f64::max);
        let start = [0.9 * brightest, 0.5 * width, 0.5 * height, 5.0, 5.0, 0.0];
        let free = (f64::NEG_INFINITY, f64::INFINITY);
        let bounds = [free, (0.0, width), (0.0, height), (0.5, 30.0), (0.5, 30.0), free];
        let fit = least_squares::minimise(start, bounds, |p, sums| {
            for (x, y, value) in cutout.pixels() {
                let (model, derivatives) = gaussian(p, x, y);
                sums.add(model - value, derivatives, f64::INFINITY);
            }
        });
        fit.map_or(f64::NAN, |fit| 0.5 * FWHM_PER_SIGMA * (fit.at[3] + fit.at[4]))
    })
}

/// Elliptical Gaussian (height, x, y, sigma along and across, angle) and its derivatives.
fn gaussian(p: &[f64; 6], x: f64, y: f64) -> (f64, [f64; 6]) {
    let (dx, dy) = (x - p[1], y - p[2]);
    let (sin, cos) = p[5].sin_cos();
    let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
    let (u, v) = (along / (p[3] * p[3]), across / (p[4] * p[4]));
    let shape = (-0.5 * (along * u + across * v)).exp();
    let model = p[0] * shape;
    let derivatives = [
        shape,
        model * (u * cos - v * sin),
        model * (u * sin + v * cos),
        model * along * u / p[3],
        model * across * v / p[4],
        model * (v * along - u * across),
    ];
    (model, derivatives)
}

/// A piece of the image around a star; its own coordinates begin at 0.
struct Cutout<'a> {
    image: &'a Image,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl Cutout<'_> {
    fn pixels(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        (0..self.height).flat_map(move |y| {
            let line = &self.image.pixels[(self.top + y) * self.image.width + self.left..][..self.width];
            line.iter().enumerate().map(move |(x, value)| (x as f64, y as f64, *value))
        })
    }
}

/// Plain mean over the stars, as it was; NaN without any.
fn mean(image: &Image, places: &[(f64, f64)], size: impl Fn(&Cutout) -> f64) -> f64 {
    let range = |at: f64, length: usize| {
        let bound = |at: f64| (at.trunc().max(0.0) as usize).min(length);
        (bound(at - HALF), bound(at + HALF))
    };
    let sizes = places.iter().filter_map(|(x, y)| {
        let ((left, right), (top, bottom)) = (range(*x, image.width), range(*y, image.height));
        let is_whole = left < right && top < bottom;
        is_whole.then(|| size(&Cutout { image, left, top, width: right - left, height: bottom - top }))
    });
    let (count, sum) = sizes.fold((0.0, 0.0), |(count, sum), size| (count + 1.0, sum + size));
    sum / count
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes of round Gaussians of flux 60000 on a pedestal: docs/formulae.md, "The predecessor's star sizes".
    #[test]
    fn a_pedestal_dilutes_both_sizes() {
        let image = |sigma: f64, pedestal: f64| {
            let peak = 60_000.0 / (std::f64::consts::TAU * sigma * sigma);
            let value = |n: usize| {
                let (dx, dy) = ((n % 61) as f64 - 30.0, (n / 61) as f64 - 30.0);
                pedestal + peak * (-0.5 * (dx * dx + dy * dy) / (sigma * sigma)).exp()
            };
            Image { width: 61, height: 61, pixels: (0..61 * 61).map(value).collect() }
        };
        let places = [(30.0, 30.0)];
        // mean radius of a Gaussian sigma sqrt(pi / 2), of the empty cutout 11.48 px
        for (pedestal, sigma, as_gauss) in
            [(0.0, 2.0, 4.71), (0.0, 4.0, 9.42), (1000.0, 2.0, 47.0), (1000.0, 4.0, 54.0)]
        {
            let image = image(sigma, pedestal);
            let found = (hfr(&image, &places), gauss(&image, &places));
            let star = sigma * (0.5 * std::f64::consts::PI).sqrt();
            let as_hfr = 4.0 * (6e4 * star + 900.0 * pedestal * 11.48) / (6e4 + 900.0 * pedestal);
            println!("pedestal {pedestal}, sigma {sigma}: {found:?}, {as_hfr}");
            assert!((found.0 / as_hfr - 1.0).abs() < 0.005, "{pedestal} {sigma}: {found:?} {as_hfr}");
            assert!((found.1 / as_gauss - 1.0).abs() < 0.06, "{pedestal} {sigma}: {found:?}");
        }
        let empty = Image { width: 61, height: 61, pixels: vec![7.0; 61 * 61] };
        assert!((hfr(&empty, &places) - 45.9).abs() < 0.05);
        assert!(hfr(&empty, &[]).is_nan() && gauss(&empty, &[(-40.0, 5.0)]).is_nan());
    }
}
