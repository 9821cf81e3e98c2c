//! `[[camera]] flats`: what a good flat of a camera is, and when the twilight sky gives it.

use serde::Deserialize;

/// What a good flat is, and when it is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Flats {
    /// Wanted median of a frame, bias included, ADU; 0.45 of the camera's largest value where absent.
    pub target_adu: Option<f64>,
    /// A frame counts if its median is no further from the target, ADU; 0.2 of the target where absent.
    pub tolerance_adu: Option<f64>,
    /// Median of a frame without light, ADU; a bias frame shows it at the row's begin where absent.
    pub bias_adu: Option<f64>,
    /// Shorter exposures show the shutter, s.
    pub exposure_min_s: f64,
    /// Longer exposures show stars, s.
    pub exposure_max_s: f64,
    /// Sky flats only with the Sun above this, deg.
    pub sun_min_deg: f64,
    /// ... and below this, deg.
    pub sun_max_deg: f64,
    /// Sky flats look so far from one another, so that no star stands on the same pixel twice, arcsec; 0: all look alike.
    pub dither_arcsec: f64,
}

impl Default for Flats {
    fn default() -> Self {
        Self {
            target_adu: None,
            tolerance_adu: None,
            bias_adu: None,
            exposure_min_s: 1.0,
            exposure_max_s: 60.0,
            sun_min_deg: -12.0,
            sun_max_deg: -1.0,
            dither_arcsec: 60.0,
        }
    }
}

impl Flats {
    /// What does not hold, in words that begin with the key.
    pub(crate) fn faults(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (key, value, low, high, unit) in [
            ("target_adu", self.target_adu, 1.0, 1e9, "ADU"),
            ("tolerance_adu", self.tolerance_adu, 1.0, 1e9, "ADU"),
            ("bias_adu", self.bias_adu, 0.0, 1e9, "ADU"),
            ("exposure_min_s", Some(self.exposure_min_s), 0.001, 3600.0, "s"),
            ("exposure_max_s", Some(self.exposure_max_s), 0.001, 3600.0, "s"),
            // the day's sky is no flat field, and nobody opens towards it
            ("sun_min_deg", Some(self.sun_min_deg), -30.0, 0.0, "deg"),
            ("sun_max_deg", Some(self.sun_max_deg), -30.0, 0.0, "deg"),
            ("dither_arcsec", Some(self.dither_arcsec), 0.0, 3600.0, "arcsec"),
        ] {
            if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
                found.push(format!("flats.{key} = {value}: expected {low} to {high} {unit}"));
            }
        }
        let (low, high) = (self.exposure_min_s, self.exposure_max_s);
        if low > high {
            found.push(format!("flats.exposure_min_s = {low}: is more than exposure_max_s = {high}"));
        }
        if self.sun_min_deg >= self.sun_max_deg {
            let (low, high) = (self.sun_min_deg, self.sun_max_deg);
            found.push(format!("flats.sun_min_deg = {low}: expected less than sun_max_deg = {high}"));
        }
        if let Some((target, bias)) = self.target_adu.zip(self.bias_adu).filter(|(target, bias)| target <= bias) {
            found.push(format!("flats.target_adu = {target}: expected more than bias_adu = {bias}"));
        }
        let level = self.target_adu.map(|target| (target, target - self.bias_adu.unwrap_or(0.0)));
        if let Some(((target, above), tolerance)) =
            level.zip(self.tolerance_adu).filter(|((_, above), tolerance)| *above > 0.0 && tolerance >= above)
        {
            let what = format!(
                "expected less than {above}, or a frame without light would count as one of target_adu = {target}"
            );
            found.push(format!("flats.tolerance_adu = {tolerance}: {what}"));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    const HEAD: &str = "[observatory]\nsite = \"s\"\ntelescope = \"t\"\nlatitude_deg = 0\nlongitude_deg = 0\n\
                        elevation_m = 0\n[[camera]]\nname = \"cam\"\nserver = \"a:1\"\n";

    #[test]
    fn a_camera_has_flats_unless_configured_otherwise() {
        let config = crate::parse(HEAD, Path::new("/obs")).unwrap();
        assert_eq!(config.camera[0].flats, super::Flats::default());
        let text = format!("{HEAD}flats = {{ target_adu = 28000, bias_adu = 500, exposure_min_s = 2 }}\n");
        let flats = crate::parse(&text, Path::new("/obs")).unwrap().camera[0].flats;
        assert_eq!((flats.target_adu, flats.bias_adu, flats.exposure_min_s), (Some(28_000.0), Some(500.0), 2.0));
        assert_eq!((flats.exposure_max_s, flats.sun_min_deg), (60.0, -12.0));
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_is_expected() {
        for (flats, message) in [
            ("exposure_min_s = 0", "camera \"cam\": flats.exposure_min_s = 0: expected 0.001 to 3600 s"),
            ("exposure_min_s = 90", "flats.exposure_min_s = 90: is more than exposure_max_s = 60"),
            ("sun_max_deg = 5", "flats.sun_max_deg = 5: expected -30 to 0 deg"),
            ("sun_min_deg = -0.5", "flats.sun_min_deg = -0.5: expected less than sun_max_deg = -1"),
            ("target_adu = 100, bias_adu = 300", "flats.target_adu = 100: expected more than bias_adu = 300"),
            ("target_adu = 30000, tolerance_adu = 40000", "flats.tolerance_adu = 40000: expected less than 30000"),
            ("target_adu = 30000, bias_adu = 500, tolerance_adu = 29500", "expected less than 29500, or a frame"),
            ("tolerance_adu = nan", "flats.tolerance_adu = NaN"),
            ("target = 100", "there is no key \"target\" in [camera.flats]; did you mean \"target_adu\"?"),
        ] {
            let text = format!("{HEAD}flats = {{ {flats} }}\n");
            let refused = crate::parse(&text, Path::new("/obs")).unwrap_err().to_string();
            assert!(refused.contains(message), "{refused}");
        }
    }
}
