//! Where a focus run looks: at a place of the row's own, or near the zenith by the catalogue.

use imaging::focus::field::Selection;
use schemars::JsonSchema;
use serde::Deserialize;
use sky::{Icrs, Observer};
use units::Utc;

use crate::action::parameters::{both, yes};
use crate::wrong::Wrong;

/// The choice of a field.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct FocusField {
    /// Right ascension of a field of your own, ICRS, with `dec`; absent: one near the zenith.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    pub ra: Option<f64>,
    /// Declination of the field, ICRS, with `ra`.
    #[schemars(range(min = -90, max = 90), extend("unit" = "deg"))]
    pub dec: Option<f64>,
    /// Farthest distance of the field from the zenith; by `airmass_threshold` where absent.
    #[schemars(range(min = 0, max = 85), extend("unit" = "deg"))]
    pub maximal_zenith_angle: Option<f64>,
    /// Greatest airmass of the field; 1.01 is 8 deg from the zenith.
    #[serde(default = "airmass")]
    #[schemars(range(min = 1, max = 10), extend("unit" = "airmass"))]
    pub airmass_threshold: f64,
    /// Brightest and faintest G magnitude of stars that count.
    #[serde(default = "magnitudes")]
    #[schemars(inner(range(min = -30, max = 30)), extend("unit" = "mag"))]
    pub g_mag_range: [f64; 2],
    /// Taken from other schedules, without effect: catalogues have one magnitude, which is taken for G.
    #[serde(default, rename = "j_mag_range")]
    #[schemars(inner(range(min = -30, max = 30)), extend("unit" = "mag", "deprecated" = true))]
    _j_mag_range: Option<[f64; 2]>,
    /// Field of view along declination; 0: that of the camera.
    #[serde(default)]
    #[schemars(range(min = 0, max = 90), extend("unit" = "deg"))]
    pub fov_height: f64,
    /// Field of view along right ascension; 0: that of the camera.
    #[serde(default)]
    #[schemars(range(min = 0, max = 90), extend("unit" = "deg"))]
    pub fov_width: f64,
    /// `single`: the star nearest to the zenith that is alone in the field; `maximal`: the most stars; `any`: the nearest
    /// star.
    #[serde(default = "single")]
    #[schemars(extend("enum" = ["single", "maximal", "any"]))]
    pub selection_method: String,
    /// Choose the field from the catalogue; false: the zenith itself.
    #[serde(default = "yes")]
    pub use_gaia: bool,
    /// When the zenith counts, UTC; now where absent.
    #[schemars(with = "Option<String>", extend("format" = "date-time"))]
    pub observation_time: Option<Utc>,
    /// With more stars than this only the inner half of the distance is looked at, again and again.
    #[serde(default = "many")]
    #[schemars(range(min = 1, max = 1_000_000_000), extend("unit" = "stars"))]
    pub maximal_number_of_stars: usize,
}

fn airmass() -> f64 {
    1.01
}

fn magnitudes() -> [f64; 2] {
    [0.0, 10.0]
}

fn single() -> String {
    "single".to_owned()
}

fn many() -> usize {
    100_000
}

impl FocusField {
    /// Refuses half a place, and magnitudes the wrong way round.
    pub fn check(&self) -> Result<(), Wrong> {
        self.selection()?;
        both("ra", self.ra.is_some(), "dec", self.dec.is_some())?;
        let [brightest, faintest] = self.g_mag_range;
        if brightest > faintest {
            let what = format!("expected [brightest, faintest], found [{brightest}, {faintest}]");
            return Err(Wrong::of("g_mag_range", what));
        }
        Ok(())
    }

    /// How the field is chosen from the catalogue.
    ///
    /// # Errors
    /// No such method.
    pub fn selection(&self) -> Result<Selection, Wrong> {
        let method = &self.selection_method;
        let unknown = || Wrong::of("selection_method", format!("expected single, maximal or any, found {method:?}"));
        Selection::named(method).ok_or_else(unknown)
    }

    /// The field that the row names.
    pub fn place(&self) -> Option<Icrs> {
        let (ra, dec) = self.ra.zip(self.dec)?;
        Some(Icrs::from_degrees(ra, dec))
    }

    /// Degrees from north through east; near the zenith a direction says nothing.
    pub fn azimuth_deg(&self, sky: &Observer) -> Option<f64> {
        Some(sky.to_horizontal(&self.place()?).azimuth.degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Autofocus;
    use super::*;
    use crate::action::read_text;

    #[test]
    fn the_way_to_choose_is_taken_in_any_case() {
        let selection = |text: &str| read_text::<Autofocus>(text).unwrap().field.selection().unwrap();
        assert_eq!(selection("{}"), Selection::Single);
        assert_eq!(selection(r#"{"selection_method": "MAXIMAL"}"#), Selection::Maximal);
    }
}
