//! How bright a star of the catalogue is on a frame.

use imaging::Solution;

/// Fewest stars that give a zero point.
const FEWEST: usize = 5;
/// Stars further from the median than so many standard deviations are variable, blended or no stars of the catalogue.
const CLIP: f64 = 3.0;
/// Catalogues have other bands than cameras: the colours of the stars spread their zero points at least so much, mag.
const LEAST_SPREAD_MAG: f64 = 0.02;

/// The zero point of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Magnitude (in the band of the catalogue) of a star that gives 1 ADU per second.
    pub mag: f64,
    /// Its standard error, mag.
    pub error_mag: f64,
    /// Stars that give it.
    pub stars: usize,
}

/// The zero point by the stars of a solution: the median of `magnitude + 2.5 log10(flux / exposure)` over all that are
/// neither saturated, cut, blended nor trailed. None with fewer than five of them, or without an exposure time.
pub fn measure(solution: &Solution, exposure_s: f64) -> Option<Measured> {
    if !(exposure_s > 0.0 && exposure_s.is_finite()) {
        return None;
    }
    let sound = solution.matches.iter().filter(|m| m.star.flags.none() && m.star.flux_adu > 0.0);
    let each = sound.map(|m| m.known.mag + 2.5 * (m.star.flux_adu / exposure_s).log10());
    of(each.filter(|mag| mag.is_finite()).collect())
}

fn of(mut mags: Vec<f64>) -> Option<Measured> {
    let (middle, spread) = middle(&mags)?;
    mags.retain(|mag| (mag - middle).abs() <= CLIP * spread);
    let stars = mags.len();
    let (mag, spread) = middle_of_enough(&mags)?;
    // The standard error of a median of normal deviates.
    Some(Measured { mag, error_mag: 1.2533 * spread / (stars as f64).sqrt(), stars })
}

fn middle_of_enough(mags: &[f64]) -> Option<(f64, f64)> {
    (mags.len() >= FEWEST).then(|| middle(mags)).flatten()
}

/// Median, and the standard deviation by the median of the distances from it.
fn middle(values: &[f64]) -> Option<(f64, f64)> {
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let middle = median(values.to_vec())?;
    let spread = 1.4826 * median(values.iter().map(|value| (value - middle).abs()).collect())?;
    Some((middle, spread.max(LEAST_SPREAD_MAG)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_do_not_move_the_zero_point() {
        let mut mags: Vec<f64> = (0..40).map(|n| 21.5 + 0.01 * f64::from(n % 5 - 2)).collect();
        let clean = of(mags.clone()).unwrap();
        assert!((clean.mag - 21.5).abs() < 1e-9 && clean.stars == 40 && clean.error_mag < 0.005, "{clean:?}");
        mags.extend([14.0, 19.0, 25.0, 30.0]);
        let dirty = of(mags).unwrap();
        assert!((dirty.mag - 21.5).abs() < 0.01 && dirty.stars == 40, "{dirty:?}");
    }

    #[test]
    fn few_stars_give_no_zero_point() {
        assert_eq!(of(vec![21.0; 4]), None);
        assert_eq!(of(Vec::new()), None);
        assert!(of(vec![21.0; 5]).is_some());
    }
}
