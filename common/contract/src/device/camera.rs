//! A camera: exposing, cooling, and the frames in its spool.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::{CommandId, Datum, DeviceKind, Kind, Payload, Reading};

/// The camera, ASCOM Camera.
#[derive(Debug)]
pub struct Camera;

impl DeviceKind for Camera {
    const KIND: Kind = Kind::Camera;
    type Capabilities = Capabilities;
    type Fields = Fields;
    type Command = Command;
}

/// What a camera can do.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CameraCapabilities")]
pub struct Capabilities {
    /// Sensor width, unbinned pixels; 0 where it is not known.
    pub width_px: u32,
    /// Sensor height, unbinned pixels; 0 where it is not known.
    pub height_px: u32,
    /// Pixel width, micrometres, unbinned.
    pub pixel_width_um: Datum<f64>,
    /// Pixel height, micrometres, unbinned.
    pub pixel_height_um: Datum<f64>,
    /// Largest binning factor of both axes; 0 where it is not known, so that the camera decides.
    pub max_bin: u32,
    /// Largest pixel value, ADU.
    pub max_adu: Datum<f64>,
    /// Has a cooler with a set point.
    pub set_temperature: bool,
    /// Can stop an exposure and throw it away.
    pub abort: bool,
    /// Electrons per ADU.
    pub electrons_per_adu: Datum<f64>,
    /// Shortest exposure, s; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_min_s: Option<f64>,
    /// Longest exposure, s; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_max_s: Option<f64>,
    /// Exposures are multiples of this, s; absent where it is not known, or where any length is possible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_step_s: Option<f64>,
}

impl Capabilities {
    /// The exposure that the camera can take in place of one of this length: a multiple of its step, and for 0 s (a
    /// bias) its shortest one; an error with the limits for one that is beyond them.
    pub fn exposure_s(&self, asked_s: f64) -> Result<f64, String> {
        let step = self.exposure_step_s.filter(|step| step.is_finite() && *step > 0.0);
        let least = self.exposure_min_s.filter(|least| least.is_finite() && *least >= 0.0).unwrap_or(0.0);
        let most = self.exposure_max_s.filter(|most| most.is_finite() && *most > 0.0 && *most >= least);
        if asked_s == 0.0 {
            return Ok(least);
        }
        // What is rounded onto a limit is within it.
        let play = 0.5 * step.unwrap_or(0.0) + 1e-9 * asked_s.abs();
        // False for NaN too.
        let fits = asked_s.is_finite()
            && asked_s >= least - play
            && most.is_none_or(|most| asked_s <= most + play)
            && asked_s > 0.0;
        if !fits {
            let most = most.map_or_else(|| "any number of".to_owned(), |most| most.to_string());
            return Err(format!(
                "exposure_s = {asked_s}: expected 0, or {least} to {most} s, which this camera can take"
            ));
        }
        let rounded = match step {
            // Whole nanoseconds: multiples of a decimal step have long tails.
            Some(step) => ((asked_s / step).round() * step * 1e9).round() / 1e9,
            None => asked_s,
        };
        let shortest = if least > 0.0 { least } else { step.unwrap_or(0.0) };
        Ok(rounded.max(shortest).min(most.unwrap_or(f64::MAX)))
    }
}

impl Payload for Capabilities {
    const NAME: &'static str = "camera.capabilities";
}

/// What nodes decide with.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CameraFields")]
pub struct Fields {
    /// What the camera does, ASCOM CameraState.
    pub activity: Datum<Activity>,
    /// Sensor temperature, degrees Celsius.
    pub ccd_c: Datum<f64>,
    /// Cooler set point, degrees Celsius.
    pub set_c: Datum<f64>,
    /// The cooler runs.
    pub cooler_on: Datum<bool>,
    /// Cooler power, percent.
    pub cooler_percent: Datum<f64>,
    /// The exposure under way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Exposure>,
    /// Frames that wait in the spool for the archive.
    pub spooled: u32,
    /// Free space where the spool lies, bytes.
    pub spool_free_bytes: Datum<u64>,
}

impl Payload for Fields {
    const NAME: &'static str = "camera.state";
}

/// What a camera does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CameraActivity")]
#[serde(rename_all = "snake_case")]
pub enum Activity {
    /// Ready.
    Idle,
    /// Waits to start.
    Waiting,
    /// Collects light.
    Exposing,
    /// Reads the sensor.
    Reading,
    /// Hands the image over.
    Download,
    /// In error.
    Error,
}

/// An exposure under way.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CameraExposure")]
pub struct Exposure {
    /// Id of the `expose` command and of the frame to come.
    pub id: CommandId,
    /// Sky time of the shutter's opening.
    pub started_utc: Utc,
    /// How long it collects light, s.
    pub exposure_s: f64,
}

/// A part of the sensor, in binned pixels, as ASCOM defines StartX and NumX.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct Subframe {
    /// First column, binned pixels.
    pub x_px: u32,
    /// First row, binned pixels.
    pub y_px: u32,
    /// Columns, binned pixels.
    pub width_px: u32,
    /// Rows, binned pixels.
    pub height_px: u32,
}

