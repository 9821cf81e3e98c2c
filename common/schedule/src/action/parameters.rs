//! Parameters that several actions share; they are flattened into the actions that have them.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::wrong::Wrong;

/// Values for `action_metadata` rows of the FITS-header table; numbers and booleans are taken as their text.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Metadata(BTreeMap<String, Value>);

impl Metadata {
    /// As texts.
    pub fn texts(&self) -> BTreeMap<String, String> {
        let text = |value: &Value| match value {
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        self.0.iter().map(|(key, value)| (key.clone(), text(value))).collect()
    }
}

/// How the sensor is read: its binning, and a part of it as schedules ask for it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
pub struct Readout {
    /// Binning of both axes.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 16), extend("unit" = "px"))]
    pub bin: u32,
    /// Columns of a part of the sensor, with `subframe_height`; the whole sensor where absent.
    #[schemars(range(min = 1, max = 1_000_000), extend("unit" = "binned px"))]
    pub subframe_width: Option<u32>,
    /// Rows of a part of the sensor, with `subframe_width`.
    #[schemars(range(min = 1, max = 1_000_000), extend("unit" = "binned px"))]
    pub subframe_height: Option<u32>,
    /// Middle of the part: 0 is the left edge, 1 the right one.
    #[serde(default = "half")]
    #[schemars(range(min = 0, max = 1), extend("unit" = "of the width"))]
    pub subframe_center_x: f64,
    /// Middle of the part: 0 is the first row's edge, 1 the last one's.
    #[serde(default = "half")]
    #[schemars(range(min = 0, max = 1), extend("unit" = "of the height"))]
    pub subframe_center_y: f64,
}

/// Refuses an exposure that takes no light.
pub fn takes_light(exptime: f64) -> Result<(), Wrong> {
    if exptime > 0.0 { Ok(()) } else { Err(Wrong::of("exptime", "0 s takes no light; expected more than 0 s")) }
}

impl Readout {
    /// Refuses half a size.
    pub fn check(&self) -> Result<(), Wrong> {
        both("subframe_width", self.subframe_width.is_some(), "subframe_height", self.subframe_height.is_some())
    }
}

/// What a row asks of the focus, steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FocusWanted {
    /// An absolute position; wins over the shift.
    pub position: Option<i64>,
    /// From the best position.
    pub shift: Option<i64>,
    /// Of the filter in the beam.
    pub filter_offset: i64,
}

impl FocusWanted {
    /// As rows write it, in numbers that may have a fraction; steps are whole. What is not finite was refused before.
    pub fn of_row(position: Option<f64>, shift: Option<f64>) -> Self {
        let whole = |steps: Option<f64>| steps.map(|steps| steps.round() as i64);
        Self { position: whole(position), shift: whole(shift), filter_offset: 0 }
    }
}

/// Where the focuser goes before the first frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize, JsonSchema)]
pub struct Defocus {
    /// From the best focus; 0 where absent.
    #[schemars(range(min = -1_000_000_000, max = 1_000_000_000), extend("unit" = "steps"))]
    focus_shift: Option<f64>,
    /// Absolute position; wins over the shift.
    #[schemars(range(min = 0, max = 1_000_000_000), extend("unit" = "steps"))]
    focus_position: Option<f64>,
}

impl Defocus {
    /// As the focuser takes it.
    pub fn wanted(&self) -> FocusWanted {
        FocusWanted::of_row(self.focus_position, self.focus_shift)
    }
}

/// Binning where a row names none.
fn one() -> u32 {
    1
}

/// Centre where a row names none.
fn half() -> f64 {
    0.5
}

/// For what is done unless a row says otherwise.
pub fn yes() -> bool {
    true
}

/// Longest exposure, s.
pub const LONGEST_S: u32 = 86_400;

/// Refuses one of two parameters that only mean something together.
pub fn both(one: &str, has_one: bool, other: &str, has_other: bool) -> Result<(), Wrong> {
    if has_one == has_other {
        return Ok(());
    }
    let given = if has_one { one } else { other };
    Err(Wrong::of(given, format!("give {one} and {other}, or neither")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_pair_is_refused_by_the_name_that_was_given() {
        let part = |text: &str| -> Readout { serde_json::from_str(text).unwrap() };
        assert_eq!(part("{}").check(), Ok(()));
        assert_eq!(part(r#"{"subframe_width": 5, "subframe_height": 5}"#).check(), Ok(()));
        let half = part(r#"{"subframe_height": 5}"#).check().unwrap_err();
        assert_eq!(half, Wrong::of("subframe_height", "give subframe_width and subframe_height, or neither"));
    }
}
