//! `autofocus`: finds the focus with a run of frames near the zenith, and keeps it.

pub mod field;
pub mod search;

use schemars::JsonSchema;
use serde::Deserialize;
use sky::Observer;

use self::field::FocusField;
use self::search::Search;
use super::parameters::{LONGEST_S, Readout, takes_light, yes};
use super::{ActionType, Exposures, Needs, Parameters, Place};
use crate::wrong::Wrong;

/// Finds the focus with a run of frames near the zenith, and keeps it: every later row begins there.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Autofocus {
    /// Exposure time.
    #[serde(default = "three")]
    #[schemars(range(min = 0, max = LONGEST_S), extend("unit" = "s"))]
    pub exptime: f64,
    /// Halve the exposure while one of the five brightest stars is saturated: five times, not below 0.1 s.
    #[serde(default)]
    pub reduce_exposure_time: bool,
    /// Filter; its offset is taken off what is kept. The one in the beam where absent.
    pub filter: Option<String>,
    /// How it searches.
    #[serde(flatten)]
    pub search: Search,
    /// Width of the stars at the begin; found out where absent.
    #[schemars(range(min = 0.5, max = 500), extend("unit" = "px"))]
    pub fwhm: Option<f64>,
    /// Keep what was found as the best focus; false: look, but keep nothing.
    #[serde(default = "yes")]
    pub save: bool,
    /// Folder for the files, inside the folder of images.
    pub save_path: Option<String>,
    /// Where it looks.
    #[serde(flatten)]
    pub field: FocusField,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
}

fn three() -> f64 {
    3.0
}

impl ActionType for Autofocus {
    const NAME: &'static str = "autofocus";
    const EXAMPLE: &'static str = r#"{"exptime": 3, "filter": "V", "search_range": 500, "search_range_is_relative": true,
        "n_steps": [9, 7], "selection_method": "maximal"}"#;
}

impl Parameters for Autofocus {
    fn check(&self) -> Result<(), Wrong> {
        self.readout.check()?;
        takes_light(self.exptime)?;
        self.search.check()?;
        self.field.check()
    }

    fn needs(&self) -> Needs {
        Needs { safe: true, mount: true, parallel: false, all_before: false }
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        self.field.azimuth_deg(sky)
    }

    fn looks_at(&self) -> Option<Place> {
        self.field.place().map(Place::Icrs)
    }

    fn exposures(&self) -> Vec<Exposures> {
        let ((coarse, fine), (first, closer)) = (self.search.positions(), self.search.frames());
        let look = |(positions, frames): (usize, u32)| {
            let all = u32::try_from(positions).unwrap_or(u32::MAX).saturating_mul(frames);
            Exposures::of(self.exptime, Some(all))
        };
        [(coarse, first), (fine, closer)].map(look).to_vec()
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.as_deref().into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::action::read_text;

    #[test]
    fn the_predecessors_rows_are_read_with_their_defaults() {
        let plain = read_text::<Autofocus>("{}").unwrap();
        assert_eq!((plain.exptime, plain.readout.bin, plain.save), (3.0, 1, true));
        let all = r#"{"exptime": 2, "filter": "V", "bin": 2, "reduce_exposure_time": true, "search_range": [8000, 12000],
            "search_range_is_relative": false, "n_steps": [30, 20], "n_exposures": 2, "decrease_search_range": true,
            "star_find_threshold": 5.0, "fwhm": 8, "percent_to_cut": 60, "focus_measure_operator": "HFR",
            "extremum_estimator": "LOWESS", "extremum_estimator_kwargs": {"frac": 0.5},
            "secondary_focus_measure_operators": ["fft", "normalized_variance", "tenengrad"], "save": false,
            "maximal_zenith_angle": 10, "airmass_threshold": 1.01, "g_mag_range": [0, 10], "j_mag_range": [0, 10],
            "fov_height": 0.2, "fov_width": 0.2, "selection_method": "MAXIMAL", "use_gaia": true,
            "observation_time": "2026-11-21T03:00:00Z", "maximal_number_of_stars": 1000, "subframe_width": 512,
            "subframe_height": 512}"#;
        let all = read_text::<Autofocus>(all).unwrap();
        assert_eq!((all.exptime, all.readout.bin, all.save, all.fwhm), (2.0, 2, false, Some(8.0)));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_the_name_of_its_parameter() {
        for (text, parameter) in [
            (r#"{"exptime": -1}"#, "exptime"),
            (r#"{"ra": 10}"#, "ra"),
            (r#"{"search_range": 300}"#, "search_range"),
            (r#"{"search_range": "wide"}"#, "search_range"),
            (r#"{"n_steps": [4, 9]}"#, "n_steps"),
            (r#"{"n_steps": 4}"#, "n_steps"),
            (r#"{"n_steps": []}"#, "n_steps"),
            (r#"{"n_exposures": 0}"#, "n_exposures"),
            (r#"{"percent_to_cut": 0}"#, "percent_to_cut"),
            (r#"{"focus_measure_operator": "sharpness"}"#, "focus_measure_operator"),
            (r#"{"extremum_estimator": "guess"}"#, "extremum_estimator"),
            (r#"{"secondary_focus_measure_operators": ["x"]}"#, "secondary_focus_measure_operators"),
            (r#"{"selection_method": "best"}"#, "selection_method"),
            (r#"{"g_mag_range": [10, 5]}"#, "g_mag_range"),
            (r#"{"airmass_threshold": 0.5}"#, "airmass_threshold"),
            (r#"{"observation_time": "tonight"}"#, "observation_time"),
            (r#"{"filtre": "V"}"#, "filtre"),
        ] {
            let refused = read_text::<Autofocus>(text).err().unwrap();
            assert!(refused.starts_with(&format!("{parameter}: ")), "{text}: {refused}");
        }
    }
}
