//! The guide loop: where it stands, what it rests on, and each of its corrections.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::device::telescope::PierSide;
use crate::{CommandId, Payload};

/// The guide loop. What is absent is not known, or does not apply while nothing is guided.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct GuidingState {
    /// A loop runs.
    pub active: bool,
    /// In words.
    pub detail: String,
    /// Where the loop stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<GuideStage>,
    /// Configured name of the camera whose frames are guided on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// OBJECT of the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Frame that the field is held to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<CommandId>,
    /// What pulses do, and from where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<GuideCalibration>,
    /// Root mean square of the distances from the reference on the last frames (at most 20) while guiding, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_px: Option<f64>,
    /// Frames since the loop began, and those that pulses followed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<u32>,
    /// Frames that were followed by a pulse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<u32>,
    /// The newest correction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<Correction>,
    /// All that is known of what pulses do, newest last: whoever stands by takes it over.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub calibrations: Vec<CameraCalibration>,
}

impl Payload for GuidingState {
    const NAME: &'static str = "observatory.guiding";
}

/// Where a guide loop stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuideStage {
    /// No frame was measured yet.
    Acquire,
    /// The first corrections.
    Stabilise,
    /// At work.
    Guide,
    /// The field is not where it should be, or not seen.
    Lost,
    /// Given up.
    Stopped,
}

/// What guide pulses do to the stars.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct GuideCalibration {
    /// Where it comes from.
    pub source: CalibrationSource,
    /// Sky time when it was made.
    pub made_utc: Utc,
    /// Side of the pier for which it holds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// Declination for which `east_px_per_s` holds, degrees.
    pub dec_deg: f64,
    /// A star's velocity (x, y) during an East pulse, unbinned px/s.
    pub east_px_per_s: [f64; 2],
    /// A star's velocity (x, y) during a North pulse, unbinned px/s.
    pub north_px_per_s: [f64; 2],
    /// Pulse that is lost when declination turns round, s; absent where nobody measured it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlash_s: Option<f64>,
}

/// From where it is known what pulses do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationSource {
    /// Pulses were given and their effect was measured (`calibrate_guiding`).
    Pulses,
    /// From a plate solution and the mount's guide rates.
    PlateSolution,
}

/// What pulses of a mount do to the stars of a camera.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct CameraCalibration {
    /// Configured name of the camera.
    pub camera: String,
    /// What they do.
    pub calibration: GuideCalibration,
}

/// Which frames show the same field in the same way.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct GuideField {
    /// OBJECT.
    pub object: String,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Exposure as the row asks for it, s.
    pub exposure_s: f64,
    /// Configured name of the camera.
    pub camera: String,
    /// Side of the pier, where the mount has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// Binning.
    pub bin: u32,
    /// Columns and rows of the frame, px.
    pub size_px: [u32; 2],
    /// First column and row on the sensor, binned px.
    pub origin_px: [u32; 2],
}

/// References of fields that a telescope remembers, and that its publisher stores.
pub const GUIDE_REFERENCES: usize = 60;

/// Where the stars of a field stood. A later one of the same field takes its place.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct GuideReference {
    /// Which field.
    pub field: GuideField,
    /// The frame that showed it.
    pub frame: CommandId,
    /// When the frame began, sky time.
    pub made_utc: Utc,
    /// The row that it was taken for, by the name that its content gives it.
    pub row: String,
    /// ICRS direction of the frame's middle, degrees, where it was solved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre_deg: Option<[f64; 2]>,
    /// Its stars.
    pub stars: Vec<ReferenceStar>,
}

impl Payload for GuideReference {
    const NAME: &'static str = "observatory.guide_reference";
}

