//! What was measured on a frame, and what follows from a run of frames.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use super::solution::{FrameWcs, Unsolved};
use crate::device::telescope::PierSide;
use crate::{CommandId, Payload};

/// What was measured on a frame; each value is absent until it is measured, or where the frame does not have it.
///
/// Lengths are pixels of the frame (binned), brightness is ADU. Frames without light from stars (dark, bias, flat) have
/// level, noise and saturation only.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct FrameFacts {
    /// Which frame.
    pub frame: CommandId,
    /// Configured name of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// IMAGETYP of the frame, which says what could be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_type: Option<String>,
    /// Sky time of the shutter's opening.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started_utc: Option<Utc>,
    /// Why nothing, or not all, could be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Stars found, without what is sharper than a star can be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars: Option<u32>,
    /// Full width at half maximum of the stars, pixels: the median of the best ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_px: Option<f64>,
    /// Standard error of `fwhm_px`, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_error_px: Option<f64>,
    /// 1 - minor / major axis of the same stars, their median, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ellipticity: Option<f64>,
    /// Direction in which the stars are drawn out, degrees from +x towards +y, -90 to 90; absent where they have none
    /// in common.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elongation_deg: Option<f64>,
    /// All stars are drawn out in one direction: tracking failed, or wind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trailed: Option<bool>,
    /// Median of the sky, ADU; the level of the frame where there is no sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sky_adu: Option<f64>,
    /// Noise of a pixel of the sky, ADU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_adu: Option<f64>,
    /// Share of the pixels at or above 0.9 of the greatest count, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturated_fraction: Option<f64>,
    /// Share of the pixels that are hot, dead or without a value, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub defect_fraction: Option<f64>,
    /// ICRS right ascension of the frame's geometric centre, `((width - 1) / 2, (height - 1) / 2)`, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ra_deg: Option<f64>,
    /// ICRS declination of the same, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dec_deg: Option<f64>,
    /// Size of a pixel at the centre, arcsec.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_arcsec_px: Option<f64>,
    /// Position angle of +y, from north through east, degrees in [-180, 180).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<f64>,
    /// The frame, drawn with its first row at the top, is a mirror image of the sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirrored: Option<bool>,
    /// Stars that agree with the catalogue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub matched: Option<u32>,
    /// Root of their mean squared distance from their places, both axes together, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_px: Option<f64>,
    /// Probability that the solution is false, an upper bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub false_alarm: Option<f64>,
    /// Pixels to sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wcs: Option<FrameWcs>,
    /// Why a frame with stars is not solved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unsolved: Option<Unsolved>,
    /// How far the middle of the frame, of a part of the sensor that of the part, is from the target, arcmin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_target_arcmin: Option<f64>,
    /// A pixel of the star at the target's place is saturated, so that its flux is good for nothing; absent where no
    /// star is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_saturated: Option<bool>,
    /// Side of the pier on which the frame was taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pier_side: Option<PierSide>,
    /// Airmass of the frame's centre in the middle of the exposure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub airmass: Option<f64>,
    /// Magnitude of a star that gives 1 ADU per second; known once the frame is solved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_point_mag: Option<f64>,
    /// Standard error of `zero_point_mag`, magnitudes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_point_error_mag: Option<f64>,
    /// Share of the starlight that comes through, by the best zero point known of this filter, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transparency: Option<f64>,
    /// Part of the exposure's light that the dome's slit hid, percent; absent where that is less than one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dome_hid_percent: Option<f64>,
    /// Why the frame does not count although it was taken; absent where it counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// How long solving took, within `measuring_s`, machine s; absent on frames without stars to solve by. A frame whose
    /// place takes long is published twice, first with what was measured and without this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub solving_s: Option<f64>,
    /// How long measuring took once the pixels were there, machine s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measuring_s: Option<f64>,
}

impl Payload for FrameFacts {
    const NAME: &'static str = "observatory.facts";
}

/// What several frames of one camera and filter say together.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Trigger {
    /// What it is.
    pub kind: TriggerKind,
    /// Configured name of the camera.
    pub camera: String,
    /// Filter of the frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Start of the first frame that showed it, sky time.
    pub since_utc: Utc,
    /// The figures, in words.
    pub detail: String,
}

/// What a run of frames can say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TriggerKind {
    /// The stars grow wider: the focus drifts, or the seeing worsens.
    FocusDrift,
    /// Most of the stars are gone.
    Clouds,
    /// The stars are drawn out in one direction.
    Trailing,
    /// The frame shows another field than that of its target.
    WrongField,
    /// The target's star is saturated: its light cannot be measured.
    TargetSaturated,
}

impl TriggerKind {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::FocusDrift, Self::Clouds, Self::Trailing, Self::WrongField, Self::TargetSaturated];
}
