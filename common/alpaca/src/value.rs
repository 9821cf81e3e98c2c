//! Converts a JSON value to the type of a property, or gives the reason why not.

use std::fmt::Debug;
use std::ops::RangeInclusive;

use contract::{NoData, Scalar};
use serde_json::Value;

fn wrong(expected: &str, value: &Value) -> NoData {
    let shown: String = value.to_string().chars().take(60).collect();
    match value {
        Value::Null => NoData::new("missing", "null"),
        _ => NoData::new("wrong type", format!("expected {expected}, got {shown}")),
    }
}

/// A finite number; numeric text counts.
pub fn number(value: &Value) -> Result<f64, NoData> {
    let parsed = match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) => text.trim().parse::<f64>().ok(),
        _ => None,
    };
    match parsed {
        Some(number) if number.is_finite() => Ok(number),
        Some(_) => Err(NoData::new("not a number", "")),
        None => Err(wrong("a number", value)),
    }
}

/// A whole number; `3.0` and `"3"` count.
pub fn whole(value: &Value) -> Result<i64, NoData> {
    if let Some(exact) = value.as_i64() {
        return Ok(exact);
    }
    let number = number(value)?;
    if number.fract() == 0.0 && number.abs() < 9e15 { Ok(number as i64) } else { Err(wrong("a whole number", value)) }
}

/// A number of this range, as [`number`] reads it; any other one is nonsense, and no answer.
pub fn number_in(range: RangeInclusive<f64>) -> impl Fn(&Value) -> Result<f64, NoData> {
    move |value: &Value| number(value).and_then(|number| possible(number, &range))
}

/// A whole number of this range, as [`whole`] reads it; any other one is nonsense, and no answer.
pub fn whole_in(range: RangeInclusive<i64>) -> impl Fn(&Value) -> Result<i64, NoData> {
    move |value: &Value| whole(value).and_then(|number| possible(number, &range))
}

fn possible<T: PartialOrd + Debug>(number: T, range: &RangeInclusive<T>) -> Result<T, NoData> {
    if range.contains(&number) {
        return Ok(number);
    }
    // As `Debug` has them, numbers with hundreds of digits are short.
    let detail = format!("{number:?} is not possible; expected {:?} to {:?}", range.start(), range.end());
    Err(NoData::new("wrong type", detail))
}

/// True or false; `0`, `1`, `"True"` and `"false"` count.
pub fn flag(value: &Value) -> Result<bool, NoData> {
    match value {
        Value::Bool(flag) => Ok(*flag),
        Value::Number(number) if number.as_i64() == Some(0) => Ok(false),
        Value::Number(number) if number.as_i64() == Some(1) => Ok(true),
        Value::String(text) if text.trim().eq_ignore_ascii_case("true") => Ok(true),
        Value::String(text) if text.trim().eq_ignore_ascii_case("false") => Ok(false),
        _ => Err(wrong("true or false", value)),
    }
}

/// JSON `true` or `false` and nothing else: a value on which safety depends is not guessed.
pub fn strict_flag(value: &Value) -> Result<bool, NoData> {
    value.as_bool().ok_or_else(|| wrong("true or false", value))
}

/// Text.
pub fn text(value: &Value) -> Result<String, NoData> {
    match value {
        Value::String(text) => Ok(text.clone()),
        Value::Number(number) => Ok(number.to_string()),
        _ => Err(wrong("text", value)),
    }
}

/// A list, each element read by `read`.
pub fn list<T>(value: &Value, read: impl Fn(&Value) -> Result<T, NoData>) -> Result<Vec<T>, NoData> {
    value.as_array().ok_or_else(|| wrong("a list", value))?.iter().map(read).collect()
}

/// Any value that a reading may have.
pub fn scalar(value: &Value) -> Result<Scalar, NoData> {
    match value {
        Value::Bool(flag) => Ok(Scalar::Bool(*flag)),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => Ok(Scalar::Int(whole)),
            None => self::number(value).map(Scalar::Float),
        },
        Value::String(text) if text == "NaN" => Err(NoData::new("not a number", "")),
        Value::String(text) => Ok(Scalar::Text(text.clone())),
        Value::Array(_) => list(value, scalar).map(Scalar::List),
        Value::Null | Value::Object(_) => Err(wrong("a value", value)),
    }
}
