//! Times, words and payloads as the tables hold them.

use serde::Serialize;
use units::Utc;

/// A time in the form of the predecessor's tables, which sorts as text.
pub fn stamp(at: Utc) -> String {
    at.strftime("%Y-%m-%d %H:%M:%S.%6f")
}

/// The word of an enumeration, as it is published.
pub fn word(value: &impl Serialize) -> rusqlite::Result<String> {
    let json = serde_json::to_value(value).map_err(failed)?;
    Ok(json.as_str().map(str::to_owned).unwrap_or_else(|| json.to_string()))
}

/// A payload as JSON.
pub fn json(value: &impl Serialize) -> rusqlite::Result<String> {
    serde_json::to_string(value).map_err(failed)
}

fn failed(error: serde_json::Error) -> rusqlite::Error {
    rusqlite::Error::ToSqlConversionFailure(Box::new(error))
}
