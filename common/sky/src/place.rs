//! The place of the telescope on Earth, and the orientation of the Earth.

use units::Angle;

use crate::SkyError;

const WGS84_RADIUS_M: f64 = 6_378_137.0;
const WGS84_FLATTENING: f64 = 1.0 / 298.257_223_563;

/// A site on the WGS84 ellipsoid, within its ranges by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    latitude: Angle,
    longitude_east: Angle,
    elevation_m: f64,
}

impl Place {
    /// A site from its geodetic latitude, its longitude counted east (negative or above 180 deg in the west), and its
    /// elevation; refused when out of range.
    pub fn new(latitude: Angle, longitude_east: Angle, elevation_m: f64) -> Result<Self, SkyError> {
        if !(-90.0..=90.0).contains(&latitude.degrees()) {
            return Err(SkyError::Latitude { degrees: latitude.degrees() });
        }
        if !(-180.0..=360.0).contains(&longitude_east.degrees()) {
            return Err(SkyError::Longitude { degrees: longitude_east.degrees() });
        }
        if !(-500.0..=9000.0).contains(&elevation_m) {
            return Err(SkyError::Elevation { metres: elevation_m });
        }
        Ok(Self { latitude, longitude_east: longitude_east.wrapped_signed(), elevation_m })
    }

    /// Geodetic latitude, north positive.
    pub const fn latitude(&self) -> Angle {
        self.latitude
    }

    /// Longitude, east positive, [-180, 180) deg.
    pub const fn longitude_east(&self) -> Angle {
        self.longitude_east
    }

    /// Height above the ellipsoid, m.
    pub const fn elevation_m(&self) -> f64 {
        self.elevation_m
    }

    /// Distance from the Earth's axis, and from the plane of its equator (north positive), m.
    pub fn from_axis_and_equator_m(&self) -> (f64, f64) {
        let squeeze = (1.0 - WGS84_FLATTENING).powi(2);
        let curvature_m = WGS84_RADIUS_M / (self.latitude.cos().powi(2) + squeeze * self.latitude.sin().powi(2)).sqrt();
        let from_axis_m = (curvature_m + self.elevation_m) * self.latitude.cos();
        (from_axis_m, (curvature_m * squeeze + self.elevation_m) * self.latitude.sin())
    }

    /// Geocentric place in the Earth's frame (ITRS), m: x towards longitude 0 on the equator, z towards the north pole.
    pub fn geocentric_m(&self) -> [f64; 3] {
        let (from_axis_m, from_equator_m) = self.from_axis_and_equator_m();
        [from_axis_m * self.longitude_east.cos(), from_axis_m * self.longitude_east.sin(), from_equator_m]
    }
}

/// The orientation of the Earth, as the IERS bulletins give it; all zero costs up to 10 arcsec in altitude and azimuth.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EarthOrientation {
    /// UT1-UTC in seconds, within [-0.9, 0.9] as long as there are leap seconds.
    pub dut1_s: f64,
    /// Polar motion x in arcsec.
    pub polar_x_arcsec: f64,
    /// Polar motion y in arcsec.
    pub polar_y_arcsec: f64,
}

impl EarthOrientation {
    /// Refuses what is not finite, or beyond anything the Earth does: 60 s, 2 arcsec.
    pub fn checked(self) -> Result<Self, SkyError> {
        let Self { dut1_s, polar_x_arcsec, polar_y_arcsec } = self;
        // Leap seconds may end after 2035, and then UT1-UTC grows to a minute.
        if dut1_s.abs() <= 60.0 && polar_x_arcsec.abs() <= 2.0 && polar_y_arcsec.abs() <= 2.0 {
            Ok(self)
        } else {
            Err(SkyError::EarthOrientation { dut1_s, polar_x_arcsec, polar_y_arcsec })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(latitude: f64, longitude: f64, elevation_m: f64) -> Result<Place, SkyError> {
        Place::new(Angle::from_degrees(latitude), Angle::from_degrees(longitude), elevation_m)
    }

    #[test]
    fn a_place_off_the_earth_is_refused() {
        assert!(place(-90.0, -180.0, 0.0).is_ok());
        assert_eq!(place(91.0, 0.0, 0.0), Err(SkyError::Latitude { degrees: 91.0 }));
        assert_eq!(place(0.0, 361.0, 0.0), Err(SkyError::Longitude { degrees: 361.0 }));
        assert_eq!(place(0.0, 0.0, 24_000.0), Err(SkyError::Elevation { metres: 24_000.0 }));
        assert!(place(f64::NAN, 0.0, 0.0).is_err() && place(0.0, f64::NAN, 0.0).is_err());
        assert!(place(0.0, 0.0, f64::NAN).is_err());
    }

    #[test]
    fn a_longitude_counted_round_the_east_is_the_same_place() {
        assert_eq!(place(-24.5, 289.5, 0.0), place(-24.5, -70.5, 0.0));
    }

    #[test]
    fn an_earth_turned_by_nan_is_refused() {
        assert!(EarthOrientation::default().checked().is_ok());
        assert!(EarthOrientation { dut1_s: f64::NAN, ..Default::default() }.checked().is_err());
        assert!(EarthOrientation { polar_x_arcsec: 100.0, ..Default::default() }.checked().is_err());
    }
}
