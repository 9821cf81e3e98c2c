//! The Sun and the Moon, seen from the site.

use sofars::consts::AULT;
use sofars::eph;

use crate::{Horizontal, Icrs, Observer};

const DAY_S: f64 = 86_400.0;

impl Observer {
    /// The Sun's centre, geometric: at true sunset it stands 0.833 deg below the horizon. Good to 0.1 arcsec.
    ///
    /// Astropy's `get_body("sun")`, turned to altitude and azimuth, is off from this by 0.004 arcsec at the median and
    /// by an arcsecond at the worst: where the source has a distance it bends the Sun's own light round the Sun. Given
    /// the same direction without its distance it agrees to 0.0001 arcsec (`tests/python/test_sky.py`).
    pub fn sun(&self) -> Horizontal {
        self.to_horizontal(&self.sun_icrs())
    }

    /// The Moon's centre, geometric, with the parallax of the site.
    pub fn moon(&self) -> Horizontal {
        self.to_horizontal(&self.moon_icrs())
    }

    /// The Sun's astrometric place (as a star would have in a catalogue) from this site, good to 0.1 arcsec.
    pub fn sun_icrs(&self) -> Icrs {
        Icrs::from_vector(&self.sun_vector())
    }

    /// The Moon's astrometric place from this site, good to 10 arcsec (`moon98`).
    ///
    /// The parallax makes it differ by up to a degree from the Moon's geocentric place.
    pub fn moon_icrs(&self) -> Icrs {
        Icrs::from_vector(&self.moon_vector())
    }

    /// Lit part of the Moon's disk, 0 at new and 1 at full moon.
    pub fn moon_illumination(&self) -> f64 {
        let (sun, moon) = (self.sun_vector(), self.moon_vector());
        let moon_to_sun = sofars::vm::pmp(&sun, &moon);
        let moon_to_site = moon.map(|component| -component);
        (1.0 + sofars::vm::sepp(&moon_to_sun, &moon_to_site).cos()) / 2.0
    }

    /// From the site to where the light of the Sun that arrives now left it, au.
    fn sun_vector(&self) -> [f64; 3] {
        let light_days = self.astrometry.em * AULT / DAY_S;
        std::array::from_fn(|i| {
            let position = self.earth[0][i] - self.earth_from_sun[0][i];
            let velocity = self.earth[1][i] - self.earth_from_sun[1][i];
            position - velocity * light_days - self.astrometry.eb[i]
        })
    }

    /// From the site to where the light of the Moon that arrives now left it, au.
    pub(crate) fn moon_vector(&self) -> [f64; 3] {
        let (tt1, tt2) = self.scales.tt;
        let seen_after = |light_days: f64| -> [f64; 3] {
            let moon = eph::moon98(tt1, tt2 - light_days);
            std::array::from_fn(|i| {
                let earth = self.earth[0][i] - self.earth[1][i] * light_days;
                earth + moon[0][i] - self.astrometry.eb[i]
            })
        };
        // Twice, and from the site: it travels with the Earth at 30 km/s, so the 20 ms that light needs for the Earth's
        // radius are 0.3 arcsec.
        let mut light_days = 0.0;
        for _ in 0..2 {
            light_days = sofars::vm::pm(seen_after(light_days)) * AULT / DAY_S;
        }
        seen_after(light_days)
    }
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use crate::{EarthOrientation, Observer, Place, separation};

    fn observer(at: &str) -> Observer {
        let place = Place::new(Angle::from_degrees(31.0), Angle::from_degrees(-115.5), 2800.0).unwrap();
        Observer::new(&place, &EarthOrientation::default(), at.parse().unwrap()).unwrap()
    }

    #[test]
    fn the_moon_is_lit_when_full_and_dark_when_new() {
        // Full 2026-11-24T14:53Z, first quarter 2026-11-17T11:48Z, new 2026-11-09T07:02Z.
        assert!(observer("2026-11-24T14:53:00Z").moon_illumination() > 0.99);
        assert!((observer("2026-11-17T11:48:00Z").moon_illumination() - 0.5).abs() < 0.02);
        assert!(observer("2026-11-09T07:02:00Z").moon_illumination() < 0.01);
    }

    #[test]
    fn sun_and_moon_meet_in_an_eclipse() {
        // Greatest eclipse of 2024-04-08, total at Mazatlan (23.25 N, 106.4 W) about 18:09:30Z.
        let mazatlan = Place::new(Angle::from_degrees(23.25), Angle::from_degrees(-106.42), 0.0).unwrap();
        let at = "2024-04-08T18:09:30Z".parse().unwrap();
        let observer = Observer::new(&mazatlan, &EarthOrientation::default(), at).unwrap();
        assert!(separation(&observer.sun_icrs(), &observer.moon_icrs()).arcseconds() < 60.0);
    }

    #[test]
    fn the_sun_stands_at_the_equinox_in_march() {
        let sun = observer("2026-03-20T14:46:00Z").sun_icrs();
        // Apparent longitude 0 at that minute; the ICRS place lacks 26 years of precession and the aberration.
        assert!(sun.ra.wrapped_signed().degrees().abs() < 0.5 && sun.dec.degrees().abs() < 0.2, "{sun:?}");
    }
}
