//! `[guiding]`: how fields are held in their place.

use contract::Name;
use serde::Deserialize;

/// How to guide. Lengths are pixels of the frames that are guided on.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Guiding {
    /// A camera of its own for guiding; absent: the frames of the row's own camera.
    pub camera: Option<Name>,
    /// Exposure of that camera, s.
    pub exposure_s: f64,
    /// Binning of that camera.
    pub bin: u32,
    /// Control of right ascension.
    pub control_ra: GuideControl,
    /// Control of declination.
    pub control_dec: GuideControl,
    /// Gains of right ascension where it is controlled by `pid`.
    pub pid_ra: Gains,
    /// Gains of declination where it is controlled by `pid`.
    pub pid_dec: Gains,
    /// No pulse for less than this, px; absent: for less than the error of the measurement, at most 0.15 px.
    pub dead_band_px: Option<f64>,
    /// Longest pulse; what is longer is cut to this, ms.
    pub longest_pulse_ms: u32,
    /// A shift greater than this, twice in a row, means that the field is lost, px.
    pub cap_px: f64,
    /// Greatest shift that is taken back by pulses when guiding begins, px.
    pub stabilise_cap_px: f64,
    /// Whether declination turns round only when there is reason to (a gear with play).
    pub resist_dec_reversal: bool,
    /// Period of the worm of right ascension, s, where it is known; else it is learned.
    pub worm_period_s: Option<f64>,
    /// How long a known drift is still taken back while no star is seen, sky s.
    pub hold_drift_s: f64,
    /// How long clouds may last before an alert is raised, sky s.
    pub alert_after_s: f64,
    /// Least time between the middles of frames that are guided on, sky s.
    pub interval_min_s: f64,
    /// From where a field was found to where it is held, px along x and y.
    pub hold_offset_px: [f64; 2],
    /// After a flip the mount leaves its declination motor as it was: North pulses go south there.
    pub dec_reversed_after_flip: bool,
    /// What becomes of a row whose field is lost for good.
    pub when_lost: WhenLost,
}

/// How an axis is controlled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuideControl {
    /// By prediction: drift and worm are learned and taken back before they show.
    #[default]
    Predict,
    /// By the predecessor's controller.
    Pid,
}

/// Gains of the predecessor's controller, per frame.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// Of the error itself.
    pub p: f64,
    /// Of the sum of all errors.
    pub i: f64,
    /// Of the change since the last frame.
    pub d: f64,
}

/// What becomes of a row whose field is lost for good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WhenLost {
    /// Frames go on, unguided; an alert is active.
    #[default]
    GoOn,
    /// The row is tried again from its pointing on, as after a fault of the mount.
    Stop,
}

impl Default for Guiding {
    fn default() -> Self {
        Self {
            camera: None,
            exposure_s: 2.0,
            bin: 1,
            control_ra: GuideControl::Predict,
            control_dec: GuideControl::Predict,
            // the predecessor's template
            pid_ra: Gains { p: 0.7, i: 0.02, d: 0.0 },
            pid_dec: Gains { p: 0.5, i: 0.02, d: 0.0 },
            dead_band_px: None,
            longest_pulse_ms: 2500,
            cap_px: 20.0,
            stabilise_cap_px: 40.0,
            resist_dec_reversal: true,
            worm_period_s: None,
            hold_drift_s: 300.0,
            alert_after_s: 900.0,
            interval_min_s: 0.0,
            hold_offset_px: [0.0; 2],
            dec_reversed_after_flip: false,
            when_lost: WhenLost::GoOn,
        }
    }
}

impl Guiding {
    /// What does not hold, in words; `cameras` are those of the file.
    pub(crate) fn faults<'a>(&self, mut cameras: impl Iterator<Item = &'a Name>) -> Vec<String> {
        let mut found = Vec::new();
        if let Some(camera) = self.camera.as_ref().filter(|camera| !cameras.any(|name| name == *camera)) {
            found.push(format!("guiding.camera = \"{camera}\": there is no [[camera]] of this name"));
        }
        let mut within = |key: &str, value: f64, low: f64, high: f64, unit: &str| {
            if !(low..=high).contains(&value) {
                found.push(format!("guiding.{key} = {value}: expected {low} to {high} {unit}"));
            }
        };
        within("exposure_s", self.exposure_s, 0.001, 600.0, "s");
        within("bin", f64::from(self.bin), 1.0, 16.0, "pixels");
        within("dead_band_px", self.dead_band_px.unwrap_or(0.0), 0.0, 10.0, "px");
        within("longest_pulse_ms", f64::from(self.longest_pulse_ms), 10.0, 60_000.0, "ms");
        within("cap_px", self.cap_px, 1.0, 1000.0, "px");
        within("stabilise_cap_px", self.stabilise_cap_px, self.cap_px.clamp(1.0, 1000.0), 1000.0, "px");
        within("worm_period_s", self.worm_period_s.unwrap_or(480.0), 10.0, 86_400.0, "s");
        within("hold_drift_s", self.hold_drift_s, 0.0, 86_400.0, "s");
        within("alert_after_s", self.alert_after_s, 0.0, 86_400.0, "s");
        within("interval_min_s", self.interval_min_s, 0.0, 3600.0, "s");
        let half_px = 0.5 * self.cap_px.clamp(1.0, 1000.0);
        for offset_px in self.hold_offset_px {
            within("hold_offset_px", offset_px, -half_px, half_px, "px: half of cap_px");
        }
        for (key, Gains { p, i, d }) in [("pid_ra", self.pid_ra), ("pid_dec", self.pid_dec)] {
            for (name, gain) in [("p", p), ("i", i), ("d", d)] {
                within(&format!("{key}.{name}"), gain, 0.0, 10.0, "");
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Guiding, String> {
        toml::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn a_block_without_keys_guides_by_prediction_on_the_rows_own_camera() {
        let guiding = read("").unwrap();
        assert_eq!(guiding, Guiding::default());
        assert_eq!((guiding.control_ra, &guiding.camera), (GuideControl::Predict, &None));
        assert!(guiding.faults(std::iter::empty()).is_empty());
    }

    #[test]
    fn what_makes_no_sense_is_reported_with_its_key() {
        let text = "camera = \"none\"\nlongest_pulse_ms = 0\ncap_px = 50.0\npid_ra = { p = nan, i = 0.0, d = 0.0 }";
        let guiding = read(text).unwrap();
        let cameras: Vec<Name> = vec!["main".parse().unwrap()];
        let faults = guiding.faults(cameras.iter());
        let begins = ["guiding.camera", "guiding.longest_pulse_ms", "guiding.stabilise_cap_px", "guiding.pid_ra.p"];
        assert_eq!(faults.len(), begins.len(), "{faults:?}");
        assert!(faults.iter().zip(begins).all(|(fault, begin)| fault.starts_with(begin)), "{faults:?}");
        assert!(read("camra = \"x\"").unwrap_err().contains("unknown field"));
    }
}
