//! `flats`: flat fields of the twilight sky, or of a panel.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sky::Observer;

use super::parameters::{Metadata, Readout};
use super::{ActionType, Needs, Parameters};
use crate::flats::filter::Filter;
use crate::flats::order::Order;
use crate::flats::twilight::antisolar;
use crate::wrong::Wrong;

/// Where the light comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FlatsSource {
    /// The twilight sky.
    #[default]
    Sky,
    /// The lamp of the camera's CoverCalibrator.
    Panel,
}

/// Takes flat fields of the twilight sky, or of a panel: so many of each filter, at the level that the camera's `flats` asks for.
/// See [flats.md](flats.md).
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Flats {
    /// Filters; absent: the one in the beam, with one number of frames.
    #[schemars(length(min = 1, max = 100))]
    pub filter: Option<Vec<String>>,
    /// Frames that count, of each filter; as many numbers as `filter` has.
    #[schemars(length(min = 1, max = 100), inner(range(min = 1, max = 1_000_000)), extend("unit" = "frames"))]
    pub n: Vec<u32>,
    /// Where the light comes from.
    #[serde(default)]
    pub source: FlatsSource,
    /// In which order the filters are taken from the sky; a panel's are taken as listed.
    #[serde(default)]
    pub order: Order,
    /// Brightness of the panel; found where absent.
    #[schemars(range(min = 1, max = 1_000_000_000), extend("unit" = "of the device"))]
    pub brightness: Option<i64>,
    /// Folder for the files, inside the folder of images.
    pub dir: Option<String>,
    /// The next rows need not wait; not with a panel, which keeps its telescope shut.
    #[serde(default)]
    pub execute_parallel: bool,
    /// Neither open nor slew: flats of wherever the telescope looks.
    #[serde(default)]
    pub disable_telescope_movement: bool,
    /// How the sensor is read.
    #[serde(flatten)]
    pub readout: Readout,
    /// For `action_metadata` rows of the FITS-header table.
    #[serde(default)]
    pub metadata: Metadata,
}

impl Flats {
    /// Whether the row moves the telescope.
    pub fn moves(&self) -> bool {
        self.source == FlatsSource::Sky && !self.disable_telescope_movement
    }

    /// The filters with the frames that are wanted of each.
    pub fn wanted(&self) -> Vec<Filter> {
        match &self.filter {
            Some(names) => names.iter().zip(&self.n).map(|(name, n)| Filter::new(Some(name.clone()), *n)).collect(),
            None => self.n.iter().map(|n| Filter::new(None, *n)).collect(),
        }
    }
}

impl ActionType for Flats {
    const NAME: &'static str = "flats";
    const EXAMPLE: &'static str = r#"{"filter": ["B", "V", "R"], "n": [10, 10, 10]}"#;
}

impl Parameters for Flats {
    fn check(&self) -> Result<(), Wrong> {
        match (&self.filter, self.n.len()) {
            (Some(filters), n) if filters.len() != n => {
                let filters = filters.len();
                return Err(Wrong::of("n", format!("filter has {filters} and n has {n} values; expected as many")));
            }
            (None, n) if n != 1 => {
                return Err(Wrong::of("n", format!("expected one number where no filter is named, found {n}")));
            }
            _ => {}
        }
        if self.source == FlatsSource::Panel && self.execute_parallel {
            return Err(Wrong::of("execute_parallel", "not with source = \"panel\", which keeps its telescope shut"));
        }
        if self.source == FlatsSource::Sky && self.brightness.is_some() {
            return Err(Wrong::of("brightness", "the sky has none; give source = \"panel\" too"));
        }
        self.readout.check()
    }

    fn needs(&self) -> Needs {
        // the cover is the telescope's: nobody else uses it meanwhile
        let mount = self.moves() || self.source == FlatsSource::Panel;
        Needs { safe: self.source == FlatsSource::Sky, mount, parallel: self.execute_parallel, all_before: false }
    }

    fn frames_wanted(&self) -> Option<u32> {
        Some(self.n.iter().fold(0, |all, n| all.saturating_add(*n)))
    }

    fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        self.moves().then(|| antisolar(&sky.sun()).azimuth.degrees())
    }

    fn filters(&self) -> Vec<&str> {
        self.filter.iter().flatten().map(String::as_str).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Flats, String> {
        crate::action::read_text(text)
    }

    #[test]
    fn the_predecessors_rows_are_read() {
        let flats = read(
            r#"{"filter": ["u", "I+z"], "n": [3, 5], "dir": "x", "bin": 2, "execute_parallel": true,
            "disable_telescope_movement": true, "subframe_width": 512, "subframe_height": 512, "metadata": {"a": 1}}"#,
        )
        .unwrap();
        assert_eq!((flats.frames_wanted(), flats.order, flats.moves()), (Some(8), Order::ByNeed, false));
        assert_eq!(flats.wanted()[1].name.as_deref(), Some("I+z"));
        assert_eq!(read(r#"{"n": [4]}"#).unwrap().wanted()[0].wanted, 4);
    }

    #[test]
    fn the_sky_must_be_safe_for_flats_of_it_and_need_not_be_for_a_panel() {
        let needs = |text| read(text).unwrap().needs();
        let sky = needs(r#"{"filter": ["B"], "n": [1]}"#);
        assert!(sky.safe && sky.mount && !sky.parallel);
        let panel = needs(r#"{"filter": ["B"], "n": [1], "source": "panel"}"#);
        assert!(!panel.safe && panel.mount);
        let still = needs(r#"{"filter": ["B"], "n": [1], "disable_telescope_movement": true}"#);
        assert!(still.safe && !still.mount);
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_the_name_of_its_parameter() {
        for (text, parameter) in [
            (r#"{"filter": [], "n": []}"#, "filter"),
            (r#"{"filter": ["B", "V"], "n": [1]}"#, "n"),
            (r#"{"n": [1, 2]}"#, "n"),
            (r#"{"n": [1], "brightness": 3}"#, "brightness"),
            (r#"{"n": [1], "source": "panel", "brightness": 0}"#, "brightness"),
            (r#"{"n": [1], "source": "panel", "execute_parallel": true}"#, "execute_parallel"),
            (r#"{"n": [1], "bin": 0}"#, "bin"),
            (r#"{"n": [1], "subframe_width": 3}"#, "subframe_width"),
        ] {
            let refused = read(text).unwrap_err();
            assert!(refused.starts_with(parameter), "{text}: {refused}");
        }
        assert!(read(r#"{"n": [1], "source": "moon"}"#).unwrap_err().contains("moon"));
        assert!(read(r#"{"filters": ["B"], "n": [1]}"#).unwrap_err().contains("filters"));
    }
}
