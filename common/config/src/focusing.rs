//! `[focusing]`: when the focus is followed and found anew, and how a focuser's positions are approached.

use serde::Deserialize;

/// From which side a focuser approaches its positions, so that the play of its gears is always taken up in the same way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Approach {
    /// From lower numbers.
    #[default]
    Upward,
    /// From higher numbers.
    Downward,
}

/// What is done about stars that grow wider from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnDrift {
    /// An alert is raised.
    #[default]
    Alert,
    /// The focus is found anew between two frames, where the telescope looks.
    Refocus,
}

/// How the focus is looked after.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Focusing {
    /// What is done about a drift.
    pub on_drift: OnDrift,
    /// Not more often than this, sky minutes.
    pub refocus_after_min: f64,
    /// Exposure time of a run between two frames, s.
    pub refocus_exposure_s: f64,
    /// The focuser follows the temperature between frames once the learned best position is off by this share of the
    /// critical zone, 0 to 1.
    pub follow_share: f64,
}

impl Default for Focusing {
    fn default() -> Self {
        Self { on_drift: OnDrift::Alert, refocus_after_min: 30.0, refocus_exposure_s: 3.0, follow_share: 0.25 }
    }
}

impl Focusing {
    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (key, value, low, high, unit) in [
            ("refocus_after_min", self.refocus_after_min, 1.0, 1440.0, " min"),
            ("refocus_exposure_s", self.refocus_exposure_s, 0.01, 600.0, " s"),
            ("follow_share", self.follow_share, 0.01, 1.0, ""),
        ] {
            if !(low..=high).contains(&value) {
                found.push(format!("focusing.{key} = {value}: expected {low} to {high}{unit}"));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    const SITE: &str = "[observatory]\nsite = \"a\"\ntelescope = \"b\"\nlatitude_deg = 1\nlongitude_deg = 2\n\
                        elevation_m = 3\n";

    #[test]
    fn what_cannot_be_is_refused_with_what_is_expected() {
        let focuser = "[[focuser]]\nname = \"f\"\nserver = \"h:1\"\n";
        for (rest, text) in [
            ("[focusing]\nfollow_share = 0\n".to_owned(), "focusing.follow_share = 0: expected 0.01 to 1"),
            ("[focusing]\non_drift = \"pray\"\n".to_owned(), "expected \"alert\" or \"refocus\""),
            (format!("{focuser}backlash_steps = -1\n"), "focuser \"f\": backlash_steps = -1: expected 0 to"),
            (format!("{focuser}search_steps = 1\n"), "focuser \"f\": search_steps = 1: expected 2 to"),
        ] {
            let refused = crate::parse(&format!("{SITE}{rest}"), Path::new("/x")).unwrap_err().to_string();
            assert!(refused.contains(text), "{refused}");
        }
        let good = format!("{SITE}[focusing]\non_drift = \"refocus\"\n{focuser}approach = \"downward\"\n");
        assert_eq!(crate::parse(&good, Path::new("/x")).unwrap().focusing.on_drift, super::OnDrift::Refocus);
    }
}
