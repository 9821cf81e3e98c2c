//! The whole numbers of an answer in addition to its value: transaction ids and error numbers.

use serde_json::Value;

/// A whole number, also as text; a fraction is none.
pub(crate) fn envelope_number(value: &Value) -> Option<i64> {
    match value {
        Value::Number(number) => {
            let whole = |n: &f64| n.fract() == 0.0 && n.abs() < 9e15;
            number.as_i64().or_else(|| number.as_f64().filter(whole).map(|n| n as i64))
        }
        Value::String(text) => {
            let text = text.trim();
            let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
            hex.map_or_else(|| text.parse().ok(), |digits| i64::from_str_radix(digits, 16).ok())
        }
        _ => None,
    }
}
