//! `[pointing]`: how a telescope is brought onto its target, and when that counts as proven.

use serde::Deserialize;

/// What rows with `pointing` ask for, and the pointing model.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pointing {
    /// A telescope that looks so near to its target is on it, arcmin.
    pub threshold_arcmin: f64,
    /// Frames that are taken at most to get there, each but the last followed by a slew.
    pub attempts: u32,
    /// Exposure time of these frames, s; where absent that of the row, between 0.5 and 30 s.
    pub exposure_s: Option<f64>,
    /// A frame of the row that shows itself to be further off does not count, arcmin.
    pub tolerance_arcmin: f64,
    /// What becomes of a row whose pointing cannot be proven.
    pub on_failure: OnFailure,
    /// Wait before the next try when clouds hide the stars, sky s.
    pub clouds_wait_s: f64,
    /// Correct first slews by what was learned.
    pub model: bool,
    /// Largest correction of the model, arcmin; more is not believed.
    pub model_max_arcmin: f64,
}

/// What becomes of a row whose pointing cannot be proven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnFailure {
    /// It rests, and is tried again while its window is open.
    #[default]
    Postpone,
    /// It is given up; the next row begins.
    Skip,
    /// Its frames are taken all the same, and count.
    Observe,
}

impl Default for Pointing {
    /// Threshold and attempts are the predecessor's.
    fn default() -> Self {
        Self {
            threshold_arcmin: 0.1,
            attempts: 4,
            exposure_s: None,
            tolerance_arcmin: 1.0,
            on_failure: OnFailure::Postpone,
            clouds_wait_s: 60.0,
            model: true,
            model_max_arcmin: 60.0,
        }
    }
}

impl Pointing {
    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (key, value, low, high) in [
            ("threshold_arcmin", self.threshold_arcmin, 0.005, 60.0),
            ("attempts", f64::from(self.attempts), 1.0, 20.0),
            ("exposure_s", self.exposure_s.unwrap_or(1.0), 0.001, 600.0),
            ("tolerance_arcmin", self.tolerance_arcmin, 0.005, 600.0),
            ("clouds_wait_s", self.clouds_wait_s, 0.0, 3600.0),
            ("model_max_arcmin", self.model_max_arcmin, 0.0, 600.0),
        ] {
            if !(low..=high).contains(&value) {
                found.push(format!("pointing.{key} = {value}: expected {low} to {high}"));
            }
        }
        // what is out of its range is reported already
        if found.is_empty() && self.tolerance_arcmin < self.threshold_arcmin {
            found.push(format!(
                "pointing.tolerance_arcmin = {}: expected threshold_arcmin = {} or more, or no frame could count",
                self.tolerance_arcmin, self.threshold_arcmin
            ));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn read(block: &str) -> Result<Pointing, String> {
        let text = format!(
            "[observatory]\nsite = \"p\"\ntelescope = \"t\"\nlatitude_deg = 1\nlongitude_deg = 2\nelevation_m = 3\n{block}"
        );
        let read = crate::parse(&text, Path::new("/site"));
        read.map(|observatory| observatory.pointing).map_err(|error| error.to_string())
    }

    #[test]
    fn without_a_word_it_is_a_tenth_of_an_arcminute_in_four_frames() {
        let pointing = read("").unwrap();
        assert_eq!((pointing.threshold_arcmin, pointing.attempts, pointing.on_failure), (0.1, 4, OnFailure::Postpone));
        let pointing = read("[pointing]\nthreshold_arcmin = 0.5\nexposure_s = 5\non_failure = \"observe\"\n").unwrap();
        assert_eq!((pointing.exposure_s, pointing.on_failure), (Some(5.0), OnFailure::Observe));
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_its_key() {
        for (block, word) in [
            ("threshold_arcmin = nan", "threshold_arcmin = NaN"),
            ("attempts = 0", "attempts = 0: expected 1 to 20"),
            ("exposure_s = 0", "exposure_s = 0"),
            ("threshold_arcmin = 2\ntolerance_arcmin = 1", "tolerance_arcmin = 1: expected threshold_arcmin = 2"),
            ("on_failure = \"hope\"", "expected \"postpone\" or"),
            ("treshold_arcmin = 1", "did you mean \"threshold_arcmin\"?"),
        ] {
            let error = read(&format!("[pointing]\n{block}\n")).unwrap_err();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
