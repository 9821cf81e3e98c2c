//! Transits: stars whose light falls for some time, as when a planet passes before them.

use std::str::FromStr;

use sky::{Icrs, separation};
use units::{Angle, Utc};

use crate::{catalogue, faint};

/// A star that is meant stands no farther from the place that is given, arcsec: half the width of a star.
const NEAR_ARCSEC: f64 = 5.0;
/// How it is written.
const EXPECTED: &str = "expected ra=DEG,dec=DEG,depth-mmag=N,mid=UTC,duration-min=N,ingress-min=N, such as \
     ra=24.3543,dec=-45.6779,depth-mmag=15,mid=2026-11-21T01:20:00Z,duration-min=50,ingress-min=8";

/// A star whose light falls as a trapezoid: along a slope, stays low, and returns along the same slope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transit {
    /// Where the star is.
    pub place: Icrs,
    /// How much light is missing at the bottom, thousandths of a magnitude.
    pub depth_mmag: f64,
    /// The middle of it.
    pub mid: Utc,
    /// From the first loss of light to the last, sky seconds.
    pub duration_s: f64,
    /// From the first loss of light to the bottom, and from the bottom to the end, sky seconds.
    pub ingress_s: f64,
}

impl Transit {
    /// How much fainter a star is at a time, magnitudes; 0 for every other star.
    pub fn dims_mag(&self, star: Icrs, at: Utc) -> f64 {
        if separation(&self.place, &star).arcseconds() > NEAR_ARCSEC {
            return 0.0;
        }
        let inside_s = self.duration_s / 2.0 - at.seconds_since(self.mid).abs();
        let share = if self.ingress_s > 0.0 { inside_s / self.ingress_s } else { f64::from(inside_s > 0.0) };
        self.depth_mmag / 1e3 * share.clamp(0.0, 1.0)
    }

    /// Whether there is a star that it dims, in the sky of a camera with this seed.
    pub(crate) fn has_star(&self, seed: u64) -> bool {
        let (radius, year) =
            (Angle::from_degrees(NEAR_ARCSEC / 3600.0), 2000.0 + (self.mid.jd() - 2_451_545.0) / 365.25);
        let real = catalogue::default().cone(self.place.ra, self.place.dec, radius, f64::INFINITY, year);
        !real.is_empty() || !faint::cone(seed, self.place, radius).is_empty()
    }
}

impl FromStr for Transit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut rest: Vec<(&str, &str)> = Vec::new();
        for pair in text.split(',') {
            let (name, value) = pair.split_once('=').ok_or_else(|| format!("{pair:?} has no '='; {EXPECTED}"))?;
            rest.push((name.trim(), value.trim()));
        }
        let mut take = |name: &str| -> Result<&str, String> {
            let index = rest.iter().position(|pair| pair.0 == name);
            index.map(|index| rest.remove(index).1).ok_or_else(|| format!("{name} is missing; {EXPECTED}"))
        };
        let place =
            Icrs::from_degrees(number("ra", take("ra")?, 0.0, 360.0)?, number("dec", take("dec")?, -90.0, 90.0)?);
        let depth_mmag = number("depth-mmag", take("depth-mmag")?, 0.0, 10_000.0)?;
        let mid = take("mid")?.parse::<Utc>().map_err(|error| format!("mid: {error}"))?;
        let duration_s = 60.0 * number("duration-min", take("duration-min")?, 0.0, 1440.0)?;
        let ingress_s = 60.0 * number("ingress-min", take("ingress-min")?, 0.0, duration_s / 120.0)?;
        match rest.first() {
            Some((name, _)) => Err(format!("{name} is unknown or there twice; {EXPECTED}")),
            None => Ok(Self { place, depth_mmag, mid, duration_s, ingress_s }),
        }
    }
}

fn number(name: &str, text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("{name}={text}: expected a number from {low} to {high}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WASP-18, a bright star with a real planet.
    const WRITTEN: &str =
        "ra=24.3543,dec=-45.6779,depth-mmag=15,mid=2026-11-21T01:20:00Z,duration-min=50,ingress-min=8";

    fn transit() -> Transit {
        WRITTEN.parse().unwrap()
    }

    #[test]
    fn the_light_falls_along_the_slopes_and_is_as_before_outside() {
        let transit = transit();
        let dims = |minutes: f64| 1e3 * transit.dims_mag(transit.place, transit.mid.plus_seconds(60.0 * minutes));
        for (minutes, mmag) in [(0.0, 15.0), (17.0, 15.0), (21.0, 7.5), (24.2, 1.5), (25.0, 0.0), (600.0, 0.0)] {
            assert!((dims(minutes) - mmag).abs() < 1e-9, "{minutes}: {}", dims(minutes));
            assert!((dims(-minutes) - mmag).abs() < 1e-9, "-{minutes}: {}", dims(-minutes));
        }
        let sudden = Transit { ingress_s: 0.0, ..transit };
        let at = |minutes: f64| sudden.dims_mag(sudden.place, sudden.mid.plus_seconds(60.0 * minutes));
        assert_eq!((at(24.9), at(25.1)), (0.015, 0.0));
    }

    #[test]
    fn no_other_star_is_dimmed() {
        let transit = transit();
        let beside = |arcsec: f64| {
            let star = Icrs { dec: transit.place.dec + Angle::from_degrees(arcsec / 3600.0), ..transit.place };
            transit.dims_mag(star, transit.mid)
        };
        assert_eq!((beside(4.0), beside(6.0)), (0.015, 0.0));
    }

    #[test]
    fn a_place_without_a_star_is_noticed() {
        let (here, there) = (transit(), Transit { place: Icrs::from_degrees(24.0, -45.5), ..transit() });
        assert!(here.has_star(1) && !there.has_star(1));
    }

    #[test]
    fn what_is_wrong_with_a_transit_is_in_the_message() {
        for (from, to, expected) in [
            ("ra=24.3543,", "", "ra is missing"),
            ("dec=", "dec=-1", "dec=-1-45.6779: expected a number from -90 to 90"),
            ("depth-mmag=15", "depth-mmag=NaN", "depth-mmag=NaN: expected a number from 0 to 10000"),
            ("2026-11-21T01:20:00Z", "tomorrow", "mid: "),
            ("ingress-min=8", "ingress-min=26", "ingress-min=26: expected a number from 0 to 25"),
            ("ingress-min=8", "ingress-min=8,ra=3", "ra is unknown or there twice"),
            ("ingress-min=8", "ingress-min", "\"ingress-min\" has no '='"),
        ] {
            let error = WRITTEN.replace(from, to).parse::<Transit>().unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
