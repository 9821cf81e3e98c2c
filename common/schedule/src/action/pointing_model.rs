//! `pointing_model`: learns over the whole sky how the telescope misses where it is sent.

use schemars::JsonSchema;
use serde::Deserialize;
use sky::Observer;

use super::parameters::{Defocus, LONGEST_S, Readout};
use super::{ActionType, Exposures, Needs, Parameters};
use crate::wrong::Wrong;

/// Learns over the whole sky how the telescope misses where it is sent: one frame at each of `n` places.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct PointingModel {
    /// Places over the sky, one frame each.
    #[serde(default = "fifty")]
    #[schemars(range(min = 1, max = MOST), extend("unit" = "places"))]
    pub n: u32,
    /// Exposure time.
    #[serde(default = "three")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub exptime: f64,
    /// Synchronise the mount at each place, so that it builds a model of its own; this node then forgets its own.
    #[serde(default)]
    pub sync: bool,
    /// OBJECT keyword.
    #[serde(default = "title")]
    pub object: String,
    /// Take a dark of the same exposure first, and take it off each frame before it is measured and solved; the files stay
    /// as they are. For cameras with a shutter, whose hot pixels pass for stars.
    #[serde(default)]
    pub dark_subtraction: bool,
    /// Taken from other schedules, without effect: the catalogue is always a local one, that of the configuration.
    #[serde(default, rename = "use_local_db")]
    #[schemars(extend("deprecated" = true))]
    _use_local_db: bool,
    /// Filter; the one in the beam where absent.
    pub filter: Option<String>,
    /// Where the focuser goes first.
    #[serde(flatten)]
    pub defocus: Defocus,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
    /// Folder for the files, inside the folder of images.
    pub dir: Option<String>,
}

fn fifty() -> u32 {
    50
}

fn three() -> f64 {
    3.0
}

fn title() -> String {
    "Pointing Model".to_owned()
}

/// Places of one run, at most; more teach nothing new.
const MOST: u32 = 1000;
/// What a place takes in addition to its frame, for the plan: 30 deg at 3 deg/s, settling, and the solving.
const SLEW_S: f64 = 15.0;

impl ActionType for PointingModel {
    const NAME: &'static str = "pointing_model";
    const EXAMPLE: &'static str = r#"{"n": 50, "exptime": 3, "filter": "V"}"#;
}

impl Parameters for PointingModel {
    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn object(&self) -> Option<&str> {
        Some(&self.object)
    }

    fn frames_wanted(&self) -> Option<u32> {
        Some(self.n)
    }

    fn azimuth_deg(&self, _sky: &Observer) -> Option<f64> {
        // all around
        None
    }

    fn exposures(&self) -> Vec<Exposures> {
        vec![Exposures::of(self.exptime, Some(self.n)).with_extra_s(SLEW_S)]
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_predecessors_rows_are_read_and_nonsense_is_refused() {
        let read = |text: &str| crate::action::read_text::<PointingModel>(text);
        let old = read(
            r#"{"n": 50, "exptime": 3.0, "dark_subtraction": false, "object": "Pointing Model",
            "use_local_db": true, "filter": "r'", "bin": 2}"#,
        )
        .unwrap();
        assert_eq!((old.n, old.exptime, old.readout.bin), (50, 3.0, 2));
        let plain = read("{}").unwrap();
        assert_eq!((plain.n, plain.exptime, plain.sync), (50, 3.0, false));
        for (text, word) in [
            (r#"{"n": 0}"#, "n: expected a whole number, 1 to 1000 places, found 0"),
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"bin": 0}"#, "bin"),
            (r#"{"subframe_width": 10}"#, "subframe_width"),
            (r#"{"focus_shift": 1e300}"#, "focus_shift"),
            (r#"{"points": 3}"#, "points"),
        ] {
            let refused = read(text).unwrap_err();
            assert!(refused.starts_with(word), "{text}: {refused}");
        }
    }
}
