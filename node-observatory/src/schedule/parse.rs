//! Reads a schedule: JSON objects one after another, with `//` comment lines; one bad row refuses the file.

use std::collections::HashMap;

use contract::Name;
use serde_json::{Map, Value};
use units::Utc;

use super::nearest::nearest;
use super::row::{Row, RowId};
use crate::action::{ACTIONS, NOT_YET};

/// Why a schedule is not taken: where, what is wrong, what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct Fault {
    /// Line of the file, from 1.
    pub line: usize,
    /// What is wrong and what was expected.
    pub what: String,
}

/// A night has a few hundred rows; a file beyond this is no schedule.
const MOST_BYTES: usize = 5_000_000;
const MOST_ROWS: usize = 10_000;

const FIELDS: [&str; 5] = ["device_name", "action_type", "action_value", "start_time", "end_time"];
/// Written by Astra into its own output, meaningless on reading.
const IGNORED: [&str; 2] = ["completed", "status"];

/// Reads the rows of a schedule, in order of their start.
pub fn parse(text: &str, cameras: &[Name]) -> Result<Vec<Row>, Fault> {
    if text.len() > MOST_BYTES {
        return Err(Fault { line: 1, what: format!("{} bytes; a schedule has at most {MOST_BYTES}", text.len()) });
    }
    let text = without_comments(text.trim_start_matches('\u{feff}'));
    let mut rows: Vec<Row> = Vec::new();
    let mut twins: HashMap<RowId, usize> = HashMap::new();
    let mut values = serde_json::Deserializer::from_str(&text).into_iter::<Value>();
    loop {
        let from = start_of_value(&text, values.byte_offset());
        let line = line_of(&text, from);
        let value = match values.next() {
            None => break,
            Some(Ok(value)) => value,
            Some(Err(error)) => {
                return Err(Fault { line: error.line().max(line), what: format!("no JSON: {}", plain(&error)) });
            }
        };
        let source = Source { text: text.get(from..values.byte_offset()).unwrap_or_default(), line };
        let Value::Object(object) = &value else {
            return Err(source.fault(None, "expected an object such as {\"device_name\": ...}".to_owned()));
        };
        let id = RowId::of(&value, 0);
        let twin = twins.entry(id).and_modify(|count| *count += 1).or_insert(0);
        rows.push(row(object, RowId::of(&value, *twin), &source, cameras)?);
        if rows.len() > MOST_ROWS {
            return Err(source.fault(None, format!("more than {MOST_ROWS} rows")));
        }
    }
    if rows.is_empty() {
        return Err(Fault { line: 1, what: "the file has no rows".to_owned() });
    }
    rows.sort_by_key(|row| row.start);
    Ok(rows)
}

/// Blanks comment lines, which keeps the numbers of all others.
fn without_comments(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        if line.trim_start().starts_with("//") {
            kept.push('\n');
        } else {
            kept.push_str(line);
        }
    }
    kept
}

fn start_of_value(text: &str, offset: usize) -> usize {
    let rest = text.get(offset..).unwrap_or_default();
    offset + (rest.len() - rest.trim_start().len())
}

fn line_of(text: &str, offset: usize) -> usize {
    text.get(..offset).unwrap_or(text).matches('\n').count() + 1
}

/// The message without serde's own "at line 1 column 5", which counts from elsewhere.
fn plain(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or(&text).to_owned()
}

/// Where a row stands in the file.
struct Source<'a> {
    text: &'a str,
    line: usize,
}

impl Source<'_> {
    /// A fault on the line of `key`, or on the row's first.
    fn fault(&self, key: Option<&str>, what: String) -> Fault {
        let within = key.and_then(|key| self.text.find(&format!("\"{key}\""))).map_or(1, |at| line_of(self.text, at));
        Fault { line: self.line + within - 1, what }
    }
}

fn row(object: &Map<String, Value>, id: RowId, source: &Source<'_>, cameras: &[Name]) -> Result<Row, Fault> {
    let known = |key: &&String| FIELDS.contains(&key.as_str()) || IGNORED.contains(&key.as_str());
    if let Some(key) = object.keys().find(|key| !known(key)) {
        return Err(source.fault(Some(key), format!("unknown key {key:?}; {}", meant(key, FIELDS))));
    }
    let camera = text(object, "device_name", source)?;
    let camera = cameras.iter().find(|known| known.as_str() == camera).ok_or_else(|| {
        let known = cameras.iter().map(Name::as_str);
        source.fault(Some("device_name"), format!("no camera is named {camera:?}; {}", meant(camera, known)))
    })?;
    let time = |key: &str| -> Result<Utc, Fault> {
        text(object, key, source)?
            .parse()
            .map_err(|error: units::BadTime| source.fault(Some(key), format!("{key}: {error}")))
    };
    let (start, end) = (time("start_time")?, time("end_time")?);
    if start >= end {
        return Err(source.fault(Some("end_time"), format!("end_time {end} is not after start_time {start}")));
    }
    let action = text(object, "action_type", source)?;
    let entry = ACTIONS.iter().find(|entry| entry.name == action).ok_or_else(|| {
        let what = if NOT_YET.contains(&action) {
            format!("action_type {action:?} is not supported yet")
        } else {
            format!("unknown action_type {action:?}; {}", meant(action, ACTIONS.iter().map(|entry| entry.name)))
        };
        source.fault(Some("action_type"), what)
    })?;
    let value = match object.get("action_value") {
        None | Some(Value::Null) => Value::Object(Map::new()),
        Some(value @ Value::Object(_)) => value.clone(),
        Some(_) => return Err(source.fault(Some("action_value"), "action_value: expected an object".to_owned())),
    };
    let action = (entry.read)(value).map_err(|what| {
        let key = unknown_field(&what);
        let hint = key.map(|key| format!("; {}", meant(key, expected_fields(&what)))).unwrap_or_default();
        let named = key.or_else(|| what.split(':').next());
        // serde's list of all fields gives way to the one that was meant
        let said = key.and_then(|_| what.split(", expected").next()).unwrap_or(&what);
        source.fault(named, format!("{}: {said}{hint}", entry.name))
    })?;
    Ok(Row { id, line: source.line, camera: camera.clone(), action, start, end })
}

fn text<'a>(object: &'a Map<String, Value>, key: &str, source: &Source<'_>) -> Result<&'a str, Fault> {
    match object.get(key) {
        Some(Value::String(text)) => Ok(text),
        Some(other) => Err(source.fault(Some(key), format!("{key}: expected a text, found {other}"))),
        None => Err(source.fault(None, format!("{key} is missing"))),
    }
}

/// What somebody probably meant, or all that there is.
fn meant<'a>(word: &str, known: impl IntoIterator<Item = &'a str> + Clone) -> String {
    match nearest(word, known.clone()) {
        Some(near) => format!("did you mean {near:?}?"),
        None => {
            let all: Vec<&str> = known.into_iter().collect();
            format!("expected one of {}", all.join(", "))
        }
    }
}

/// The key in serde's "unknown field `x`, expected one of `a`, `b`".
fn unknown_field(message: &str) -> Option<&str> {
    message.strip_prefix("unknown field `")?.split('`').next()
}

fn expected_fields(message: &str) -> Vec<&str> {
    message.split(", expected").nth(1).unwrap_or_default().split('`').skip(1).step_by(2).collect()
}

#[cfg(test)]
#[path = "parse_tests.rs"]
mod tests;
