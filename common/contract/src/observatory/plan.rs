//! The forecast of a schedule: what each row will do, before anything moves.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::{Finding, RowStatus};
use crate::Payload;

/// A schedule whose forecast is wanted.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct SchedulePlanQuestion {
    /// The text of the file.
    pub text: String,
    /// Spans of sky time, begin and end, in which the weather is not safe.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unsafe_utc: Vec<[Utc; 2]>,
    /// What has happened of it already; where absent, nothing has, and the forecast begins with its first row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begun: Option<PlanBegun>,
}

/// How far a schedule is whose rest is forecast.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct PlanBegun {
    /// The forecast begins at this sky time.
    pub at_utc: Utc,
    /// The roof is open then.
    pub open: bool,
    /// Rows that have begun; one that is at work goes on with the frames that it lacks.
    pub rows: Vec<RowBegun>,
}

/// How far a row is.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct RowBegun {
    /// Its place in the schedule, from 0.
    pub row: u32,
    /// Its status.
    pub status: RowStatus,
    /// Frames that it has taken.
    pub frames: u32,
}

impl Payload for SchedulePlanQuestion {
    const NAME: &'static str = "schedule.plan_question";
}

/// What a schedule will do.
#[derive(Debug, Clone, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SchedulePlan {
    /// The forecast of each row, in order of their start; empty where there is none.
    pub rows: Vec<RowPlan>,
    /// The sums; absent where there is no forecast.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub night: Option<NightPlan>,
    /// How long the parts of a row were assumed to take, each with its origin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub overheads: Vec<OverheadFigure>,
    /// The pixels of each camera.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<SensorFigure>,
    /// Why the schedule is refused: then there is no forecast.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<Finding>,
    /// Why there is no forecast of a schedule that is not refused, or what it leaves out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl Payload for SchedulePlan {
    const NAME: &'static str = "schedule.plan";
}

/// The forecast of one row.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RowPlan {
    /// Its place in the schedule, from 0.
    pub row: u32,
    /// Line of the text on which it begins, from 1.
    pub line: u32,
    /// `action_type`.
    pub action: String,
    /// Object, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Camera.
    pub camera: String,
    /// Earliest start and latest end.
    pub window_utc: [Utc; 2],
    /// Begin of its first run; absent where it does not run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_utc: Option<Utc>,
    /// End of its last run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end_utc: Option<Utc>,
    /// When it runs: more than one span where it is interrupted.
    pub runs_utc: Vec<[Utc; 2]>,
    /// Its status at the end.
    pub status: RowStatus,
    /// It runs to its end, with all frames that it asks for.
    pub whole: bool,
    /// Frames that count.
    pub frames: u32,
    /// Frames wanted; absent for "until the end".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_wanted: Option<u32>,
    /// Time exposed, s.
    pub exposed_s: f64,
    /// Size of its files; 0 while it is not known, since no frame of its camera is archived.
    pub gigabytes: f64,
    /// Lowest altitude of its target while it runs, degrees, without refraction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_min_deg: Option<f64>,
    /// Highest altitude, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_max_deg: Option<f64>,
    /// Airmass in the middle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub airmass_at_mid: Option<f64>,
    /// Altitude every 5 min and at the end, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_curve: Option<Vec<AltitudePoint>>,
    /// A meridian flip, frames that do not fit, why it fails.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A point of an altitude curve.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct AltitudePoint {
    /// When.
    pub at_utc: Utc,
    /// How high, degrees.
    pub altitude_deg: f64,
}

/// The sums of a forecast.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct NightPlan {
    /// Rows.
    pub rows: u32,
    /// Rows that do not run, or not to their end with all frames.
    pub rows_at_risk: u32,
    /// Frames that count.
    pub frames: u64,
    /// Size of all files, except for those of cameras of which no frame is archived.
    pub gigabytes: f64,
    /// How long the roof is open, s.
    pub open_s: f64,
    /// When all is closed after the last row, if it is ever open.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub closed_utc: Option<Utc>,
    /// Dark time of the nights that the schedule touches: the Sun 18 deg down, s.
    pub dark_s: f64,
    /// How much of it a shutter is open to the sky, s.
    pub dark_exposed_s: f64,
}

/// How long a part of a row takes.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OverheadFigure {
    /// Which part.
    pub name: String,
    /// The value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// The median of so many measurements; 0: assumed.
    pub measured: u32,
}

/// The pixels of a camera.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SensorFigure {
    /// Its name.
    pub camera: String,
    /// Columns, not binned.
    pub width_px: u32,
    /// Rows, not binned.
    pub height_px: u32,
    /// Bytes of a stored file per pixel, headers included.
    pub bytes_per_px: f64,
    /// Of so many frames; 0: none is archived, and the other figures are 0, too.
    pub measured: u32,
}
