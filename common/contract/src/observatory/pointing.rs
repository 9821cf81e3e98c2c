//! Where a telescope looks when it is sent somewhere, and what was learned of it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::Payload;
use crate::device::telescope::PierSide;

/// The pointing.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct PointingState {
    /// A telescope is being brought onto its target.
    pub active: bool,
    /// In words.
    pub detail: String,
    /// How far from its target the last solved frame of a row with `pointing` was, arcmin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_target_arcmin: Option<f64>,
    /// What was learned, by camera and pier side.
    #[serde(default)]
    pub models: Vec<PointingModel>,
}

impl Payload for PointingState {
    const NAME: &'static str = "observatory.pointing";
}

/// What is known of how a camera misses where its mount is sent.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct PointingModel {
    /// Configured name of the camera.
    pub camera: String,
    /// Side of the pier; absent where the mount does not report one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// First slews are corrected by it: it has proven to help.
    pub used: bool,
    /// How well it fits its points, root of the mean square, arcmin; absent with too few of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_arcmin: Option<f64>,
    /// Where the camera was seen to look, the oldest first.
    #[serde(default)]
    pub points: Vec<PointingPoint>,
    /// What it foretold of the newest points before it learned them, the oldest first.
    #[serde(default)]
    pub checks: Vec<PointingCheck>,
}

/// Where a camera was seen to look, from where its mount was sent.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct PointingPoint {
    /// Middle of the exposure, sky time.
    pub at_utc: Utc,
    /// Hour angle of the commanded direction then, degrees in [-180, 180), west positive.
    pub hour_angle_deg: f64,
    /// ICRS declination of the commanded direction, degrees.
    pub dec_deg: f64,
    /// How far to the east of it the middle of the sensor looks, on the sky, arcmin.
    pub east_arcmin: f64,
    /// How far to the north, arcmin.
    pub north_arcmin: f64,
}

/// One foretelling and what it was worth.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct PointingCheck {
    /// How far off the camera would have looked with the model, arcmin.
    pub with_arcmin: f64,
    /// How far without, arcmin.
    pub without_arcmin: f64,
}
