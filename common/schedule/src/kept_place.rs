//! Decides whether a mount has left the place that it was sent to, by its own coordinates: some mounts stop and go on to
//! say that they track.

use sky::{Icrs, separation};
use units::Utc;

/// A mount that nobody guides reports a place within this, arcsec.
const KEPT_ARCSEC: f64 = 60.0;
/// Guide pulses may bring a mount so far, arcsec; a mount that stands is there within half a minute.
const GUIDED_ARCSEC: f64 = 300.0;
/// A mount with a model of its own, or one that is guided along with a bad polar axis, drifts no faster, arcsec per s: a
/// mount that stands, 15.
const DRIFT_ARCSEC_PER_S: f64 = 0.25;

/// The place that a mount reported when a slew had ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeptPlace {
    reported: Icrs,
    since: Utc,
}

impl KeptPlace {
    /// A mount reported this place then, in its own frame, degrees.
    pub fn new(ra_deg: f64, dec_deg: f64, since: Utc) -> Self {
        Self { reported: Icrs::from_degrees(ra_deg, dec_deg), since }
    }

    /// How far the mount is from there, arcmin, if it has left the place. Coordinates that are no numbers show nothing:
    /// then only frames can.
    pub fn left_by_arcmin(&self, ra_deg: f64, dec_deg: f64, now: Utc, is_guided: bool) -> Option<f64> {
        let kept_arcsec = if is_guided { GUIDED_ARCSEC } else { KEPT_ARCSEC };
        let most = kept_arcsec + DRIFT_ARCSEC_PER_S * now.seconds_since(self.since).max(0.0);
        let off = separation(&self.reported, &Icrs::from_degrees(ra_deg, dec_deg)).arcseconds();
        (off > most).then_some(off / 60.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mount_that_stands_has_left_its_place_within_a_frame_and_one_that_tracks_never() {
        let at = |s: f64| Utc::from_seconds(1_795_228_200.0 + s);
        let place = KeptPlace::new(359.999, -30.0, at(0.0));
        // What it reports after so many seconds: right ascension and declination have changed by so much, arcsec.
        for (name, seconds, ra_arcsec, dec_arcsec, is_guided, has_left) in [
            ("tracks", 36_000.0, 0.0, 0.0, false, false),
            ("a reading of whole seconds of right ascension", 10.0, 15.0, 0.0, false, false),
            ("stands for 3 s", 3.0, 45.0, 0.0, false, false),
            ("stands for 10 s", 10.0, 150.0, 0.0, false, true),
            ("stands for 10 s, guided", 10.0, 150.0, 0.0, true, false),
            ("stands for 30 s, guided", 30.0, 450.0, 0.0, true, true),
            ("follows its own model for an hour", 3600.0, 300.0, 200.0, false, false),
            ("was moved north by hand", 5.0, 0.0, 600.0, false, true),
            ("reports no number", 5.0, f64::NAN, 0.0, false, false),
        ] {
            let left =
                place.left_by_arcmin(359.999 + ra_arcsec / 3600.0, -30.0 + dec_arcsec / 3600.0, at(seconds), is_guided);
            assert_eq!(left.is_some(), has_left, "{name}: {left:?}");
        }
    }
}
