//! The speed of a mount relative to the stars, in ASCOM's units.

/// Sidereal seconds in a second: the Earth turns once in 86164.0905 s.
const SIDEREAL_PER_SI: f64 = 1.002_737_909_36;
/// Arcseconds in a second of right ascension.
const ARCSEC_PER_RA_S: f64 = 15.0;

/// The values of ASCOM's `RightAscensionRate` and `DeclinationRate`. Both zero: the mount follows the stars.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rates {
    /// Seconds of right ascension per sidereal second, eastward positive: along the coordinate, not on the sky.
    pub ra_s_per_sidereal_s: f64,
    /// Arcseconds per SI second, northward positive.
    pub dec_arcsec_per_s: f64,
}

impl Rates {
    /// From the speeds of the two coordinates.
    pub fn from_arcsec_per_s(ra_arcsec_per_s: f64, dec_arcsec_per_s: f64) -> Self {
        let ra_s_per_sidereal_s = ra_arcsec_per_s / ARCSEC_PER_RA_S / SIDEREAL_PER_SI;
        Self { ra_s_per_sidereal_s, dec_arcsec_per_s }
    }

    /// Speed of the coordinate right ascension.
    pub fn ra_arcsec_per_s(&self) -> f64 {
        self.ra_s_per_sidereal_s * ARCSEC_PER_RA_S * SIDEREAL_PER_SI
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_ascension_is_counted_in_its_seconds_per_sidereal_second() {
        // The sidereal rate itself, 15.041 arcsec/s, is one second of right ascension per sidereal second.
        let rates = Rates::from_arcsec_per_s(15.041_068_6, -2.5);
        assert!((rates.ra_s_per_sidereal_s - 1.0).abs() < 1e-8, "{rates:?}");
        assert_eq!(rates.dec_arcsec_per_s, -2.5);
        assert!((rates.ra_arcsec_per_s() - 15.041_068_6).abs() < 1e-12);
    }
}
