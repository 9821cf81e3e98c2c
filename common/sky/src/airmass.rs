//! The mass of air through which a star is seen.

use units::Angle;

/// Relative airmass at a true (not refracted) altitude, 1 at the zenith and 31.7 at the horizon.
///
/// The rational formula of Young (1994, Applied Optics 33, 1108). None below the horizon, above 90 deg, and for NaN.
pub fn airmass(altitude: Angle) -> Option<f64> {
    if !(0.0..=90.0).contains(&altitude.degrees()) {
        return None;
    }
    let c = altitude.sin();
    let above = (1.002432 * c + 0.148386) * c + 0.0096467;
    let below = ((c + 0.149864) * c + 0.0102963) * c + 0.000303978;
    Some(above / below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn airmass_follows_the_published_formula() {
        for (altitude_deg, expected) in [(90.0, 1.0), (45.0, 1.4121), (30.0, 1.9917), (0.0, 31.7349)] {
            let value = airmass(Angle::from_degrees(altitude_deg)).unwrap();
            assert!((value - expected).abs() < 1e-4, "{altitude_deg}: {value}");
        }
    }

    #[test]
    fn there_is_no_airmass_below_the_horizon() {
        for altitude_deg in [-0.001, -30.0, 90.5, f64::NAN] {
            assert_eq!(airmass(Angle::from_degrees(altitude_deg)), None, "{altitude_deg}");
        }
    }
}
