//! When the Sun has the right altitude for flats of the sky, where the sky is evenest then, and how fast its light
//! changes.

use sky::{EarthOrientation, Horizontal, Icrs, Place, SkyError, Tangent, next_sun_crossing};
use units::{Angle, Utc};

/// Altitude of the evenest place of the twilight sky, opposite to the Sun, deg (docs/formulae.md, "Twilight").
const ALTITUDE_DEG: f64 = 75.0;
/// Never nearer to the Sun than this, deg; the place opposite to it is some 100 deg away.
const SUN_DISTANCE_DEG: f64 = 60.0;
/// Between two turns of the spiral of dithered places: the golden angle, deg.
const GOLDEN_DEG: f64 = 137.507_764;
/// How much the logarithm of the sky's brightness rises with the Sun, per degree: 1.3 mag, the mean slope in V with the
/// Sun 4 to 8 deg down (Patat et al. 2006, A&A 455, 385). It is used only for the first guess.
const LN_PER_DEG: f64 = 1.2;

/// The Sun's altitudes at which the sky is a flat field, deg, both ends out of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Lower end.
    pub min_deg: f64,
    /// Upper end.
    pub max_deg: f64,
}

impl Window {
    /// Is the Sun in it?
    pub fn has(&self, sun: &Horizontal) -> bool {
        let sun_deg = sun.altitude.degrees();
        self.min_deg < sun_deg && sun_deg < self.max_deg
    }

    /// When the Sun enters it next.
    pub fn opens(&self, (place, earth): (Place, EarthOrientation), now: Utc) -> Result<Option<Utc>, SkyError> {
        let crossing = |deg, rising| next_sun_crossing(&place, &earth, now, Angle::from_degrees(deg), rising);
        let (falls, rises) = (crossing(self.max_deg, false)?, crossing(self.min_deg, true)?);
        Ok(falls.into_iter().chain(rises).min())
    }

    /// The message where the Sun is never in it while a row may run.
    pub fn never(&self) -> String {
        format!(
            "the Sun does not stand between {} and {} deg any more within the row's time",
            self.max_deg, self.min_deg
        )
    }

    /// The message when the Sun leaves it.
    pub fn left(&self) -> String {
        format!("the Sun left {} to {} deg", self.max_deg, self.min_deg)
    }
}

/// The evenest place of the twilight sky.
pub fn antisolar(sun: &Horizontal) -> Horizontal {
    Horizontal::from_degrees(ALTITUDE_DEG, (sun.azimuth.degrees() + 180.0).rem_euclid(360.0))
}

/// Is a direction far enough from the Sun to look there, wherever the Sun stands?
pub fn is_clear_of_sun(direction: &Horizontal, sun: &Horizontal) -> bool {
    direction.separation(sun).degrees() >= SUN_DISTANCE_DEG
}

/// The place of frame `index`, from 0, about `base`: on a spiral, each at least `step_arcsec` from all others.
pub fn dithered(base: &Icrs, index: u32, step_arcsec: f64) -> Icrs {
    let away = Angle::from_degrees(step_arcsec / 3600.0 * f64::from(index).sqrt());
    let (sin, cos) = (GOLDEN_DEG * f64::from(index)).to_radians().sin_cos();
    Tangent::new(*base).unproject(away * sin, away * cos)
}

/// How much the logarithm of the sky's brightness differs between two altitudes of the Sun, deg.
pub fn ln_between(sun_deg: f64, other_deg: f64) -> f64 {
    LN_PER_DEG * (sun_deg - other_deg)
}

/// How fast the logarithm of the sky's brightness changes while the Sun moves at this speed, per s: the first guess.
pub fn slope_per_s(sun_deg_per_s: f64) -> f64 {
    LN_PER_DEG * sun_deg_per_s
}

#[cfg(test)]
mod tests {
    use sky::separation;

    use super::*;

    fn sun(altitude_deg: f64) -> Horizontal {
        Horizontal::from_degrees(altitude_deg, 250.0)
    }

    #[test]
    fn the_window_has_no_ends() {
        let window = Window { min_deg: -12.0, max_deg: -1.0 };
        for (altitude_deg, is_in) in [(-12.0, false), (-11.9, true), (-1.1, true), (-1.0, false), (30.0, false)] {
            assert_eq!(window.has(&sun(altitude_deg)), is_in, "{altitude_deg}");
        }
    }

    #[test]
    fn flats_look_away_from_the_sun() {
        let there = antisolar(&sun(-5.0));
        assert_eq!((there.altitude.degrees(), there.azimuth.degrees()), (75.0, 70.0));
        for altitude_deg in [-12.0, -1.0, 0.0, 20.0] {
            assert!(is_clear_of_sun(&antisolar(&sun(altitude_deg)), &sun(altitude_deg)), "{altitude_deg}");
        }
        assert!(!is_clear_of_sun(&Horizontal::from_degrees(20.0, 250.0), &sun(-5.0)));
        assert!(!is_clear_of_sun(&antisolar(&sun(60.0)), &sun(60.0)), "by day the place opposite is near");
    }

    #[test]
    fn no_two_dithered_places_are_nearer_than_the_step() {
        for base in [Icrs::from_degrees(10.0, -30.0), Icrs::from_degrees(359.999, 89.9)] {
            let places: Vec<Icrs> = (0..60).map(|index| dithered(&base, index, 60.0)).collect();
            for (n, a) in places.iter().enumerate() {
                for b in &places[n + 1..] {
                    let apart = separation(a, b).arcseconds();
                    assert!(apart > 59.9, "{apart}");
                }
            }
            assert!(separation(&places[0], &base).arcseconds() < 1e-6);
            let furthest = separation(&places[59], &base).arcseconds();
            assert!((furthest - 60.0 * 59.0_f64.sqrt()).abs() < 0.1, "{furthest}");
        }
        assert!(
            separation(&dithered(&Icrs::from_degrees(1.0, 2.0), 7, 0.0), &Icrs::from_degrees(1.0, 2.0)).degrees()
                < 1e-9
        );
    }

    #[test]
    fn at_dusk_the_light_falls_by_e_in_some_minutes() {
        // 15 deg per hour, steep as near the equator.
        let slope = slope_per_s(-15.0 / 3600.0);
        assert!(slope < 0.0 && (120.0..400.0).contains(&(-1.0 / slope)), "{slope}");
    }
}
