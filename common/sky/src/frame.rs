//! Directions in the sky, each in its frame.

use units::Angle;

use crate::SkyError;

/// A place among the stars: the International Celestial Reference System, as catalogues give it.
///
/// Proper motion and parallax are taken as already applied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Icrs {
    /// Right ascension.
    pub ra: Angle,
    /// Declination.
    pub dec: Angle,
}

/// The apparent topocentric place against the true equator and equinox of date: "JNow", ASCOM `equTopocentric`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OfDate {
    /// Right ascension from the true equinox of date.
    pub ra: Angle,
    /// Declination from the true equator of date.
    pub dec: Angle,
}

/// A direction as a theodolite at the site would read it in a world without air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Horizontal {
    /// Above the horizon; not refracted.
    pub altitude: Angle,
    /// From north through east, [0, 360) deg when computed here.
    pub azimuth: Angle,
}

impl Icrs {
    /// From degrees, right ascension too.
    pub const fn from_degrees(ra_deg: f64, dec_deg: f64) -> Self {
        Self { ra: Angle::from_degrees(ra_deg), dec: Angle::from_degrees(dec_deg) }
    }

    /// This direction, if it is one: both finite, the declination within [-90, 90] deg; right ascension is wrapped.
    pub fn checked(self) -> Result<Self, SkyError> {
        if self.ra.is_finite() && self.dec.degrees().abs() <= 90.0 {
            Ok(Self { ra: self.ra.wrapped_positive(), dec: self.dec })
        } else {
            Err(SkyError::Direction { ra_deg: self.ra.degrees(), dec_deg: self.dec.degrees() })
        }
    }

    /// Unit vector, x to the equinox and z to the pole.
    pub(crate) fn unit(&self) -> [f64; 3] {
        sofars::vm::s2c(self.ra.radians(), self.dec.radians())
    }

    pub(crate) fn from_vector(vector: &[f64; 3]) -> Self {
        let (ra, dec) = sofars::vm::c2s(vector);
        Self { ra: Angle::from_radians(ra).wrapped_positive(), dec: Angle::from_radians(dec) }
    }
}

impl OfDate {
    /// From degrees, right ascension too.
    pub const fn from_degrees(ra_deg: f64, dec_deg: f64) -> Self {
        Self { ra: Angle::from_degrees(ra_deg), dec: Angle::from_degrees(dec_deg) }
    }
}

impl Horizontal {
    /// From degrees.
    pub const fn from_degrees(altitude_deg: f64, azimuth_deg: f64) -> Self {
        Self { altitude: Angle::from_degrees(altitude_deg), azimuth: Angle::from_degrees(azimuth_deg) }
    }

    /// Angle to another direction, [0, 180] deg.
    pub fn separation(&self, other: &Self) -> Angle {
        // Azimuth runs against right ascension, which changes no distance.
        Angle::from_radians(sofars::vm::seps(
            self.azimuth.radians(),
            self.altitude.radians(),
            other.azimuth.radians(),
            other.altitude.radians(),
        ))
    }
}

/// Angle between two directions, [0, 180] deg; exact for tiny angles too.
pub fn separation(a: &Icrs, b: &Icrs) -> Angle {
    Angle::from_radians(sofars::vm::seps(a.ra.radians(), a.dec.radians(), b.ra.radians(), b.dec.radians()))
}

/// Direction of `to` as seen at `from`: from north through east, [0, 360) deg; 0 where both are the same.
pub fn position_angle(from: &Icrs, to: &Icrs) -> Angle {
    let difference = to.ra - from.ra;
    let east = to.dec.cos() * difference.sin();
    let north = to.dec.sin() * from.dec.cos() - to.dec.cos() * from.dec.sin() * difference.cos();
    Angle::from_radians(east.atan2(north)).wrapped_positive()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separation_is_exact_near_and_far() {
        let a = Icrs::from_degrees(10.0, 60.0);
        assert!((separation(&a, &Icrs::from_degrees(10.0, 61.0)).degrees() - 1.0).abs() < 1e-12);
        assert!((separation(&a, &Icrs::from_degrees(10.0 + 2.0 / 3600.0, 60.0)).arcseconds() - 1.0).abs() < 1e-6);
        assert!((separation(&a, &Icrs::from_degrees(190.0, -60.0)).degrees() - 180.0).abs() < 1e-6);
        assert!((separation(&a, &Icrs::from_degrees(370.0, 60.0)).degrees()).abs() < 1e-9);
    }

    #[test]
    fn position_angle_runs_from_north_through_east() {
        let here = Icrs::from_degrees(359.99, 0.0);
        for (ra, dec, expected) in [(359.99, 1.0, 0.0), (0.01, 0.0, 90.0), (359.99, -1.0, 180.0), (359.9, 0.0, 270.0)] {
            let angle = position_angle(&here, &Icrs::from_degrees(ra, dec)).degrees();
            assert!((angle - expected).abs() < 1e-9, "{ra} {dec}: {angle}");
        }
    }

    #[test]
    fn a_direction_from_nowhere_is_refused() {
        assert_eq!(Icrs::from_degrees(-10.0, 5.0).checked(), Ok(Icrs::from_degrees(350.0, 5.0)));
        for (ra, dec) in [(f64::NAN, 0.0), (0.0, f64::NAN), (0.0, 90.1), (f64::INFINITY, 0.0)] {
            assert!(Icrs::from_degrees(ra, dec).checked().is_err(), "{ra} {dec}");
        }
    }
}
