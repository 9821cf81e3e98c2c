//! The focus operators by name: one number per frame that is smallest or greatest in focus.

use super::image::Image;
use super::{contrast, spectrum, star_size};

/// Which way is sharper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Sizes.
    Smaller,
    /// Contrasts.
    Larger,
}

/// A measure of how sharp a frame is.
#[derive(Debug, Clone, Copy)]
pub struct Operator {
    /// Its name in schedules.
    pub name: &'static str,
    /// What it is, in a few words.
    pub what: &'static str,
    /// Which way is sharper.
    pub better: Better,
    /// Whether it looks at stars: then it must be given where they are in this frame.
    pub needs_stars: bool,
    measure: fn(&Image, &[(f64, f64)]) -> f64,
}

const fn size(name: &'static str, what: &'static str, measure: fn(&Image, &[(f64, f64)]) -> f64) -> Operator {
    Operator { name, what, better: Better::Smaller, needs_stars: true, measure }
}

macro_rules! contrast {
    ($name:literal, $what:literal, $measure:path) => {
        Operator {
            name: $name,
            what: $what,
            better: Better::Larger,
            needs_stars: false,
            measure: |image, _| $measure(image),
        }
    };
}

/// All of them: the predecessor's thirteen, and one for a focus that is lost. Formulae and sources: docs/formulae.md,
/// "Measures of sharpness" and "The predecessor's star sizes".
pub const OPERATORS: [Operator; 14] = [
    size("hfr", "4 x mean radius of stars weighed with light", star_size::hfr),
    size("gauss", "FWHM of Gaussians fitted to stars, px", star_size::gauss),
    contrast!("fft", "power above the high frequencies' mean", spectrum::power),
    contrast!("fft_power", "the same as fft", spectrum::power),
    contrast!(
        "fft_phase_magnitude_product",
        "phase times magnitude of all frequencies",
        spectrum::phase_magnitude_product
    ),
    contrast!("normalized_variance", "variance over mean", contrast::normalized_variance),
    contrast!("brenner", "squared differences of rows two apart", contrast::brenner),
    contrast!("tenengrad", "squared central differences", contrast::tenengrad),
    contrast!("laplacian", "absolute Laplacian", contrast::laplacian),
    contrast!("variance_laplacian", "variance of the Laplacian", contrast::variance_laplacian),
    contrast!("absolute_gradient", "absolute first differences", contrast::absolute_gradient),
    contrast!("squared_gradient", "squared first differences", contrast::squared_gradient),
    contrast!("auto_correlation", "products of rows one apart less two apart", contrast::auto_correlation),
    contrast!("relative_gradient", "squared gradients over squared light, 4 x 4 bins", contrast::relative_gradient),
];

/// A name that no operator has, or that several begin with.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no focus operator is called {name:?}; take one of {known}")]
pub struct UnknownOperator {
    /// What was asked for.
    pub name: String,
    /// The names that there are.
    pub known: String,
}

impl Operator {
    /// The operator of this name, or the only one whose name begins so; upper case, blanks and hyphens do not matter.
    ///
    /// # Errors
    /// [`UnknownOperator`] for any other name: a mistake in a schedule should not pass unnoticed.
    pub fn named(name: &str) -> Result<&'static Self, UnknownOperator> {
        super::by_name(&OPERATORS, |operator| operator.name, name)
            .map_err(|known| UnknownOperator { name: name.to_owned(), known })
    }

    /// The frame's value; `places` are the stars' (px), for those that need them. None when there is none: no star,
    /// or a sum that is not finite.
    pub fn measure(&self, image: &Image, places: &[(f64, f64)]) -> Option<f64> {
        Some((self.measure)(image, places)).filter(|value| value.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, Pixels};

    fn value(name: &str, image: &Image) -> f64 {
        Operator::named(name).unwrap().measure(image, &[]).unwrap()
    }

    /// The golden numbers are those of astrafocus 0.1.5 for this image in 64-bit floating point.
    #[test]
    fn operators_agree_with_the_golden_numbers() {
        let image = Image { width: 6, height: 6, pixels: (0..36).map(|k| f64::from(k).powf(1.5)).collect() };
        let golden = [
            ("fft", 8_356.336_852),
            ("fft_power", 8_356.336_852),
            ("fft_phase_magnitude_product", 13_356.540_607),
            ("normalized_variance", 48.742_227),
            ("tenengrad", 138_090.841_602),
            ("brenner", 134_313.599_394),
            ("laplacian", 1_050.273_198),
            ("variance_laplacian", 1_947.153_649),
            ("absolute_gradient", 1_261.384_343),
            ("squared_gradient", 43_539.554_863),
            ("auto_correlation", 104_567.511_310),
        ];
        for (name, expected) in golden {
            let found = value(name, &image);
            assert!((found - expected).abs() < 2e-6, "{name}: {found}, golden {expected}");
        }
    }

    #[test]
    fn the_operator_for_lost_focus_knows_neither_exposure_nor_size_of_the_field() {
        let drawn = |scale: f64| {
            let value =
                |n: usize| scale * (-0.02 * ((n % 64) as f64 - 30.0).hypot((n / 64) as f64 - 30.0).powi(2)).exp();
            Image { width: 64, height: 64, pixels: (0..64 * 64).map(value).collect() }
        };
        let (once, thrice) = (value("relative_gradient", &drawn(1.0)), value("relative_gradient", &drawn(3.0)));
        assert!((once / thrice - 1.0).abs() < 1e-9, "{once} {thrice}");
    }

    #[test]
    fn names_are_forgiving_and_unknown_ones_are_refused() {
        assert_eq!(Operator::named("HFR").unwrap().name, "hfr");
        assert_eq!(Operator::named("Normalized variance").unwrap().name, "normalized_variance");
        assert_eq!(Operator::named("fft_phase").unwrap().name, "fft_phase_magnitude_product");
        assert_eq!(Operator::named("fft").unwrap().name, "fft");
        for name in ["", "sharpness", "f"] {
            let refused = Operator::named(name).unwrap_err();
            assert!(refused.to_string().contains("tenengrad"), "{refused}");
        }
    }

    #[test]
    fn any_image_has_a_value_or_none() {
        for (width, height) in [(1, 1), (1, 7), (7, 1), (2, 2), (3, 5)] {
            for level in [0, 1, 65_535] {
                let pixels = vec![level; width * height];
                let image = Image::raw(&Frame::new(width, height, Pixels::U16(&pixels)).unwrap()).unwrap();
                for operator in &OPERATORS {
                    let value = operator.measure(&image, &[(0.0, 0.0)]);
                    assert!(value.is_none_or(f64::is_finite), "{}", operator.name);
                }
            }
        }
    }
}
