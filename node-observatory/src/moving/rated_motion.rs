//! Where a mount is under the rates that it was given, and which rates keep it on a body; pure.
//!
//! A rate that was the body's own when it was sent would let each error stay: what the path bends away between two
//! rates, and what the body goes while a command is on its way. So new rates lead from where the mount is reckoned to
//! be to where the body will be.

use sky::Rates;
use units::{Angle, Utc};

/// Rates are renewed when keeping them would lead so far from the body, arcsec on the sky.
pub const TRAIL_ARCSEC: f64 = 0.5;

/// A place in the mount's own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Right ascension.
    pub ra: Angle,
    /// Declination.
    pub dec: Angle,
}

impl Spot {
    /// The way to another spot: of the coordinates, arcsec.
    fn way_to(&self, other: &Self) -> [f64; 2] {
        [(other.ra - self.ra).wrapped_signed().arcseconds(), (other.dec - self.dec).arcseconds()]
    }

    /// How far away another spot is, arcsec on the sky; for small distances.
    pub fn apart_arcsec(&self, other: &Self) -> f64 {
        let [east, north] = self.way_to(other);
        (east * other.dec.cos()).hypot(north)
    }

    fn after(&self, rates: Rates, seconds: f64) -> Self {
        let ra = self.ra + Angle::from_arcseconds(rates.ra_arcsec_per_s() * seconds);
        Self { ra, dec: self.dec + Angle::from_arcseconds(rates.dec_arcsec_per_s * seconds) }
    }
}

/// The path of a mount that moves relative to the stars.
#[derive(Debug, Clone, Copy)]
pub struct RatedMotion {
    at: Utc,
    spot: Spot,
    rates: Rates,
    /// When the rates were looked at last; none before the first were given.
    looked: Option<Utc>,
}

impl RatedMotion {
    /// A mount that follows the stars, and was at a spot then.
    pub fn begun(at: Utc, spot: Spot) -> Self {
        Self { at, spot, rates: Rates::default(), looked: None }
    }

    /// Where the mount is reckoned to be.
    pub fn spot(&self, now: Utc) -> Spot {
        self.spot.after(self.rates, now.seconds_since(self.at))
    }

    /// Seconds until the rates are to be looked at again.
    pub fn rests_s(&self, now: Utc, interval_s: f64) -> f64 {
        self.looked.map_or(0.0, |looked| (interval_s - now.seconds_since(looked)).max(0.0))
    }

    /// Looks at the rates: new ones, where the present ones would lead astray until the next look, by which the body
    /// will be at `then`. The first look always gives some.
    pub fn look(&mut self, now: Utc, then: &Spot, interval_s: f64) -> Option<Rates> {
        let is_first = self.looked.replace(now).is_none();
        let astray = self.spot(now.plus_seconds(interval_s)).apart_arcsec(then);
        if !is_first && astray < TRAIL_ARCSEC {
            return None;
        }
        let [ra, dec] = self.spot(now).way_to(then);
        Some(Rates::from_arcsec_per_s(ra / interval_s, dec / interval_s))
    }

    /// The mount goes at these rates from then on.
    pub fn set(&mut self, at: Utc, rates: Rates) {
        (self.spot, self.at, self.rates) = (self.spot(at), at, rates);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start() -> Utc {
        "2026-11-21T03:00:00Z".parse().unwrap()
    }

    /// A body near the seam of right ascension whose speed turns about once in 20 minutes.
    fn body(at: Utc) -> Spot {
        let t = at.seconds_since(start());
        let turn = t * std::f64::consts::TAU / 1200.0;
        let ra = Angle::from_degrees(359.999) + Angle::from_arcseconds(2.0 * t + 100.0 * turn.sin());
        Spot { ra, dec: Angle::from_degrees(60.0) + Angle::from_arcseconds(-0.5 * t + 100.0 * turn.cos()) }
    }

    #[test]
    fn a_bending_path_is_held_although_each_command_comes_late() {
        let mut motion = RatedMotion::begun(start(), body(start()));
        let (mut worst, mut sent) = (0.0_f64, 0);
        for second in 0..3600 {
            let now = start().plus_seconds(f64::from(second));
            if motion.rests_s(now, 10.0) <= 0.0
                && let Some(rates) = motion.look(now, &body(now.plus_seconds(10.0)), 10.0)
            {
                sent += 1;
                motion.set(now.plus_seconds(0.3), rates);
            }
            let now = now.plus_seconds(0.5);
            worst = worst.max(motion.spot(now).apart_arcsec(&body(now)));
        }
        assert!(worst < 1.5, "{worst} arcsec");
        assert!((100..=360).contains(&sent), "{sent} commands in an hour");
    }

    #[test]
    fn rates_that_still_lead_there_are_not_sent_again() {
        let still = |at: Utc| Spot {
            ra: Angle::from_degrees(10.0) + Angle::from_arcseconds(0.5 * at.seconds_since(start())),
            dec: Angle::from_degrees(-20.0),
        };
        let mut motion = RatedMotion::begun(start(), still(start()));
        let first = motion.look(start(), &still(start().plus_seconds(10.0)), 10.0).unwrap();
        assert!((first.ra_arcsec_per_s() - 0.5).abs() < 1e-9 && first.dec_arcsec_per_s.abs() < 1e-9, "{first:?}");
        motion.set(start(), first);
        assert!((motion.rests_s(start().plus_seconds(4.0), 10.0) - 6.0).abs() < 1e-9);
        for tens in 1..100 {
            let now = start().plus_seconds(f64::from(tens) * 10.0);
            assert_eq!(motion.look(now, &still(now.plus_seconds(10.0)), 10.0), None);
        }
    }
}
