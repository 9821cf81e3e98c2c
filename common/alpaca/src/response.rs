//! Reads an Alpaca answer, even a careless one: a value whose meaning is plain is taken; any other becomes a reason why
//! there is none.

use serde_json::{Map, Value};

use crate::envelope_number::envelope_number;
use crate::transaction::{Echo, Transactions};
use crate::{AlpacaError, json};

/// One Alpaca answer without an error.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// `Value`, where there is one.
    pub value: Option<Value>,
}

/// The members of an answer that have a meaning; their names as the standard writes them.
const MEMBERS: [&str; 5] = ["Value", "ClientTransactionID", "ServerTransactionID", "ErrorNumber", "ErrorMessage"];
/// Other members with such a text in their name may contradict the value.
const SUSPECT: [&str; 9] = ["error", "exception", "fault", "fail", "warn", "alarm", "alert", "safe", "value"];

/// Reads the answer to request `asked` from its HTTP status and body; the content type is of no interest.
pub fn parse(status: u16, body: &[u8], transactions: &Transactions, asked: u32) -> Result<Answer, AlpacaError> {
    let text = decode(body);
    let text = text.trim_matches(|c: char| c == '\0' || c == '\u{feff}' || c.is_whitespace());
    let object = object(text);
    if let Ok(object) = &object {
        // This check comes before its error is read: the error would be another request's, too.
        transactions.check(asked, &Echo::of(field(object, "ClientTransactionID"), false))?;
    }
    if !(200..300).contains(&status) {
        // Some servers send an ASCOM error together with HTTP 500.
        if let Ok(object) = &object {
            ascom_error(object)?;
        }
        let said = object.as_ref().ok().and_then(said);
        return Err(AlpacaError::Http { status, body: excerpt(said.as_deref().unwrap_or(text)) });
    }
    if text.is_empty() {
        return Ok(Answer { value: None });
    }
    let mut object = object.map_err(AlpacaError::Protocol)?;
    ascom_error(&object)?;
    let key = object.keys().find(|key| key.eq_ignore_ascii_case("Value")).cloned();
    let value = key.and_then(|key| object.shift_remove(&key));
    Ok(Answer { value })
}

/// Reads an answer on which safety depends: only one that is exactly as the standard demands has a value. Whatever
/// [`parse`] refuses is refused for the same reason.
pub fn parse_exactly(status: u16, body: &[u8], transactions: &Transactions, asked: u32) -> Result<Answer, AlpacaError> {
    parse(status, body, transactions, asked)?;
    let odd = |what: String| AlpacaError::Protocol(format!("not exactly an Alpaca answer: {what}"));
    if status != 200 {
        return Err(odd(format!("HTTP status {status}")));
    }
    let text = std::str::from_utf8(body).map_err(|error| odd(error.to_string()))?;
    let mut object = match json::read(text) {
        Ok(Value::Object(object)) => object,
        Ok(_) => return Err(odd("no JSON object".to_owned())),
        Err(error) => return Err(odd(error.to_string())),
    };
    for (name, value) in &object {
        let known = MEMBERS.iter().any(|member| member == name);
        let lower = name.to_ascii_lowercase();
        if !known && (is_member(name) || SUSPECT.iter().any(|word| lower.contains(word)) && !is_empty(value)) {
            return Err(odd(format!("it has a member \"{name}\"")));
        }
    }
    if object.get("ErrorNumber").and_then(Value::as_i64) != Some(0) {
        let got = object.get("ErrorNumber").map_or_else(|| "none".to_owned(), Value::to_string);
        return Err(odd(format!("ErrorNumber is {got}")));
    }
    match object.get("ErrorMessage") {
        None | Some(Value::Null) => {}
        Some(Value::String(message)) if message.is_empty() => {}
        Some(message) => return Err(odd(format!("an error message without an error: {message}"))),
    }
    if let Some(server) = object.get("ServerTransactionID").filter(|server| server.as_i64().is_none()) {
        return Err(odd(format!("ServerTransactionID is {server}")));
    }
    transactions.check_exactly(asked, &Echo::of(object.get("ClientTransactionID"), true))?;
    Ok(Answer { value: object.shift_remove("Value") })
}

/// What a server says in an error, be it in the form of its own framework, such as a problem document.
fn said(object: &Map<String, Value>) -> Option<String> {
    ["ErrorMessage", "detail", "message", "error", "title"].into_iter().find_map(|name| text_of(object, name))
}

fn is_member(name: &str) -> bool {
    MEMBERS.iter().any(|member| member.eq_ignore_ascii_case(name))
}

/// Has no information: servers send this where there is no error.
fn is_empty(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Bool(true) => false,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.trim().is_empty(),
        Value::Array(list) => list.is_empty(),
        Value::Object(object) => object.is_empty(),
    }
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
    let parsed = json::read(text).or_else(|_| json::read(&mend(text)));
    match parsed {
        Ok(Value::Object(object)) => Ok(object),
        Ok(_) => Err(format!("no JSON object: {}", excerpt(text))),
        Err(error) => Err(format!("not JSON ({error}): {}", excerpt(text))),
    }
}

/// Turns values that JSON does not have into JSON: `NaN` and `Infinity` become texts from which no number is read;
/// Python's `True`, `False` and `None` become `true`, `false` and `null`.
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

fn text_of(object: &Map<String, Value>, name: &str) -> Option<String> {
    let text = field(object, name)?.as_str()?.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

fn ascom_error(object: &Map<String, Value>) -> Result<(), AlpacaError> {
    let number = field(object, "ErrorNumber");
    let reason = text_of(object, "ErrorMessage");
    match number.map(|value| (value, envelope_number(value))) {
        Some((_, Some(0))) => {}
        Some((_, Some(code))) => {
            return Err(AlpacaError::Ascom { code: ascom_code(code), message: reason.unwrap_or_default() });
        }
        Some((Value::Null, None)) | None => {
            // An error without its number is still an error.
            if let Some(text) = reason {
                return Err(AlpacaError::Protocol(format!("an error without a number: {text}")));
            }
        }
        Some((value, None)) => return Err(AlpacaError::Protocol(format!("ErrorNumber is {value}"))),
    }
    // An error in a form of the server's own.
    let own = |name: &str, value: &Value| {
        let lower = name.to_ascii_lowercase();
        let named = lower.contains("error") || lower.contains("exception");
        let plain = is_member(name) && (value.is_string() || value.is_number());
        named && !plain && !is_empty(value)
    };
    match object.iter().find(|(name, value)| own(name, value)) {
        Some((name, value)) => {
            let shown: String = value.to_string().chars().take(160).collect();
            Err(AlpacaError::Protocol(format!("an error in a form that Alpaca does not have: {name} is {shown}")))
        }
        None => Ok(()),
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
