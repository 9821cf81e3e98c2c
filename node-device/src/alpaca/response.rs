//! Reads an Alpaca answer, however sloppy: what is plainly meant is taken, what is not keeps its reason.

use serde_json::{Map, Value};

use super::AlpacaError;

/// One Alpaca answer without an error.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// `Value`, where there is one.
    pub value: Option<Value>,
    /// `ClientTransactionID`, where there is a readable one.
    pub client_transaction: Option<i64>,
    /// `ErrorMessage` although there is no error number.
    pub stray_message: Option<String>,
}

/// Reads an answer from its HTTP status and body; the content type is of no interest.
pub fn parse(status: u16, body: &[u8]) -> Result<Answer, AlpacaError> {
    let text = decode(body);
    let text = text.trim_matches(|c: char| c == '\0' || c == '\u{feff}' || c.is_whitespace());
    let object = object(text);
    if !(200..300).contains(&status) {
        // some servers send an ASCOM error beside HTTP 500
        if let Ok(object) = &object {
            ascom_error(object)?;
        }
        return Err(AlpacaError::Http { status, body: excerpt(text) });
    }
    if text.is_empty() {
        return Ok(Answer { value: None, client_transaction: None, stray_message: None });
    }
    let mut object = object.map_err(AlpacaError::Protocol)?;
    ascom_error(&object)?;
    let client_transaction = field(&object, "ClientTransactionID").and_then(whole);
    let stray_message = message(&object);
    let key = object.keys().find(|key| key.eq_ignore_ascii_case("Value")).cloned();
    let value = key.and_then(|key| object.shift_remove(&key));
    Ok(Answer { value, client_transaction, stray_message })
}

/// UTF-8 with or without its mark, or UTF-16 with its mark.
fn decode(body: &[u8]) -> String {
    let wide = |unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = body[2..].chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    match body {
        [0xFF, 0xFE, ..] => wide(u16::from_le_bytes),
        [0xFE, 0xFF, ..] => wide(u16::from_be_bytes),
        _ => String::from_utf8_lossy(body).into_owned(),
    }
}

fn object(text: &str) -> Result<Map<String, Value>, String> {
    let parsed = serde_json::from_str::<Value>(text).or_else(|_| serde_json::from_str(&mend(text)));
    match parsed {
        Ok(Value::Object(object)) => Ok(object),
        Ok(_) => Err(format!("no JSON object: {}", excerpt(text))),
        Err(error) => Err(format!("not JSON ({error}): {}", excerpt(text))),
    }
}

/// Makes JSON of what JSON does not know: `NaN` and `Infinity` become texts that no number is read from,
/// Python's `True`, `False` and `None` become what they mean.
fn mend(text: &str) -> String {
    let mut mended = String::with_capacity(text.len() + 16);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if c == '"' {
            let end = end_of_string(rest);
            mended.push_str(&rest[..end]);
            rest = &rest[end..];
            continue;
        }
        let word_end = rest.find(|c: char| !c.is_ascii_alphabetic() && c != '-' && c != '+').unwrap_or(rest.len());
        if word_end == 0 {
            mended.push(c);
            rest = &rest[c.len_utf8()..];
            continue;
        }
        let word = &rest[..word_end];
        match word.trim_start_matches(['-', '+']).to_ascii_lowercase().as_str() {
            "nan" | "infinity" | "inf" => mended.push_str("\"NaN\""),
            known @ ("true" | "false" | "null") => mended.push_str(known),
            "none" => mended.push_str("null"),
            _ => mended.push_str(word),
        }
        rest = &rest[word_end..];
    }
    mended
}

/// Byte length of the JSON string that `text` begins with, quotes included.
fn end_of_string(text: &str) -> usize {
    let mut escaped = false;
    for (index, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return index + 1,
            _ => {}
        }
    }
    text.len()
}

fn field<'a>(object: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    object.get(name).or_else(|| object.iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value))
}

fn whole(value: &Value) -> Option<i64> {
    match value {
        Value::Number(number) => number.as_i64().or_else(|| number.as_f64().map(|n| n as i64)),
        Value::String(text) => {
            let text = text.trim();
            let hex = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
            hex.map_or_else(|| text.parse().ok(), |digits| i64::from_str_radix(digits, 16).ok())
        }
        _ => None,
    }
}

fn message(object: &Map<String, Value>) -> Option<String> {
    let text = field(object, "ErrorMessage")?.as_str()?.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

fn ascom_error(object: &Map<String, Value>) -> Result<(), AlpacaError> {
    let number = field(object, "ErrorNumber");
    let said = message(object);
    match number.map(|value| (value, whole(value))) {
        Some((_, Some(0))) => Ok(()),
        Some((_, Some(code))) => Err(AlpacaError::Ascom { code: ascom_code(code), message: said.unwrap_or_default() }),
        Some((Value::Null, None)) | None => match said {
            // an error without its number is still an error
            Some(text) => Err(AlpacaError::Protocol(format!("an error without a number: {text}"))),
            None => Ok(()),
        },
        Some((value, None)) => Err(AlpacaError::Protocol(format!("ErrorNumber is {value}"))),
    }
}

/// COM drivers leak HRESULTs (0x8004xxxx, also as negative numbers) where Alpaca wants 0x400 to 0xFFF.
fn ascom_code(code: i64) -> u32 {
    let bits = (code & 0xFFFF_FFFF) as u32;
    if bits & 0xFFFF_F000 == 0x8004_0000 { bits & 0xFFF } else { bits }
}

/// The first words of a body, on one line.
fn excerpt(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ").chars().take(160).collect()
}

#[cfg(test)]
#[path = "response_tests.rs"]
mod tests;
