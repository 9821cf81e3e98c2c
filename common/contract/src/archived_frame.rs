//! Questions about one frame that an archive stores: its header, its file, pictures and values of its pixels; and about the
//! report of a night.
//!
//! The archive reads the file on its own disk. Every answer has a bounded size, so a file travels in pieces.

use std::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::frame_search::FoundFrame;
use crate::observatory::FrameFacts;
use crate::{CommandId, Payload};

/// The most bytes of a file in one answer.
pub const MOST_PIECE_BYTES: u32 = 512 << 10;
/// The longest side of a picture, px.
pub const MOST_PICTURE_PX: u32 = 2048;
/// The shortest side limit of a picture that can be asked for, px.
pub const LEAST_PICTURE_PX: u32 = 16;
/// Columns and rows of a tile, px; those at the right and the last rows are smaller.
pub const TILE_PX: u32 = 256;
/// The most values of pixels in one answer.
pub const MOST_PIXELS: u64 = 65_536;
/// The most cards of a header in one answer.
pub const MOST_CARDS: usize = 10_000;

/// A question about one frame.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameQuestion {
    /// Which frame.
    pub frame: CommandId,
    /// What is asked.
    pub ask: FrameAsk,
}

impl Payload for FrameQuestion {
    const NAME: &'static str = "frame.question";
}

/// What may be asked about a frame.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameAsk {
    /// What the archive knows of it.
    About,
    /// The cards of its file.
    Header {
        /// Only this part of the file, from 1; all where absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        hdu: Option<u32>,
    },
    /// A piece of its file.
    Bytes {
        /// The first byte, from 0.
        from: u64,
        /// At most so many, never more than 524,288.
        most: u32,
    },
    /// A JPEG for eyes.
    Picture(PictureWanted),
    /// A piece of the frame at a scale of 1 to 2^n.
    Tile {
        /// 0 is the whole frame in one tile; each next level has twice as many columns and rows.
        z: u32,
        /// Column of the tile, from 0.
        x: u32,
        /// Row of the tile, from 0.
        y: u32,
    },
    /// Values of pixels.
    Pixels {
        /// First column, from 0.
        x: u32,
        /// First row, from 0.
        y: u32,
        /// Columns.
        width_px: u32,
        /// Rows; together at most 65,536 values.
        height_px: u32,
    },
}

/// How a picture shall look.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct PictureWanted {
    /// Longest side, 16 to 2048 px; a smaller frame keeps its size.
    pub longest_px: u32,
    /// How counts become grey.
    pub stretch: Stretch,
    /// The count that is black; chosen from the picture where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_adu: Option<f64>,
    /// The count that is white; chosen from the picture where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_adu: Option<f64>,
    /// Stars are black.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub inverted: bool,
}

/// How counts between black and white become grey.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stretch {
    /// Faint light is lifted and bright stars keep their shape; between two percentiles of the picture.
    #[default]
    Asinh,
    /// Straight, between the limits of IRAF's zscale.
    Zscale,
    /// Straight, between two percentiles.
    Linear,
    /// The square root, between two percentiles.
    Sqrt,
    /// The logarithm, between two percentiles.
    Log,
}

/// The answer about a frame.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameAnswer {
    /// What was asked for, or why it is not given.
    pub gives: FrameGiven,
}

impl Payload for FrameAnswer {
    const NAME: &'static str = "frame.answer";
}

/// What is given about a frame.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameGiven {
    /// What the archive knows of it.
    About(Box<FrameDetails>),
    /// The cards of its file.
    Header(FrameHeader),
    /// A piece of its file.
    Bytes(FilePiece),
    /// A JPEG.
    Picture(FramePicture),
    /// A tile.
    Tile(FrameTile),
    /// Values of pixels.
    Pixels(FramePixels),
    /// There is no such answer.
    Refused(ArchiveRefusal),
}

/// Why an archive does not give what was asked for.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
pub struct ArchiveRefusal {
    /// The reason, for programs.
    pub reason: NotGiven,
    /// What is wrong, what was expected, and what to do.
    pub detail: String,
}

