//! Names of targets that were looked up online, and the position of each of them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sky::moving::{Orbit, Shape, When};
use sky::{Body, Icrs};
use units::{Angle, Utc};

/// J2000, to which Sesame's places refer, s since 1970.
const J2000_S: f64 = 946_728_000.0;
const YEAR_S: f64 = 365.25 * 86_400.0;
/// Osculating elements are asked for anew when their epoch is further away than this, days: small bodies then stand
/// within an arcsecond, but for those that pass the Earth.
const FRESH_DAYS: f64 = 3.0;
/// Older ones than this are not observed by, days.
const USABLE_DAYS: f64 = 30.0;

/// The target that a name means.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Meaning {
    /// A star, or another target that does not move among the stars.
    Fixed {
        /// ICRS degrees, epoch J2000.
        ra_deg: f64,
        /// ICRS degrees, epoch J2000.
        dec_deg: f64,
        /// Proper motion in right ascension times the declination's cosine, mas per year.
        pm_ra_mas: f64,
        /// Proper motion in declination, mas per year.
        pm_dec_mas: f64,
    },
    /// A small body, by osculating elements about the Sun against ecliptic and equinox of J2000.
    Orbit {
        /// Perihelion distance, au.
        q_au: f64,
        /// Eccentricity.
        e: f64,
        /// Inclination, degrees.
        i_deg: f64,
        /// Longitude of the ascending node, degrees.
        node_deg: f64,
        /// Argument of the perihelion, degrees.
        peri_deg: f64,
        /// Passage of the perihelion, Julian date, TDB.
        tp_jd: f64,
        /// The epoch at which they are true, Julian date, TDB.
        epoch_jd: f64,
    },
}

/// The position of a named target.
#[derive(Debug, Clone, PartialEq)]
pub enum Found {
    /// At this place.
    Place(Icrs),
    /// At the position of this body.
    Body(Body),
}

impl Meaning {
    fn found(&self, at: Utc) -> Result<Found, String> {
        match *self {
            Self::Fixed { ra_deg, dec_deg, pm_ra_mas, pm_dec_mas } => {
                let years = (at.seconds() - J2000_S) / YEAR_S;
                let dec = dec_deg + pm_dec_mas * years / 3.6e6;
                let ra = ra_deg + pm_ra_mas * years / 3.6e6 / dec_deg.to_radians().cos().max(1e-6);
                let place = Icrs::from_degrees(ra, dec).checked().map_err(|error| error.to_string())?;
                Ok(Found::Place(place))
            }
            Self::Orbit { q_au, e, i_deg, node_deg, peri_deg, tp_jd, .. } => {
                let old_days = self.old_days(at);
                if old_days > USABLE_DAYS {
                    return Err(format!(
                        "its elements are {old_days:.0} days old, and newer ones could not be fetched"
                    ));
                }
                let angles = [i_deg, node_deg, peri_deg].map(Angle::from_degrees);
                let orbit = Orbit::new(
                    Shape::Perihelion(q_au),
                    e,
                    (angles[0], angles[1], angles[2]),
                    When::PerihelionAt(tp_jd),
                );
                orbit.map(|orbit| Found::Body(Body::Orbit(orbit))).map_err(|error| error.to_string())
            }
        }
    }

    /// The distance of its epoch, days; 0 for a target that does not age.
    fn old_days(&self, at: Utc) -> f64 {
        match self {
            Self::Fixed { .. } => 0.0,
            Self::Orbit { epoch_jd, .. } => (at.jd() - epoch_jd).abs(),
        }
    }
}

/// All that is known of names.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct KnownNames {
    /// By [`key`].
    pub found: BTreeMap<String, Meaning>,
    /// Why others are not known, since this node's boot.
    #[serde(skip)]
    pub failed: BTreeMap<String, String>,
}

impl KnownNames {
    /// The file of the names that were looked up.
    pub fn path(config: &config::Observatory) -> PathBuf {
        config.folders.data.join(format!("names-{}.json", config.place.telescope))
    }

    /// The names that were looked up earlier; none where the file is absent or cannot be read.
    pub fn read(path: &Path) -> Self {
        let text = match std::fs::read(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Self::default(),
            text => text,
        };
        let read = text.map_err(|error| error.to_string());
        let read = read.and_then(|text| serde_json::from_slice(&text).map_err(|error| error.to_string()));
        read.unwrap_or_else(|error| {
            tracing::warn!(path = %path.display(), error, "where named targets stand cannot be read; it begins anew");
            Self::default()
        })
    }

    /// The position of a named target at an instant.
    ///
    /// # Errors
    /// In words, when that is not known yet.
    pub fn find(&self, name: &str, at: Utc) -> Result<Found, String> {
        let key = key(name);
        let failed = self.failed.get(&key).map_or("it has not been looked up yet", String::as_str);
        let found = self.found.get(&key).map_or_else(|| Err(failed.to_owned()), |meaning| meaning.found(at));
        found.map_err(|why| format!("where {name:?} stands is not known: {why}"))
    }

    /// Has a name to be looked up, for a row of that time?
    pub fn wants(&self, name: &str, at: Utc) -> bool {
        self.found.get(&key(name)).is_none_or(|meaning| meaning.old_days(at) > FRESH_DAYS)
    }
}

/// The form in which names are compared: without regard to case and space around them.
pub fn key(name: &str) -> String {
    name.trim().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn a_star_is_where_its_proper_motion_has_brought_it() {
        // Barnard's star: 10.3 arcsec per year to the north.
        let star = Meaning::Fixed { ra_deg: 269.45, dec_deg: 4.69, pm_ra_mas: -801.55, pm_dec_mas: 10_362.39 };
        let known = KnownNames { found: BTreeMap::from([(key("Barnard's star"), star)]), failed: BTreeMap::new() };
        let Found::Place(place) = known.find(" BARNARD'S star", at("2026-11-21T12:00:00Z")).unwrap() else { panic!() };
        assert!((place.dec.degrees() - 4.69 - 26.89 * 10.36239 / 3600.0).abs() < 1e-4, "{place:?}");
    }

    #[test]
    fn what_is_not_known_gives_the_reason() {
        let old = Meaning::Orbit {
            q_au: 2.55,
            e: 0.08,
            i_deg: 10.6,
            node_deg: 80.3,
            peri_deg: 73.6,
            tp_jd: 2_459_920.5,
            epoch_jd: 2_459_740.5,
        };
        let known = KnownNames {
            found: BTreeMap::from([(key("Ceres"), old)]),
            failed: BTreeMap::from([(key("Nonsuch"), "no service knows it".to_owned())]),
        };
        let now = at("2026-11-21T12:00:00Z");
        for (name, why) in [("Ceres", "days old"), ("nonsuch", "no service knows it"), ("Vega", "not been looked up")] {
            let words = known.find(name, now).unwrap_err();
            assert!(words.contains(why), "{words}");
        }
        assert!(known.wants("Ceres", now) && !known.wants("Ceres", at("2022-06-11T00:00:00Z")));
        assert!(matches!(known.find("Ceres", at("2022-06-11T00:00:00Z")), Ok(Found::Body(_))));
    }
}