/// Why a frame is taken; it travels with the pixels to the archive.
#[derive(Debug, Clone, PartialEq, Default, JsonSchema, Serialize, Deserialize)]
pub struct Purpose {
    /// Type of the action, such as `object` or `calibration`.
    pub action: String,
    /// OBJECT keyword.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// IMAGETYP keyword: `Light Frame`, `Acquisition Frame`, `Dark Frame`, `Bias Frame`, `Flat Frame`, or
    /// `Test Frame`, which shows how bright a flat would be, or with 0 s the level without light.
    pub image_type: String,
    /// Name of the filter in the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Target, ICRS degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ra_deg: Option<f64>,
    /// Target, ICRS degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dec_deg: Option<f64>,
    /// Night that the action belongs to, `YYYYMMDD`.
    pub night: String,
    /// Counts the frames of an action from 0.
    pub sequence: u32,
    /// Index of the schedule's row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row: Option<u32>,
    /// Id of the observing programme or proposal that the row is for, as the archive of its data names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub programme: Option<String>,
    /// Folder for the file instead of the archive's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<String>,
    /// Names of the devices that belong to this camera: ASCOM type to configured name.
    #[serde(default)]
    pub paired: BTreeMap<String, String>,
    /// Values of the action's `metadata`, for `action_metadata` rows of the header table.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub metadata: BTreeMap<String, String>,
}

impl Purpose {
    /// Longest id of a programme: it has to fit one card of a FITS header, next to a long keyword.
    pub const LONGEST_PROGRAMME: usize = 40;

    /// Can this be the id of a programme: letters, digits and signs of ASCII, without blanks?
    pub fn is_programme(text: &str) -> bool {
        (1..=Self::LONGEST_PROGRAMME).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic())
    }
}

/// What a camera may be asked.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[schemars(rename = "CameraCommand")]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Take a frame; the command's id becomes the frame's id. Done when the shutter is shut and the camera is
    /// free for the next one; the frame is announced when it is safe in the spool.
    Expose {
        /// Seconds.
        exposure_s: f64,
        /// Open the shutter.
        light: bool,
        /// Binning factor of both axes.
        bin: u32,
        /// Part of the sensor; the whole one where absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        subframe: Option<Subframe>,
        /// Why.
        purpose: Box<Purpose>,
    },
    /// Stop the exposure and throw it away.
    Abort,
    /// Run the cooler towards a set point.
    Cool {
        /// Set point, degrees Celsius.
        set_c: f64,
    },
    /// Switch the cooler off.
    Warm,
    /// The archive has the frame on disk: the spool may forget it.
    Release {
        /// Id of the frame.
        frame: CommandId,
        /// Hash of the pixels, as announced.
        sha256: String,
    },
}

impl Payload for Command {
    const NAME: &'static str = "camera.command";
}

/// Type of a spooled pixel; rows one after another from the first row, little endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pixel {
    /// 16 bits without sign.
    U16,
    /// 32 bits with sign.
    I32,
    /// 64-bit float.
    F64,
}

impl Pixel {
    /// Bytes of one pixel.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U16 => 2,
            Self::I32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A frame is safe in the spool and can be fetched.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Frame {
    /// Id of the frame: that of its `expose` command.
    pub id: CommandId,
    /// Configured name of the camera.
    pub camera: String,
    /// Why it was taken.
    pub purpose: Purpose,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Colour planes; 1 for a plain sensor.
    pub planes: u32,
    /// Type of a pixel.
    pub pixel: Pixel,
    /// Binning factor.
    pub bin: u32,
    /// First column and row on the sensor, binned pixels.
    pub origin_px: [u32; 2],
    /// Sky time of the shutter's opening (ASCOM LastExposureStartTime where the camera reports it).
    pub started_utc: Utc,
    /// Seconds of light (ASCOM LastExposureDuration where the camera reports it).
    pub exposure_s: f64,
    /// Where the pixels are served, with a token for this frame; HTTP range requests work.
    pub url: String,
    /// Size of the pixels.
    pub bytes: u64,
    /// SHA-256 of the pixels, lower-case hex.
    pub sha256: String,
    /// The camera's fixed properties, read for this exposure, under their ASCOM names.
    pub readings: BTreeMap<String, Reading>,
}

impl Payload for Frame {
    const NAME: &'static str = "camera.frame";
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(least: Option<f64>, most: Option<f64>, step: Option<f64>) -> Capabilities {
        Capabilities { exposure_min_s: least, exposure_max_s: most, exposure_step_s: step, ..Capabilities::default() }
    }

    #[test]
    fn an_exposure_is_a_multiple_of_the_cameras_step_and_within_its_limits() {
        let coarse = camera(Some(0.01), Some(3600.0), Some(0.01));
        let rows =
            [(0.3, 0.3), (1.234, 1.23), (0.006, 0.01), (3600.0, 3600.0), (3600.004, 3600.0), (0.0, 0.01), (30.0, 30.0)];
        for (asked, taken) in rows {
            assert_eq!(coarse.exposure_s(asked), Ok(taken), "{asked} s");
        }
        for asked in [0.004, 3600.1, -1.0, f64::NAN, f64::INFINITY] {
            let why = coarse.exposure_s(asked).unwrap_err();
            assert!(why.contains("expected 0, or 0.01 to 3600 s"), "{why}");
        }
        assert_eq!(camera(Some(0.0), None, Some(1.0)).exposure_s(0.2), Ok(1.0), "light is wanted");
    }

    #[test]
    fn a_camera_that_reports_nothing_of_its_exposures_or_nonsense_takes_any() {
        for odd in [
            camera(None, None, None),
            camera(Some(f64::NAN), Some(0.0), Some(0.0)),
            camera(Some(-1.0), Some(f64::INFINITY), Some(-0.1)),
        ] {
            assert_eq!(odd.exposure_s(0.0), Ok(0.0));
            assert_eq!(odd.exposure_s(86_400.0), Ok(86_400.0));
            assert_eq!(odd.exposure_s(0.123_456), Ok(0.123_456));
        }
    }
}