/// Reasons for which an archive does not give something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NotGiven {
    /// It has no such frame or night.
    Unknown,
    /// It has stored the frame, and its file is not in its place any more.
    FileAway,
    /// The file is there and cannot be read as what it should be.
    FileDamaged,
    /// The frame has no such part, tile or pixel.
    OutOfRange,
    /// It is larger than an answer may be.
    TooLarge,
    /// Other questions took all the time.
    Busy,
    /// The question cannot be read: it may be one of a newer version.
    Malformed,
    /// The archive failed.
    Failed,
}

/// A frame with everything that was measured on it.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameDetails {
    /// The frame as a search answers it.
    #[serde(flatten)]
    pub frame: FoundFrame,
    /// What was measured, with the plate solution; absent where nothing arrived.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<FrameFacts>,
}

/// The headers of a file.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameHeader {
    /// Differs after any change of the file.
    pub version: String,
    /// The parts, in their order.
    pub hdus: Vec<HduCards>,
    /// Cards were left out, since there are more than 10,000: ask for one part.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub truncated: bool,
}

/// The header of one part of a file.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct HduCards {
    /// Its place in the file, from 1.
    pub number: u32,
    /// Its cards in their order, without END and blank ones.
    pub cards: Vec<HeaderCard>,
}

/// One card of a header.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct HeaderCard {
    /// The keyword; COMMENT and HISTORY have no value.
    pub keyword: String,
    /// Its value; null where it has none, or one that JSON does not know.
    pub value: CardValue,
    /// The text after the value, or that of a comment.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub comment: String,
}

/// The value of a card.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(untagged)]
pub enum CardValue {
    /// T or F.
    Logical(bool),
    /// A whole number.
    Whole(i64),
    /// Another number.
    Number(f64),
    /// Text.
    Text(String),
    /// None.
    Nothing,
}

/// A piece of a file.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FilePiece {
    /// Differs after any change of the file: pieces of two versions do not belong together.
    pub version: String,
    /// Name of the file, without its folder.
    pub name: String,
    /// Bytes of the whole file.
    pub file_bytes: u64,
    /// The first byte of the piece, from 0.
    pub from: u64,
    /// The piece.
    pub bytes: Base64,
}

/// A picture of a frame.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FramePicture {
    /// Columns.
    pub width_px: u32,
    /// Rows; the first row of the file is the upper one.
    pub height_px: u32,
    /// The JPEG.
    pub bytes: Base64,
}

/// A tile of a frame: 16 bits a pixel, the lower byte first, row by row.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FrameTile {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// A value is `zero + scale * number`.
    pub zero: f64,
    /// See `zero`.
    pub scale: f64,
    /// The number that stands for no value; absent where every number is a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blank: Option<u16>,
    /// The highest `z` of the frame, at which a pixel of a tile is one of the frame.
    pub highest_z: u32,
    /// The numbers.
    pub bytes: Base64,
}

/// Values of pixels.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct FramePixels {
    /// First column, from 0.
    pub x: u32,
    /// First row, from 0.
    pub y: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Row by row; null where a pixel has no value.
    pub values: Vec<Option<f32>>,
}

/// A question about the report of a night.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ReportQuestion {
    /// Date of its evening, `YYYYMMDD`.
    pub night: String,
    /// As what it is wanted.
    pub form: ReportForm,
}

impl Payload for ReportQuestion {
    const NAME: &'static str = "report.question";
}

/// Forms of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReportForm {
    /// For programs.
    Json,
    /// A page of HTML.
    Html,
}

/// The answer about a report.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct ReportAnswer {
    /// The report, or why it is not given.
    pub gives: ReportGiven,
}

/// What is given about a report.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReportGiven {
    /// The report as of now, as JSON or HTML.
    Report(String),
    /// There is none.
    Refused(ArchiveRefusal),
}

impl Payload for ReportAnswer {
    const NAME: &'static str = "report.answer";
}

/// Bytes, in JSON as base64 (RFC 4648, section 4).
#[derive(Clone, PartialEq, Eq, Default)]
pub struct Base64(pub Vec<u8>);

impl fmt::Debug for Base64 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.0.len())
    }
}

impl Serialize for Base64 {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(&self.0))
    }
}

impl<'de> Deserialize<'de> for Base64 {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        STANDARD.decode(text).map(Self).map_err(D::Error::custom)
    }
}

impl JsonSchema for Base64 {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Base64".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "contentEncoding": "base64" })
    }
}
