//! What solved frames taught of the optics: learned once, used for every frame after.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::solution::Distortion;
use crate::Payload;
use crate::device::telescope::PierSide;

/// What is known of the optics of a telescope.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct OpticsState {
    /// By camera, filter, pier side and binning.
    #[serde(default)]
    pub optics: Vec<Optics>,
    /// By camera, filter and gain.
    #[serde(default)]
    pub zero_points: Vec<ZeroPoint>,
}

impl Payload for OpticsState {
    const NAME: &'static str = "observatory.optics";
}

/// What stays the same from frame to frame of one camera, filter, pier side and binning.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Optics {
    /// Configured name of the camera.
    pub camera: String,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Side of the pier; absent where the mount does not report one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// Binning factor.
    pub bin: u32,
    /// Size of a (binned) pixel on the sky, arcsec.
    pub scale_arcsec_px: f64,
    /// Position angle of +y, from north through east, degrees in [-180, 180).
    pub rotation_deg: f64,
    /// The frame, drawn with its first row at the top, is a mirror image of the sky.
    pub mirrored: bool,
    /// Distortion about the centre of a frame of `size_px` at `origin_px`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sip: Option<Distortion>,
    /// Columns and rows of the frame that taught it.
    pub size_px: [u32; 2],
    /// First column and row of that frame on the sensor, binned pixels.
    pub origin_px: [u32; 2],
    /// Magnitude of the faintest stars that were recognised on it, as the catalogue has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faintest_mag: Option<f64>,
    /// How long it was exposed, s.
    pub exposure_s: f64,
    /// Solved frames that agreed, one after the other.
    pub frames: u32,
    /// Start of the newest of them, sky time.
    pub at_utc: Utc,
}

/// The best zero point known: a clear sky near the zenith and clean mirrors.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ZeroPoint {
    /// Configured name of the camera.
    pub camera: String,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Gain that the camera was set to; absent where it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Magnitude of a star that gives 1 ADU per second.
    pub best_mag: f64,
    /// Airmass at which it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub airmass: Option<f64>,
    /// Start of the frame that showed it, sky time.
    pub at_utc: Utc,
}
