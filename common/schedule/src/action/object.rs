//! `object`: points at a target and takes frames until the window ends or there are enough.

use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Body, Horizontal, Icrs, Observer};
use units::Utc;

use super::parameters::{Defocus, LONGEST_S, Metadata, Readout, both, takes_light, yes};
use super::{ActionType, Exposures, Needs, Parameters, Place};
use crate::moving_target::{Asked, Elements};
use crate::shot::{Shot, fits};
use crate::wrong::Wrong;

/// Points at a target and takes frames until the window ends or there are enough. Without a place nothing is opened or
/// slewed, and frames are taken of whatever the telescope looks at.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Object {
    /// OBJECT keyword, and the name under which guiding remembers the field.
    pub object: String,
    /// Exposure time.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub exptime: f64,
    /// Right ascension, ICRS; with `dec`.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    pub ra: Option<f64>,
    /// Declination, ICRS; with `ra`.
    #[schemars(range(min = -90, max = 90), extend("unit" = "deg"))]
    pub dec: Option<f64>,
    /// Altitude, with `az`, instead of `ra` and `dec`; what stands there when the row begins is then tracked.
    #[schemars(range(min = 0, max = 90), extend("unit" = "deg"))]
    pub alt: Option<f64>,
    /// Azimuth from north through east; with `alt`.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    pub az: Option<f64>,
    /// Name of the target: the Moon or a planet, or what Horizons or Sesame know; or "TLE", where `tle` is given.
    pub lookup_name: Option<String>,
    /// Two-line elements of a satellite, joined by a newline.
    pub tle: Option<String>,
    /// Orbital elements of an asteroid or a comet.
    pub elements: Option<Elements>,
    /// Filter; the one in the beam where absent.
    pub filter: Option<String>,
    /// Where the focuser goes first.
    #[serde(flatten)]
    pub defocus: Defocus,
    /// Frames; absent or negative: until the window ends.
    #[schemars(range(min = -1_000_000_000, max = 1_000_000_000), extend("unit" = "frames"))]
    pub n: Option<i64>,
    /// Hold the field with guide pulses, where the row moves the telescope.
    #[serde(default)]
    pub guiding: bool,
    /// Bring the telescope onto the target by solved frames, and count only frames of a row that is proven to be there.
    #[serde(default)]
    pub pointing: bool,
    /// With `pointing`: frames count although it could not be proven where they look.
    #[serde(default)]
    pub unverified: bool,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
    /// Folder for the files, inside the folder of images.
    pub dir: Option<String>,
    /// The next rows need not wait for this one.
    #[serde(default)]
    pub execute_parallel: bool,
    /// Neither open nor slew.
    #[serde(default)]
    pub disable_telescope_movement: bool,
    /// Forget where another row held this field, and hold it where the first frame shows it.
    #[serde(default = "yes")]
    pub reset_guiding_reference: bool,
    /// Of a moving target: slew back onto it after so long, between two frames; 0: never.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub nonsidereal_recenter_interval: Option<f64>,
    /// Of a moving target: the telescope waits so long before it.
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub nonsidereal_start_lead_time_seconds: Option<f64>,
    /// Of a moving target: rates are renewed no more often than this; absent: 10, less where its path bends fast.
    #[schemars(range(min = 0, max = 3600), extend("unit" = "s"))]
    pub nonsidereal_rate_update_interval: Option<f64>,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    pub metadata: Metadata,
}

impl Object {
    /// Whether the row moves the telescope.
    pub fn moves(&self) -> bool {
        let asked = self.asked();
        let is_named = asked.name_to_look_up().is_some() || asked.body().is_ok_and(|body| body.is_some());
        !self.disable_telescope_movement && (asked.has_place || is_named)
    }

    /// What the row says of a target that moves.
    pub fn asked(&self) -> Asked<'_> {
        Asked {
            lookup_name: self.lookup_name.as_deref(),
            tle: self.tle.as_deref(),
            elements: self.elements.as_ref(),
            has_place: self.ra.is_some() || self.alt.is_some(),
        }
    }

    /// The target, if it is one that moves and is known offline.
    pub fn body(&self) -> Option<Body> {
        self.asked().body().ok().flatten()
    }

    /// The frame that follows `taken` others, if it is wanted and fits into the window.
    pub fn shot(&self, taken: u32, now: Utc, end: Utc) -> Option<Shot> {
        let wanted = self.frames_wanted();
        if wanted.is_some_and(|wanted| taken >= wanted) || !fits(now, self.exptime, end) {
            return None;
        }
        let of = wanted.map(|wanted| format!(" of {wanted}")).unwrap_or_default();
        let filter = self.filter.as_ref().map(|filter| format!(", {filter}")).unwrap_or_default();
        let words = format!("exposing {}{of}, {} s{filter}", taken + 1, self.exptime);
        Some(Shot { exposure_s: self.exptime, image_type: "Light Frame", words })
    }

    /// How it went: nothing where all was taken.
    pub fn summary(&self, taken: u32) -> String {
        let is_short = self.frames_wanted().is_some_and(|wanted| taken < wanted);
        if is_short { format!("the window ended after {taken} frames") } else { String::new() }
    }

    /// What was asked for and is not done, in words.
    pub fn not_done(&self) -> Vec<&'static str> {
        let guiding = self.guiding && !self.moves();
        let guiding = guiding.then_some("not guided: the row does not move the telescope");
        let cannot = "pointing is left out: the row has no target, or may not move the telescope";
        let pointing = (self.pointing && !self.moves()).then_some(cannot);
        pointing.into_iter().chain(guiding).collect()
    }
}

