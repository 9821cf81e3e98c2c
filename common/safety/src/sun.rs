//! Where the Sun stands by every clock that may be right, and when it will be low enough.

use std::time::Duration;

use sky::{EarthOrientation, Observer, Place, SkyError, next_sun_crossing};
use units::{Angle, Utc};

use super::clocks::Doubt;

/// The time at which it is low is found again after so long, s.
const AGAIN_S: f64 = 3600.0;

/// What the verdict knows of the Sun.
#[derive(Debug, Clone, PartialEq)]
pub struct SunNow {
    /// Its altitude, degrees, or why it is not known.
    pub altitude_deg: Result<f64, String>,
    /// Whose clock that is by, where clocks disagree.
    pub by: Option<String>,
    /// While it is too high: how long until it is low enough, where that can be known.
    pub low_in: Option<Duration>,
}

impl Default for SunNow {
    fn default() -> Self {
        Self { altitude_deg: Err("not computed yet".to_owned()), by: None, low_in: None }
    }
}

/// The Sun of a site.
pub struct Sun {
    place: Result<Place, SkyError>,
    most_deg: Option<f64>,
    /// When it was asked when the Sun will be low, and the answer.
    low: Option<(Utc, Option<Utc>)>,
}

impl Sun {
    /// The Sun over the site of a configuration; above `most_deg` it is too high, degrees.
    pub fn of(config: &config::Observatory, most_deg: Option<f64>) -> Self {
        let place = &config.place;
        let (latitude, longitude) = (Angle::from_degrees(place.latitude_deg), Angle::from_degrees(place.longitude_deg));
        Self { place: Place::new(latitude, longitude, place.elevation_m), most_deg, low: None }
    }

    /// Its highest altitude at the times that it may be.
    pub fn stands(&mut self, utc: Utc, doubts: &[Doubt]) -> SunNow {
        let mut highest = SunNow { altitude_deg: self.altitude_deg(utc), ..SunNow::default() };
        for doubt in doubts.iter().filter(|doubt| doubt.counts) {
            let altitude_deg = self.altitude_deg(utc.plus_seconds(doubt.offset_s));
            match (&highest.altitude_deg, &altitude_deg) {
                (Ok(known), Ok(there)) if there <= known => {}
                (Err(_), _) => {}
                (Ok(_), _) => highest = SunNow { altitude_deg, by: Some(format!("{doubt} and right")), low_in: None },
            }
        }
        let is_high = |most_deg: &f64| highest.altitude_deg.as_ref().is_ok_and(|deg| deg > most_deg);
        if let Some(most_deg) = self.most_deg.filter(is_high)
            && highest.by.is_none()
        {
            highest.low_in = self.low_at(most_deg, utc).map(|at| Duration::from_secs_f64(at.seconds_since(utc)));
        }
        highest
    }

    /// When it will be low enough, after `utc`; none where it does not set.
    fn low_at(&mut self, most_deg: f64, utc: Utc) -> Option<Utc> {
        let holds = |(asked, at): &(Utc, Option<Utc>)| {
            (0.0..AGAIN_S).contains(&utc.seconds_since(*asked)) && at.is_none_or(|at| at > utc)
        };
        if let Some((_, at)) = self.low.filter(holds) {
            return at;
        }
        let place = self.place.as_ref().ok()?;
        let most = Angle::from_degrees(most_deg);
        let at = next_sun_crossing(place, &EarthOrientation::default(), utc, most, false).unwrap_or_default();
        self.low = Some((utc, at));
        at.filter(|at| *at > utc)
    }

    fn altitude_deg(&self, utc: Utc) -> Result<f64, String> {
        let place = self.place.as_ref().map_err(ToString::to_string)?;
        let observer = Observer::new(place, &EarthOrientation::default(), utc).map_err(|error| error.to_string())?;
        Ok(observer.sun().altitude.degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paranal(most_deg: f64) -> Sun {
        let text = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\nelevation_m = 2635\n";
        Sun::of(&config::parse(text, std::path::Path::new("/")).unwrap(), Some(most_deg))
    }

    #[test]
    fn the_sun_stands_as_high_as_by_any_clock_that_may_be_right() {
        let mut sun = paranal(-1.0);
        // Half an hour before sunrise, by a wall clock that was put back by an hour.
        let utc: Utc = "2026-11-21T08:55:00Z".parse().unwrap();
        let doubt = |offset_s, counts| Doubt { clock: "the clock of mount m".to_owned(), offset_s, counts };
        let alone = sun.stands(utc, &[]);
        assert!(alone.altitude_deg.is_ok_and(|deg| deg < -5.0) && alone.by.is_none() && alone.low_in.is_none());
        let doubted = sun.stands(utc, &[doubt(-3600.0, true), doubt(3600.0, true)]);
        assert!(doubted.altitude_deg.is_ok_and(|deg| deg > 0.0));
        assert_eq!(doubted.by.unwrap(), "the clock of mount m is +3600 s off this node's wall clock and right");
        assert_eq!(doubted.low_in, None, "nobody knows how long");
        let no_clock = sun.stands(utc, &[doubt(3600.0, false)]);
        assert!(no_clock.altitude_deg.is_ok_and(|deg| deg < -5.0) && no_clock.by.is_none(), "it does not count");
    }

    #[test]
    fn a_sun_that_is_too_high_shows_when_it_is_low_enough() {
        let mut sun = paranal(-1.0);
        let mut utc: Utc = "2026-11-21T20:00:00Z".parse().unwrap();
        let low_in = sun.stands(utc, &[]).low_in.unwrap();
        let at = utc.plus(low_in);
        // A minute later it is a minute less, also where it was asked before.
        utc = utc.plus_seconds(60.0);
        let left_s = sun.stands(utc, &[]).low_in.unwrap().as_secs_f64();
        assert!((left_s + 60.0 - low_in.as_secs_f64()).abs() < 0.01, "{left_s}");
        assert!(sun.stands(at.plus_seconds(-1.0), &[]).altitude_deg.unwrap() > -1.0);
        let low = sun.stands(at.plus_seconds(1.0), &[]);
        assert!(low.altitude_deg.unwrap() < -1.0 && low.low_in.is_none());
        // A clock that goes back by a day is asked anew.
        utc = "2026-11-20T20:00:00Z".parse().unwrap();
        assert!((sun.stands(utc, &[]).low_in.unwrap().as_secs_f64() - low_in.as_secs_f64()).abs() < 120.0);
    }
}
