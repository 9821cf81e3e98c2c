//! Bodies that move among the stars: the direction of one, as seen from the site.
//!
//! All give the *astrometric* place: the direction from the site to where the light that arrives now left the body, in
//! ICRS axes and without aberration, as a catalogue would list a star next to it. [`Observer::to_of_date`] and
//! [`Observer::to_horizontal`] then convert it as they convert a star.
//!
//! The accuracy compared with JPL's DE421 from 1990 to 2050 (`tests/python/test_sky.py`): the Moon within 10 arcsec,
//! Mercury to Mars within 0.2, Jupiter and Saturn within 0.4, Uranus and Neptune within 2.3 arcsec. Satellites agree
//! with the reference SGP4 to 0.01 arcsec; how old the elements are decides how true that is.

mod orbit;
mod planet;
mod rates;
mod satellite;

use sofars::consts::AULT;

pub use self::orbit::{Orbit, Shape, When};
pub use self::planet::Planet;
pub use self::rates::Rates;
pub use self::satellite::Satellite;
use crate::{Icrs, Observer, SkyError};

const DAY_S: f64 = 86_400.0;
/// Light time is computed anew so often: each time shrinks its error by the body's speed over that of light, 1e-4.
const LIGHT_TIMES: u32 = 3;

/// A body that moves among the stars.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// A planet.
    Planet(Planet),
    /// The Earth's Moon.
    Moon,
    /// An asteroid or a comet.
    Orbit(Orbit),
    /// A satellite of the Earth.
    Satellite(Box<Satellite>),
}

/// The position of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Astrometric, from the site.
    pub icrs: Icrs,
    /// From the site to where its light left it, au.
    pub distance_au: f64,
}

impl Body {
    /// The body of this name, in any case, if it is one that is known without elements: the Moon or a planet.
    ///
    /// # Errors
    /// For the Sun, which no telescope here is pointed at, and for the Earth.
    pub fn named(name: &str) -> Result<Option<Self>, SkyError> {
        let name = name.trim().to_lowercase();
        match name.as_str() {
            "sun" | "earth" => Err(SkyError::NoTarget { name }),
            "moon" => Ok(Some(Self::Moon)),
            name => Ok(Planet::named(name).map(Self::Planet)),
        }
    }

    /// Where it stands, as seen by an observer.
    ///
    /// # Errors
    /// When a satellite's elements show that it has come down, or are no longer valid.
    pub fn seen(&self, observer: &Observer) -> Result<Seen, SkyError> {
        let vector = match self {
            Self::Moon => observer.moon_vector(),
            Self::Planet(planet) => {
                observer.arriving(|days| Ok(observer.of_sun(planet.at(observer.tt(days)), days)))?
            }
            Self::Orbit(orbit) => observer.arriving(|days| Ok(observer.of_sun(orbit.at(observer.tt(days)), days)))?,
            Self::Satellite(satellite) => observer.arriving(|days| {
                let place = satellite.at(observer.at().plus_seconds(-days * DAY_S), &observer.teme_axes())?;
                Ok(observer.of_earth(place, days))
            })?,
        };
        Ok(Seen { icrs: Icrs::from_vector(&vector), distance_au: sofars::vm::pm(vector) })
    }
}

impl Observer {
    /// From the site to where light that arrives now left a body, au; `place` returns its place so many days ago.
    fn arriving(&self, place: impl Fn(f64) -> Result<[f64; 3], SkyError>) -> Result<[f64; 3], SkyError> {
        let mut light_days = 0.0;
        let mut from_site = [0.0; 3];
        for _ in 0..=LIGHT_TIMES {
            let there = place(light_days)?;
            from_site = std::array::from_fn(|i| there[i] - self.astrometry.eb[i]);
            light_days = sofars::vm::pm(from_site) * AULT / DAY_S;
        }
        Ok(from_site)
    }

    /// Terrestrial time so many days ago, Julian date in two parts.
    fn tt(&self, days_ago: f64) -> (f64, f64) {
        (self.scales.tt.0, self.scales.tt.1 - days_ago)
    }

    /// A place about the Sun, in the solar system, so many days ago. In the hours that light takes from the outermost
    /// planet the Sun goes straight on.
    fn of_sun(&self, place: [f64; 3], days_ago: f64) -> [f64; 3] {
        std::array::from_fn(|i| {
            let sun = self.earth[0][i] - self.earth_from_sun[0][i];
            let velocity = self.earth[1][i] - self.earth_from_sun[1][i];
            place[i] + sun - velocity * days_ago
        })
    }

    /// A place about the Earth, in the solar system, so many days ago; for seconds of light time.
    fn of_earth(&self, place: [f64; 3], days_ago: f64) -> [f64; 3] {
        std::array::from_fn(|i| place[i] + self.earth[0][i] - self.earth[1][i] * days_ago)
    }
}

#[cfg(test)]
mod tests {
    use units::Angle;

    use super::*;
    use crate::{EarthOrientation, Place, separation};

    fn observer(at: &str) -> Observer {
        let place = Place::new(Angle::from_degrees(-24.6157), Angle::from_degrees(-70.3976), 2518.0).unwrap();
        Observer::new(&place, &EarthOrientation::default(), at.parse().unwrap()).unwrap()
    }

    #[test]
    fn jupiter_and_saturn_met_in_december_2020() {
        // 6.1 arcmin apart about 2020-12-21T18Z.
        let observer = observer("2020-12-21T18:20:00Z");
        let place = |planet| Body::Planet(planet).seen(&observer).unwrap().icrs;
        let apart = separation(&place(Planet::Jupiter), &place(Planet::Saturn)).degrees() * 60.0;
        assert!((apart - 6.1).abs() < 0.1, "{apart} arcmin");
    }

    #[test]
    fn venus_crossed_the_sun_in_june_2012() {
        // Mid-transit 2012-06-06T01:29Z, geocentric 554 arcsec from the Sun's centre; the site moves Venus by half a
        // minute.
        let observer = observer("2012-06-06T01:29:36Z");
        let venus = Body::Planet(Planet::Venus).seen(&observer).unwrap();
        let apart = separation(&venus.icrs, &observer.sun_icrs()).arcseconds();
        assert!((apart - 554.0).abs() < 40.0, "{apart} arcsec");
        assert!((venus.distance_au - 0.2887).abs() < 1e-3, "{}", venus.distance_au);
    }

    #[test]
    fn the_sun_is_no_target_and_a_star_is_no_body() {
        assert!(Body::named("SUN").is_err() && Body::named("earth").is_err());
        assert_eq!(Body::named("Vega").unwrap(), None);
        assert_eq!(Body::named(" Mars ").unwrap(), Some(Body::Planet(Planet::Mars)));
        assert_eq!(Body::named("moon").unwrap(), Some(Body::Moon));
    }
}
