//! `calibration`: bias and dark frames, whatever the sky does.

use schemars::JsonSchema;
use serde::Deserialize;
use units::Utc;

use super::parameters::{LONGEST_S, Metadata, Readout};
use super::{ActionType, Exposures, Needs, Parameters};
use crate::shot::{Shot, fits};
use crate::wrong::Wrong;

/// Takes bias and dark frames: so many of each exposure time, with the shutter shut.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Calibration {
    /// Exposure times, one after another; 0 is a bias, anything longer a dark.
    #[schemars(length(min = 1, max = 1000), inner(range(min = 0, max = LONGEST_S)), extend("unit" = "s"))]
    pub exptime: Vec<f64>,
    /// Frames of each exposure time; as many numbers as `exptime` has.
    #[schemars(length(min = 1, max = 1000), inner(range(min = 1, max = 1_000_000)), extend("unit" = "frames"))]
    pub n: Vec<u32>,
    /// Filter to turn to first; the one in the beam where absent.
    pub filter: Option<String>,
    /// Folder for the files, inside the folder of images.
    pub dir: Option<String>,
    /// The next rows need not wait for this one.
    #[serde(default)]
    pub execute_parallel: bool,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    pub metadata: Metadata,
}

impl Calibration {
    /// The frame that follows `taken` others, if there is one.
    pub fn shot(&self, taken: u32) -> Option<Shot> {
        let mut before = 0_u32;
        for (exptime, n) in self.exptime.iter().zip(&self.n) {
            before = before.saturating_add(*n);
            if taken < before {
                let (image_type, word) = if *exptime == 0.0 { ("Bias Frame", "bias") } else { ("Dark Frame", "dark") };
                let (nth, all) = (taken + 1, self.frames());
                let words = format!("exposing {nth} of {all}, {word} {exptime} s");
                return Some(Shot { exposure_s: *exptime, image_type, words });
            }
        }
        None
    }

    /// ... if it fits into the window.
    pub fn shot_within(&self, taken: u32, now: Utc, end: Utc) -> Option<Shot> {
        self.shot(taken).filter(|shot| fits(now, shot.exposure_s, end))
    }

    /// How it went: nothing where all was taken.
    pub fn summary(&self, taken: u32) -> String {
        if taken < self.frames() { format!("the window ended after {taken} frames") } else { String::new() }
    }

    /// Frames of all exposure times.
    pub fn frames(&self) -> u32 {
        self.n.iter().fold(0, |all, n| all.saturating_add(*n))
    }
}

impl ActionType for Calibration {
    const NAME: &'static str = "calibration";
    const EXAMPLE: &'static str = r#"{"exptime": [0, 30], "n": [10, 5]}"#;
}

impl Parameters for Calibration {
    fn check(&self) -> Result<(), Wrong> {
        let (exptime, n) = (self.exptime.len(), self.n.len());
        if exptime != n {
            return Err(Wrong::of("n", format!("exptime has {exptime} and n has {n} values; expected as many")));
        }
        self.readout.check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: false, mount: false, parallel: self.execute_parallel, all_before: false }
    }

    fn frames_wanted(&self) -> Option<u32> {
        Some(self.frames())
    }

    fn exposures(&self) -> Vec<Exposures> {
        self.exptime.iter().zip(&self.n).map(|(exptime, n)| Exposures::of(*exptime, Some(*n))).collect()
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lists_are_worked_through_in_order_from_wherever_a_restart_finds_them() {
        let calibration: Calibration = serde_json::from_str(r#"{"exptime": [0, 5.5], "n": [2, 1]}"#).unwrap();
        let plan: Vec<(f64, &str)> =
            (0..).map_while(|taken| calibration.shot(taken)).map(|s| (s.exposure_s, s.image_type)).collect();
        assert_eq!(plan, [(0.0, "Bias Frame"), (0.0, "Bias Frame"), (5.5, "Dark Frame")]);
        assert_eq!(calibration.shot(2).unwrap().words, "exposing 3 of 3, dark 5.5 s");
        assert_eq!(calibration.frames_wanted(), Some(3));
    }
}
