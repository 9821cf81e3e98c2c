//! Values that may be missing, and then say why.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use units::Utc;

/// Why a value is missing, in words that begin with one of a few fixed classes.
///
/// Classes: `not connected`, `not implemented`, `timeout`, `transport`, `http <status>`, `ascom 0x<code>`,
/// `not a number`, `wrong type`, `missing`, `never read`, `stale`.
#[derive(Debug, Clone, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NoData(pub String);

impl NoData {
    /// From a class and what is known beyond it.
    pub fn new(class: &str, detail: impl fmt::Display) -> Self {
        let detail = detail.to_string();
        Self(if detail.is_empty() { class.to_owned() } else { format!("{class}: {detail}") })
    }

    /// The value was never asked for yet.
    pub fn never_read() -> Self {
        Self("never read".to_owned())
    }

    /// The answer came, and is no number.
    pub fn is_no_number(&self) -> bool {
        ["not a number", "wrong type"].iter().any(|class| self.0.starts_with(class))
    }

    /// No answer came, or it was too old when it was read: the device has reported nothing, and what it reported last is
    /// still the newest reading, until that is too old.
    pub fn is_silence(&self) -> bool {
        const SILENCE: [&str; 8] =
            ["timeout", "transport", "not connected", "never read", "stale", "http 502", "http 503", "http 504"];
        SILENCE
            .iter()
            .any(|class| self.0.strip_prefix(class).is_some_and(|rest| rest.is_empty() || rest.starts_with(':')))
    }

    /// The device has no link.
    pub fn not_connected() -> Self {
        Self("not connected".to_owned())
    }

    /// The device says that it does not have this property.
    pub fn not_implemented() -> Self {
        Self("not implemented".to_owned())
    }
}

impl fmt::Display for NoData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A typed field: the value itself, or `{"no_data": "reason"}`.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(untagged)]
#[schemars(rename = "DatumOf{T}")]
pub enum Datum<T> {
    /// The value is missing, for this reason.
    Missing {
        /// Why.
        no_data: NoData,
    },
    /// The value is known.
    Known(T),
}

impl<T> Datum<T> {
    /// A missing value.
    pub fn missing(reason: NoData) -> Self {
        Self::Missing { no_data: reason }
    }

    /// The value, where there is one.
    pub fn known(&self) -> Option<&T> {
        match self {
            Self::Known(value) => Some(value),
            Self::Missing { .. } => None,
        }
    }

    /// The driver answers with an error instead of a value, or says that it does not have this: nobody will ever see there
    /// whether a command was done.
    pub fn is_refused(&self) -> bool {
        matches!(self, Self::Missing { no_data }
            if no_data.0.starts_with("ascom ") || *no_data == NoData::not_implemented())
    }

    /// The value or the reason why there is none.
    pub fn as_result(&self) -> Result<&T, &NoData> {
        match self {
            Self::Known(value) => Ok(value),
            Self::Missing { no_data } => Err(no_data),
        }
    }

    /// The same with the value changed.
    pub fn map<U>(self, change: impl FnOnce(T) -> U) -> Datum<U> {
        match self {
            Self::Known(value) => Datum::Known(change(value)),
            Self::Missing { no_data } => Datum::Missing { no_data },
        }
    }
}

impl<T> Default for Datum<T> {
    fn default() -> Self {
        Self::missing(NoData::never_read())
    }
}

impl<T> From<Result<T, NoData>> for Datum<T> {
    fn from(result: Result<T, NoData>) -> Self {
        match result {
            Ok(value) => Self::Known(value),
            Err(reason) => Self::missing(reason),
        }
    }
}

/// Any value that a device property may have.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Scalar {
    /// True or false.
    Bool(bool),
    /// A whole number; ASCOM enumerations too.
    Int(i64),
    /// A finite number.
    Float(f64),
    /// Text.
    Text(String),
    /// Several values, such as filter names.
    List(Vec<Scalar>),
}

impl Scalar {
    /// As a number; booleans are 0 and 1, texts and lists are none.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Bool(value) => Some(f64::from(u8::from(*value))),
            Self::Int(value) => Some(*value as f64),
            Self::Float(value) => Some(*value),
            Self::Text(_) | Self::List(_) => None,
        }
    }
}

impl fmt::Display for Scalar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => write!(f, "{value}"),
            Self::Int(value) => write!(f, "{value}"),
            Self::Float(value) => write!(f, "{value}"),
            Self::Text(value) => f.write_str(value),
            Self::List(values) => {
                for (i, value) in values.iter().enumerate() {
                    write!(f, "{}{value}", if i == 0 { "" } else { ", " })?;
                }
                Ok(())
            }
        }
    }
}

/// One property as it was polled, under its ASCOM name.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Reading {
    /// The device's answer, or why there is none.
    #[serde(flatten)]
    pub outcome: ReadingOutcome,
    /// Sky time of the answer (or of the failure).
    pub at_utc: Utc,
    /// How long ago the device was asked for this when the state was sent, s of machine time by the device node's boot-time
    /// clock. A state that repeats an old reading says so. Absent where nothing was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age_s: Option<f64>,
}

/// The two shapes of a reading.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ReadingOutcome {
    /// No value.
    Missing {
        /// Why.
        no_data: NoData,
    },
    /// A value in ASCOM's own unit for that property.
    Value {
        /// The value.
        value: Scalar,
        /// Its unit as ASCOM defines it (`deg`, `h`, `C`, `m/s`, `%`, `hPa` …), empty where it has none.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        unit: String,
    },
}

impl Reading {
    /// The value, where there is one.
    pub fn value(&self) -> Option<&Scalar> {
        match &self.outcome {
            ReadingOutcome::Value { value, .. } => Some(value),
            ReadingOutcome::Missing { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datum_is_the_bare_value_or_its_reason() {
        let known: Datum<f64> = serde_json::from_str("1.5").unwrap();
        assert_eq!(known, Datum::Known(1.5));
        let missing: Datum<f64> = serde_json::from_str(r#"{"no_data":"timeout: 2 s"}"#).unwrap();
        assert_eq!(missing.as_result().unwrap_err().0, "timeout: 2 s");
        assert_eq!(serde_json::to_string(&missing).unwrap(), r#"{"no_data":"timeout: 2 s"}"#);
    }

    #[test]
    fn a_whole_number_stays_whole_and_a_float_stays_a_float() {
        let scalars: Vec<Scalar> = serde_json::from_str(r#"[true, 3, 3.5, "B", ["x", 1]]"#).unwrap();
        assert_eq!(serde_json::to_string(&scalars).unwrap(), r#"[true,3,3.5,"B",["x",1]]"#);
    }
}
