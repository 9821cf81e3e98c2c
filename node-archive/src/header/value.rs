//! Values as the rows of the table ask for them: their type, their unit, and the words of states.

use config::header::{Dtype, HeaderRow, Source};
use contract::{Kind, Scalar};

use crate::card::CardValue;

/// Lengths are in the unit that the comment of their row names: drivers report metres, and many programs read mm.
pub(super) fn in_unit(row: &HeaderRow, value: CardValue) -> CardValue {
    let factor = match row.keyword.as_str() {
        "FOCALLEN" | "APTDIA" if row.comment.starts_with("[mm]") => 1e3,
        "APTAREA" if row.comment.starts_with("[mm2]") => 1e6,
        _ => return value,
    };
    match value {
        // Whole nanometres: a factor leaves long tails.
        CardValue::Float(number) => CardValue::Float((number * factor * 1e6).round() / 1e6),
        other => other,
    }
}

/// A text of the table with the names of site, telescope and camera in the places for them.
pub fn with_names(text: &str, place: &config::Place, camera: &str) -> String {
    text.replace("{site}", place.site.as_str())
        .replace("{telescope}", place.telescope.as_str())
        .replace("{camera}", camera)
}

/// Text of the table or of a schedule as the type that the table asks for.
pub(super) fn literal(dtype: Dtype, text: &str) -> Option<CardValue> {
    match dtype {
        Dtype::Str => Some(text.into()),
        Dtype::Int => text.parse().ok().map(CardValue::Int),
        Dtype::Float => text.parse().ok().filter(|number: &f64| number.is_finite()).map(CardValue::Float),
        Dtype::Bool => match text.to_ascii_lowercase().as_str() {
            "true" | "1" => Some(CardValue::Logical(true)),
            "false" | "0" => Some(CardValue::Logical(false)),
            _ => None,
        },
    }
}

/// The words of ASCOM's numbers, for a row of the table that asks for a text.
fn words(kind: Kind, property: &str) -> &'static [&'static str] {
    match (kind, property) {
        (Kind::Telescope, "SideOfPier" | "DestinationSideOfPier") => &["East", "West"],
        (Kind::Dome, "ShutterStatus") => &["open", "closed", "opening", "closing", "error"],
        (Kind::Camera, "CameraState") => &["idle", "waiting", "exposing", "reading", "download", "error"],
        (Kind::Camera, "SensorType") => &["monochrome", "color", "RGGB", "CMYG", "CMYG2", "LRGB"],
        (Kind::CoverCalibrator, "CoverState") => &["none", "closed", "moving", "open", "unknown", "error"],
        _ => &[],
    }
}

/// A device's value as the type that the table asks for, where it can be that; else as it is.
pub(super) fn typed(row: &HeaderRow, value: &Scalar) -> CardValue {
    if let (Dtype::Str, Source::Property(kind, property), Some(number)) = (row.dtype, &row.source, value.number()) {
        let words = words(*kind, property);
        let word = (number.fract() == 0.0 && number >= 0.0).then(|| words.get(number as usize)).flatten();
        // Those of no word are ASCOM's -1, "unknown".
        return match (words.is_empty(), word) {
            (true, _) => CardValue::Text(value.to_string()),
            (false, word) => CardValue::Text(word.copied().unwrap_or("unknown").to_owned()),
        };
    }
    match (row.dtype, value.number()) {
        (Dtype::Float, Some(number)) => CardValue::Float(number),
        (Dtype::Int, Some(number)) => CardValue::Int(number.round() as i64),
        (Dtype::Bool, Some(number)) => CardValue::Logical(number != 0.0),
        (Dtype::Str, _) => CardValue::Text(value.to_string()),
        (_, None) => CardValue::of(value),
    }
}
