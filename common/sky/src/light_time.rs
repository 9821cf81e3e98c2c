//! The time at which a star's light would have passed the centre of the Sun or of the solar system.

use sofars::consts::AULT;
use sofars::ts;
use units::Utc;

use crate::{EarthOrientation, Icrs, Observer, Place, SkyError};

const DAY_S: f64 = 86_400.0;

/// `BJD-OBS`: barycentric Julian date on the TDB scale, whole days (at midnight, .5) and the fraction in [0, 1).
///
/// The light time is that from the site, for a star without parallax.
pub fn barycentric_jd_tdb(
    place: &Place,
    orientation: &EarthOrientation,
    at: Utc,
    star: &Icrs,
) -> Result<(f64, f64), SkyError> {
    Ok(Observer::new(place, orientation, at)?.barycentric_jd_tdb(star))
}

/// `HJD-OBS`: heliocentric Julian date on the UTC scale, whole days (at midnight, .5) and the fraction in [0, 1).
///
/// UTC as FITS headers of the field have it; for a scale without leap seconds take the barycentric date.
pub fn heliocentric_jd_utc(
    place: &Place,
    orientation: &EarthOrientation,
    at: Utc,
    star: &Icrs,
) -> Result<(f64, f64), SkyError> {
    Ok(Observer::new(place, orientation, at)?.heliocentric_jd_utc(star))
}

impl Observer {
    /// As [`barycentric_jd_tdb`], for this place and instant.
    pub fn barycentric_jd_tdb(&self, star: &Icrs) -> (f64, f64) {
        let (day, fraction) = self.scales.tt;
        whole_days(day, fraction + (self.tdb_minus_tt_s() + self.barycentric_light_time_s(star)) / DAY_S)
    }

    /// As [`heliocentric_jd_utc`], for this place and instant.
    pub fn heliocentric_jd_utc(&self, star: &Icrs) -> (f64, f64) {
        let (day, fraction) = self.scales.utc;
        whole_days(day, fraction + self.heliocentric_light_time_s(star) / DAY_S)
    }

    /// Seconds from the site to the solar system's barycentre along the star's light; within 8.4 minutes either way.
    pub fn barycentric_light_time_s(&self, star: &Icrs) -> f64 {
        sofars::vm::pdp(&self.astrometry.eb, &star.unit()) * AULT
    }

    /// Seconds from the site to the Sun's centre along the star's light.
    pub fn heliocentric_light_time_s(&self, star: &Icrs) -> f64 {
        sofars::vm::pdp(&self.astrometry.eh, &star.unit()) * self.astrometry.em * AULT
    }

    /// TDB - TT at the site: a yearly wave of 1.7 ms, and 2 us of the site's daily turn.
    fn tdb_minus_tt_s(&self) -> f64 {
        let (from_axis_m, from_equator_m) = self.place.from_axis_and_equator_m();
        let (from_axis_km, from_equator_km) = (from_axis_m / 1000.0, from_equator_m / 1000.0);
        let (tt1, tt2) = self.scales.tt;
        let longitude = self.place.longitude_east().radians();
        ts::dtdb(tt1, tt2, self.scales.ut1.1.rem_euclid(1.0), longitude, from_axis_km, from_equator_km)
    }
}

fn whole_days(day: f64, fraction: f64) -> (f64, f64) {
    let carry = fraction.floor();
    (day + carry, fraction - carry)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fraction_stays_within_its_day() {
        assert_eq!(whole_days(2_460_000.5, 1.25), (2_460_001.5, 0.25));
        assert_eq!(whole_days(2_460_000.5, -0.25), (2_459_999.5, 0.75));
    }
}
