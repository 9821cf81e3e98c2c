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
    /// Sensor width, unbinned pixels.
    pub width_px: u32,
    /// Sensor height, unbinned pixels.
    pub height_px: u32,
    /// Pixel width, micrometres, unbinned.
    pub pixel_width_um: Datum<f64>,
    /// Pixel height, micrometres, unbinned.
    pub pixel_height_um: Datum<f64>,
    /// Largest binning factor.
    pub max_bin: u32,
    /// Largest pixel value, ADU.
    pub max_adu: Datum<f64>,
    /// Has a cooler with a set point.
    pub set_temperature: bool,
    /// Can stop an exposure and throw it away.
    pub abort: bool,
    /// Electrons per ADU.
    pub electrons_per_adu: Datum<f64>,
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
    /// IMAGETYP keyword: `Light Frame`, `Dark Frame`, `Bias Frame`, `Flat Frame`.
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
