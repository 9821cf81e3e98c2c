//! What a schema asks for, in words: for refusals, the operator's page and the command line.

use serde_json::Value;

use super::{alternatives, choices, is_time, types};

/// `a whole number, 1 to 16 px`, or `one of single, maximal`.
pub fn expected(schema: &Value) -> String {
    if let Some(choices) = choices(schema) {
        return format!("one of {}", choices.join(", "));
    }
    let kind = kind(schema, true);
    let unit = schema["unit"].as_str().map(|unit| format!(" {unit}")).unwrap_or_default();
    let range = range(schema).map(|range| format!(", {range}{unit}")).unwrap_or_default();
    match schema["minItems"].as_u64() {
        Some(least) if schema["maxItems"].as_u64() != Some(least) => format!("{kind}, at least {least}{range}"),
        _ => format!("{kind}{range}"),
    }
}

/// What a parameter is: `number`, `text`, `number or list of 2 numbers`; with its article where wanted.
pub fn kind(schema: &Value, with_article: bool) -> String {
    let article = |word: &str| if with_article { format!("a {word}") } else { word.to_owned() };
    if let Some(schemas) = alternatives(schema) {
        // that of null is empty
        let kinds = schemas.iter().map(|schema| kind(schema, with_article)).filter(|kind| !kind.is_empty());
        let mut kinds: Vec<String> = kinds.collect();
        kinds.dedup();
        return kinds.join(" or ");
    }
    let words = types(schema).filter(|word| *word != "null").map(|word| match word {
        "integer" => article("whole number"),
        "string" if is_time(schema) => article("time"),
        "string" => article("text"),
        "boolean" => "true or false".to_owned(),
        "object" => article("map"),
        "array" => {
            let count = match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                (Some(least), Some(most)) if least == most => format!("{least} "),
                _ => String::new(),
            };
            article(&format!("list of {count}{}s", kind(&schema["items"], false)))
        }
        other => article(other),
    });
    words.collect::<Vec<_>>().join(" or ")
}

/// `0 to 86400`, `0 or more`, or the words to choose from.
pub fn range(schema: &Value) -> Option<String> {
    if let Some(choices) = choices(schema) {
        return Some(choices.join(", "));
    }
    match (&schema["minimum"], &schema["maximum"]) {
        (Value::Null, Value::Null) if schema["items"].is_object() => range(&schema["items"]),
        (Value::Null, Value::Null) => None,
        (low, Value::Null) => Some(format!("{low} or more")),
        (Value::Null, high) => Some(format!("at most {high}")),
        (low, high) => Some(format!("{low} to {high}")),
    }
}

/// A value in a message, not longer than people read.
pub fn shown(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()),
        None => text,
    }
}