impl ActionType for Object {
    const NAME: &'static str = "object";
    const EXAMPLE: &'static str =
        r#"{"object": "TRAPPIST-1", "exptime": 30, "ra": 346.6223, "dec": -5.0413, "filter": "V", "n": 100}"#;
}

impl Parameters for Object {
    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        if self.n == Some(0) {
            return Err(Wrong::of("n", "0 frames; expected 1 or more, or leave n out for as many as the window takes"));
        }
        self.asked().body()?;
        both("ra", self.ra.is_some(), "dec", self.dec.is_some())?;
        both("alt", self.alt.is_some(), "az", self.az.is_some())?;
        if self.ra.is_some() && self.alt.is_some() {
            return Err(Wrong::of("alt", "give ra and dec, or alt and az, not both"));
        }
        Ok(())
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: self.moves(), parallel: self.execute_parallel, all_before: false }
    }

    fn object(&self) -> Option<&str> {
        Some(&self.object)
    }

    fn frames_wanted(&self) -> Option<u32> {
        self.n.and_then(|n| u32::try_from(n).ok())
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        match (self.ra, self.dec) {
            _ if !self.moves() => None,
            _ if self.body().is_some() => {
                let seen = self.body()?.seen(sky).ok()?;
                Some(sky.to_horizontal(&seen.icrs).azimuth.degrees())
            }
            (Some(ra), Some(dec)) => Some(sky.to_horizontal(&Icrs::from_degrees(ra, dec)).azimuth.degrees()),
            _ => self.az,
        }
    }

    fn lookup_name(&self) -> Option<&str> {
        self.asked().name_to_look_up().filter(|_| self.moves())
    }

    fn looks_at(&self) -> Option<Place> {
        if let Some(body) = self.body() {
            return Some(Place::Moving(body));
        }
        match (self.ra, self.dec, self.alt, self.az) {
            (Some(ra), Some(dec), ..) => Some(Place::Icrs(Icrs::from_degrees(ra, dec))),
            (_, _, Some(alt), Some(az)) => Some(Place::Horizontal(Horizontal::from_degrees(alt, az))),
            _ => None,
        }
    }

    fn exposures(&self) -> Vec<Exposures> {
        vec![Exposures::of(self.exptime, self.frames_wanted())]
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(extra: &str) -> Object {
        crate::action::read_text(&format!(r#"{{"object": "x", "exptime": 60{extra}}}"#)).unwrap()
    }

    fn at(text: &str) -> Utc {
        text.parse().unwrap()
    }

    #[test]
    fn frames_are_taken_until_there_are_enough_or_the_window_ends() {
        let (now, end) = (at("2026-11-21T03:00:00Z"), at("2026-11-21T03:30:00Z"));
        let ten = object(r#", "n": 10, "filter": "V""#);
        assert_eq!(ten.shot(2, now, end).unwrap().words, "exposing 3 of 10, 60 s, V");
        assert_eq!(ten.shot(10, now, end), None);
        let endless = object(r#", "n": -1"#);
        assert!(endless.shot(5000, now, end).is_some());
        assert_eq!(endless.shot(5000, at("2026-11-21T03:29:01Z"), end), None);
        let none = crate::action::read_text::<Object>(r#"{"object": "x", "exptime": 60, "n": 0}"#).unwrap_err();
        assert!(none.to_string().contains("0 frames"), "{none}");
        let dark = crate::action::read_text::<Object>(r#"{"object": "x", "exptime": 0}"#).unwrap_err();
        assert!(dark.to_string().contains("takes no light"), "{dark}");
    }

    #[test]
    fn without_a_place_or_without_leave_to_move_the_mount_stays() {
        assert!(object(r#", "ra": 1, "dec": 2"#).needs().mount);
        assert!(!object(r#", "ra": 1, "dec": 2, "disable_telescope_movement": true"#).needs().mount);
        assert!(!object("").needs().mount);
    }

    #[test]
    fn what_is_not_built_is_reported() {
        let still = object(r#", "guiding": true"#);
        assert_eq!(still.not_done(), ["not guided: the row does not move the telescope"]);
        assert_eq!(object(r#", "guiding": true, "ra": 1, "dec": 2"#).not_done().len(), 0);
        assert_eq!(object(r#", "pointing": true"#).not_done().len(), 1);
        assert_eq!(object(r#", "guiding": true, "pointing": true"#).not_done().len(), 2);
        assert_eq!(object(r#", "pointing": true, "ra": 1, "dec": 2"#).not_done().len(), 0);
        assert_eq!(object("").not_done().len(), 0);
    }
}