/// A star of a reference: none of its pixels is saturated, at an edge, or of another star.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ReferenceStar {
    /// Column, px; 0 is the middle of the first one.
    pub x_px: f64,
    /// Row, px.
    pub y_px: f64,
    /// Standard error of the column, px.
    pub x_error_px: f64,
    /// Standard error of the row, px.
    pub y_error_px: f64,
    /// Flux, ADU.
    pub flux_adu: f64,
    /// Its standard error, ADU.
    pub flux_error_adu: f64,
    /// How far the star stands out of the noise, in standard deviations.
    pub significance: f64,
    /// Brightest pixel above the sky, ADU.
    pub peak_adu: f64,
    /// Full width at half maximum, px.
    pub fwhm_px: f64,
    /// One less the ratio of the axes.
    pub ellipticity: f64,
    /// Direction of the longer axis, from +x towards +y, degrees.
    pub angle_deg: f64,
}

/// One frame of a guide loop and what was done about it. Lengths are px of the frame (binned).
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Correction {
    /// Which frame.
    pub frame: CommandId,
    /// Configured name of its camera.
    pub camera: String,
    /// Sky time of the middle of its exposure.
    pub mid_utc: Utc,
    /// OBJECT.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Side of the pier, where the mount has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// Frame that the field is held to.
    pub reference: CommandId,
    /// Where the loop stands after this frame.
    pub stage: GuideStage,
    /// How far the stars stand from where the reference has them, along x, px; absent where it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dx_px: Option<f64>,
    /// The same along y, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dy_px: Option<f64>,
    /// Greater one of their standard errors, px.
    #[serde(default, rename = "error_px", skip_serializing_if = "Option::is_none")]
    pub shift_error_px: Option<f64>,
    /// How far the field is turned since the reference, from +x towards +y, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<f64>,
    /// How fast the field turns, degrees per hour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_deg_per_h: Option<f64>,
    /// Stars that were used.
    pub stars: u32,
    /// Their median width, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_px: Option<f64>,
    /// Their flux over that in the reference.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transparency: Option<f64>,
    /// By what it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<GuideMethod>,
    /// Why it could not be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Right ascension.
    pub east: AxisCorrection,
    /// Declination.
    pub north: AxisCorrection,
    /// Root mean square of the distances on the last frames (at most 20) while guiding, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_px: Option<f64>,
    /// What is done in addition, in words: a slew back, a search, an alarm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub further_action: Option<String>,
}

impl Payload for Correction {
    const NAME: &'static str = "observatory.correction";
}

/// By what a shift is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuideMethod {
    /// The reference's stars, in boxes where they should be.
    Boxes,
    /// All stars of the frame.
    StarList,
    /// Sums over rows and columns.
    Projections,
}

/// One axis of a correction: px along the motion that its pulses cause.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct AxisCorrection {
    /// Why it is pulsed, or is not.
    pub why: PulseWhy,
    /// Error that was measured, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_px: Option<f64>,
    /// Error that had been expected, px.
    pub expected_px: f64,
    /// Standard deviation of a measurement around what was expected, px.
    pub spread_px: f64,
    /// Drift of the mount without corrections, px/s.
    pub drift_px_per_s: f64,
    /// Period of the worm that was learned, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worm_period_s: Option<f64>,
    /// Pulse that was decided, ms; positive is East or North.
    pub pulse_ms: i32,
    /// Pulse that the mount took, ms.
    pub given_ms: i32,
}

/// Why an axis is pulsed, or is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PulseWhy {
    /// Towards where the star is expected in the next frame.
    Corrected,
    /// The same, cut to the longest pulse; the rest follows.
    Clipped,
    /// The error is within the dead band.
    WithinDeadBand,
    /// Declination would have to turn round, and there is not yet reason enough.
    ReversalResisted,
    /// The measurement was too surprising; what was expected before is corrected.
    Outlier,
    /// No star was seen; the known drift is taken back.
    DriftHeld,
    /// No star was seen, and no drift is known.
    NotMeasured,
    /// The shift is beyond the cap.
    BeyondCap,
    /// The field is lost: nothing is pulsed until it is found.
    Lost,
    /// The frame is not after the last one, or its numbers are not finite.
    Unusable,
    /// Guiding has been given up.
    Stopped,
}
