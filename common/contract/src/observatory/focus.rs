//! The focus: where it is, and the run of frames that finds it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{CommandId, Payload};

/// The focus.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct FocusState {
    /// A run is under way.
    pub active: bool,
    /// Best known position of the first focuser at the present temperature, without a filter's offset, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_position: Option<i64>,
    /// In words.
    pub detail: String,
    /// What is known of each focuser.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub focusers: Vec<FocuserFocus>,
    /// The run under way, or the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<FocusRun>,
}

impl Payload for FocusState {
    const NAME: &'static str = "observatory.focus";
}

/// What focus runs have taught: published by the commander, taken over by whoever stands by.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct FocusLearned {
    /// Runs that found a focus and are remembered, by the focuser's configured name, in order of time.
    #[serde(default)]
    pub focusers: BTreeMap<String, Vec<FocusFound>>,
}

impl Payload for FocusLearned {
    const NAME: &'static str = "observatory.focus_learned";
}

/// One run that found a focus, as it is remembered.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FocusFound {
    /// Names the run.
    pub id: String,
    /// End of the run, sky time.
    pub at_utc: Utc,
    /// Filter that its row named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Offset of that filter as the wheel reported, steps.
    #[serde(default)]
    pub wheel_offset: i64,
    /// Best position through that filter, steps.
    pub position: f64,
    /// Its standard error, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
    /// Half width of the bottom of the curve, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub critical_zone: Option<f64>,
    /// Temperature at the focuser, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Altitude of the field, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_deg: Option<f64>,
}

/// What is known of one focuser.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct FocuserFocus {
    /// Configured name.
    pub focuser: String,
    /// Best known position at the present temperature, without a filter's offset, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_position: Option<i64>,
    /// Temperature at the focuser, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Runs that found a focus and are remembered.
    pub runs: u32,
    /// How the best position follows the temperature, steps per degree; absent until enough runs show.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_per_c: Option<f64>,
    /// Its standard error, steps per degree.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_per_c_error: Option<f64>,
}

/// A focus run: as far as it is while it is under way, whole once it has an outcome other than `running`.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FocusRun {
    /// Names the run.
    pub id: CommandId,
    /// Configured name of the camera.
    pub camera: String,
    /// Configured name of the focuser.
    pub focuser: String,
    /// Filter that the row named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Offset of that filter by which `stored_position` is less than `best_position`, steps.
    pub filter_offset: i64,
    /// Offset of that filter as the wheel says, steps; absent without a named filter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wheel_offset: Option<i64>,
    /// Night that the frames are filed under, `YYYYMMDD`.
    pub night: String,
    /// Sky time of the begin.
    pub started_utc: Utc,
    /// Sky time of the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_utc: Option<Utc>,
    /// How it went.
    pub outcome: FocusOutcome,
    /// Why there is no focus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Where the focuser stood before, steps.
    pub start_position: i64,
    /// Best position through that filter, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_position: Option<f64>,
    /// Its standard error, steps; absent for smoothed curves, which know none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_position_error: Option<f64>,
    /// What is kept as the best position: without the filter's offset, steps; absent where the row keeps nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stored_position: Option<f64>,
    /// Half width of the bottom of the curve, steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub critical_zone: Option<f64>,
    /// Median value of the frames that verified the focus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verified: Option<f64>,
    /// What was measured, such as `hfd`.
    pub operator: String,
    /// What the values are, with their unit.
    pub value_label: String,
    /// Mean temperature at the focuser, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Altitude of the field at the begin, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_deg: Option<f64>,
    /// All that was measured, in order of time.
    pub points: Vec<FocusPoint>,
    /// The curve through the points, as soon as there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curve: Option<FocusCurve>,
}

impl Payload for FocusRun {
    const NAME: &'static str = "observatory.focus_run";
}

/// How a focus run went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocusOutcome {
    /// Under way.
    #[default]
    Running,
    /// The focus was found and verified; the focuser stands there.
    Focused,
    /// No focus; the focuser went back to where it stood.
    Failed,
}

/// What a position of a run is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocusPass {
    /// To see where the focus is.
    Coarse,
    /// To measure it.
    Fine,
    /// To see whether it is.
    Verification,
}

/// What was measured at one position.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FocusPoint {
    /// Position of the focuser, steps.
    pub position: i64,
    /// What it was for.
    pub pass: FocusPass,
    /// The value; absent where the frames have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// Its standard error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
    /// Stars that it was taken from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars: Option<u32>,
    /// Why there is no value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Whether the curve goes by it; absent while there is no curve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub used: Option<bool>,
    /// The frames.
    pub frames: Vec<CommandId>,
    /// Temperature at the focuser, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// What other operators say of the same frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<FocusValue>,
}

/// What one operator says.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FocusValue {
    /// Name of the operator.
    pub operator: String,
    /// Its value, in its own unit.
    pub value: f64,
}

/// The curve of a run.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FocusCurve {
    /// `hyperbola`, or the smoother's name.
    pub model: String,
    /// Where it is best, steps.
    pub best_position: f64,
    /// Its value there.
    pub best_value: f64,
    /// Slope of a hyperbola far from focus, unit of the values per step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slope_per_step: Option<f64>,
    /// Larger values are better.
    pub larger_is_better: bool,
    /// Position (steps) and value along a smoothed curve.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 2]>,
}
