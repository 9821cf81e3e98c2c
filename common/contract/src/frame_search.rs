//! Which of the archive's frames are wanted, and the answer about each.

use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::CommandId;

/// Conditions on frames; a frame is found when it meets all that are given.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct FrameSearch {
    /// Night of the schedule row, `YYYYMMDD`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub night: Option<String>,
    /// Configured name of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The whole OBJECT keyword; upper and lower case of ASCII letters are the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// The whole IMAGETYP keyword, such as `Light Frame`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_type: Option<String>,
    /// A place that the frame shows, by its plate solution: frames that are not solved are not found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covers: Option<SkyPlace>,
    /// Stars at most so wide, arcsec: frames without measured stars or without a scale are not found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_max_arcsec: Option<f64>,
    /// At least so many stars.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars_min: Option<u32>,
    /// With the bias, dark and flat frames for those that are found: of the nearest night that has some, at most 30 days
    /// away, with the same camera, binning and part of the sensor.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub with_calibration: bool,
}

/// A place in the sky, ICRS.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct SkyPlace {
    /// Right ascension, degrees.
    pub ra_deg: f64,
    /// Declination, degrees.
    pub dec_deg: f64,
}

/// A text that names no place in the sky.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no place: expected right ascension (0 to 360) and declination (-90 to 90) in degrees with a comma between \
     them, such as 97.6366,29.6723"
)]
pub struct BadPlace(String);

impl FromStr for SkyPlace {
    type Err = BadPlace;

    /// Reads `97.6366,29.6723`.
    fn from_str(text: &str) -> Result<Self, BadPlace> {
        let numbers = text.split_once(',').map(|(ra, dec)| (ra.trim().parse(), dec.trim().parse()));
        match numbers {
            Some((Ok(ra_deg), Ok(dec_deg))) if (0.0..=360.0).contains(&ra_deg) && (-90.0..=90.0).contains(&dec_deg) => {
                Ok(Self { ra_deg, dec_deg })
            }
            _ => Err(BadPlace(text.to_owned())),
        }
    }
}

/// A frame that was found.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FoundFrame {
    /// Which frame.
    pub id: CommandId,
    /// Sky time of its start.
    pub at_utc: Utc,
    /// Configured name of the camera.
    pub camera: String,
    /// Path relative to the image folder.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// All keywords are in the header.
    pub header_complete: bool,
    /// Night of the schedule row, `YYYYMMDD`.
    pub night: String,
    /// Action of the schedule row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Position of the row in the schedule, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row: Option<u32>,
    /// Number of the frame within the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<u32>,
    /// OBJECT keyword.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// IMAGETYP keyword.
    pub image_type: String,
    /// Seconds of light.
    pub exposure_s: f64,
    /// Binning factor.
    pub bin: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// ICRS right ascension of the middle by the plate solution, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ra_deg: Option<f64>,
    /// ICRS declination of the middle by the plate solution, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dec_deg: Option<f64>,
    /// Width of the stars, arcsec; absent where the size of a pixel on the sky is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_arcsec: Option<f64>,
    /// Stars found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars: Option<u32>,
    /// Median of the sky, ADU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sky_adu: Option<f64>,
    /// Why the frame does not count although it was taken; absent where it counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// What it is for another frame of the answer; absent for a frame that meets the conditions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibrates: Option<CalibrationFrame>,
}

/// Kinds of frames that calibrate others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationFrame {
    /// No light, no exposure time.
    Bias,
    /// No light, the same exposure time.
    Dark,
    /// An even light, the same filter.
    Flat,
}

impl CalibrationFrame {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Bias, Self::Dark, Self::Flat];

    /// The IMAGETYP keyword of such a frame.
    pub const fn image_type(self) -> &'static str {
        match self {
            Self::Bias => "Bias Frame",
            Self::Dark => "Dark Frame",
            Self::Flat => "Flat Frame",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_two_numbers_within_the_sphere() {
        assert_eq!("97.6366,-29.6723".parse(), Ok(SkyPlace { ra_deg: 97.6366, dec_deg: -29.6723 }));
        for wrong in ["97.6", "97.6 29.6", "361,0", "10,91", "NaN,0", "1,2,3", "06h30m,+29d", ""] {
            let error = wrong.parse::<SkyPlace>().unwrap_err().to_string();
            assert!(error.contains("such as 97.6366,29.6723"), "{error}");
        }
    }
}
