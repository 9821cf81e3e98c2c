//! Reads a schedule: JSON objects one after another, with `//` comment lines; one bad row refuses the file.
//!
//! Reading continues after each fault, so that one list of findings is enough to correct a file. Nothing is written
//! here: the file with its comments stays as people wrote it.

use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::Arc;

use contract::Name;
use contract::observatory::{Check, Finding};
use serde_json::{Map, Value};

use crate::fault::{Fault, MOST_FINDINGS, Right as _, error, in_order};
use crate::fields::{self, Defaults};
use crate::row::{Row, RowId};
use crate::written::{Cursor, Position, Written};

/// A night has a few hundred rows; a file beyond this is no schedule.
pub(super) const MOST_BYTES: usize = 5_000_000;
const MOST_ROWS: usize = 10_000;

/// The result of reading a schedule.
#[derive(Debug, Clone, Default)]
pub struct Reading {
    /// The rows that could be read, in order of their start.
    pub rows: Vec<Row>,
    /// The faults of the other rows.
    pub findings: Vec<Finding>,
}

/// Reads the rows of a schedule, in order of their start.
///
/// # Errors
/// All that is wrong with the file.
pub fn parse(text: &str, cameras: &[Name]) -> Result<Vec<Row>, Fault> {
    let Reading { rows, findings } = read(text, cameras);
    if findings.is_empty() { Ok(rows) } else { Err(Fault { findings }) }
}

/// Reads all rows that can be read.
pub fn read(text: &str, cameras: &[Name]) -> Reading {
    read_with(text, cameras, &Defaults::new())
}

/// Reads all rows that can be read; parameters that a row does not give are those of its camera.
pub fn read_with(text: &str, cameras: &[Name], defaults: &Defaults) -> Reading {
    let mut reading = Reading::default();
    let begin = Position { line: 1, column: 1 };
    if text.len() > MOST_BYTES {
        let what = format!("{} bytes; a schedule has at most {MOST_BYTES}", text.len());
        reading.findings.push(error(Check::Syntax, begin, None, what));
        return reading;
    }
    let text = text.trim_start_matches('\u{feff}');
    read_rows(text, cameras, defaults, &mut reading);
    if reading.rows.is_empty() && reading.findings.is_empty() {
        let nothing = error(Check::Syntax, begin, None, "the file has no rows");
        reading.findings.push(nothing.right("give at least one, such as a row with action_type \"close\""));
    }
    in_order(&mut reading.findings, MOST_FINDINGS);
    reading.rows.sort_by_key(|row| row.start);
    reading
}

fn read_rows(text: &str, cameras: &[Name], defaults: &Defaults, reading: &mut Reading) {
    let blanked = without_comments(text);
    let mut twins: HashMap<RowId, usize> = HashMap::new();
    each_value(text, &blanked, |cursor, found| {
        let (value, end) = match found {
            Piece::Value { value, end } => (value, end),
            Piece::NoJson { error, from, begin } => {
                reading.findings.push(no_json(&error, &blanked, from, cursor, begin));
                return go_on(reading.findings.len() < MOST_FINDINGS);
            }
        };
        let Value::Object(object) = &value else {
            let what = "expected an object such as {\"device_name\": ...}";
            let found = error(Check::Syntax, cursor.position, None, what);
            reading.findings.push(match value {
                Value::Array(_) => found.right("write the rows one after another, without [ ] around them"),
                _ => found,
            });
            return ControlFlow::Continue(());
        };
        let written = Written::read(cursor, &blanked, end);
        let twin = twins.entry(RowId::of(&value, 0)).and_modify(|count| *count += 1).or_insert(0);
        let id = RowId::of(&value, *twin);
        // Its id is that of the row as it is written: a change of the defaults makes no new row.
        let object = fields::whole(object, defaults);
        reading.rows.extend(fields::row(&object, id, Arc::new(written), cameras, &mut reading.findings));
        if reading.rows.len() > MOST_ROWS {
            let what = format!("more than {MOST_ROWS} rows");
            reading.findings.push(error(Check::Syntax, cursor.position, None, what));
            return ControlFlow::Break(());
        }
        go_on(reading.findings.len() < MOST_FINDINGS)
    });
}

/// The objects of a text with the line on which each begins; what is no JSON, or no object, is passed over.
pub(super) fn objects(text: &str) -> Vec<(u32, Map<String, Value>)> {
    let blanked = without_comments(text.trim_start_matches('\u{feff}'));
    let mut objects = Vec::new();
    each_value(&blanked, &blanked, |cursor, found| {
        if let Piece::Value { value: Value::Object(object), .. } = found {
            objects.push((cursor.position.line, object));
        }
        go_on(objects.len() <= MOST_ROWS)
    });
    objects
}

/// What is at one place of a schedule.
enum Piece {
    /// A value, and where it ends.
    Value { value: Value, end: usize },
    /// No JSON: reading began at `from`, this value at `begin`.
    NoJson { error: serde_json::Error, from: usize, begin: usize },
}

fn go_on(does: bool) -> ControlFlow<()> {
    if does { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
}

/// Takes each value of a text with its place, until `take` ends it; after a place that is no JSON, from the next row on.
fn each_value<'t>(text: &'t str, blanked: &str, mut take: impl FnMut(Cursor<'t>, Piece) -> ControlFlow<()>) {
    let (mut cursor, mut from) = (Cursor::new(text), 0);
    loop {
        let rest = blanked.get(from..).unwrap_or_default();
        let mut values = serde_json::Deserializer::from_str(rest).into_iter::<Value>();
        let next = loop {
            let begin = start_of_value(blanked, from + values.byte_offset());
            cursor = cursor.to(begin);
            let (found, next) = match values.next() {
                None => return,
                Some(Ok(value)) => (Piece::Value { value, end: from + values.byte_offset() }, None),
                Some(Err(error)) => (Piece::NoJson { error, from, begin }, Some(next_row(blanked, begin))),
            };
            if take(cursor, found).is_break() {
                return;
            }
            if let Some(next) = next {
                break next;
            }
        };
        let Some(next) = next else { return };
        from = next;
    }
}

/// Comment lines become blanks of the same length, so that the place of everything else stays the same.
fn without_comments(text: &str) -> String {
    let mut rest = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        if line.trim_start().starts_with("//") {
            rest.extend(line.bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' }));
        } else {
            rest.push_str(line);
        }
    }
    rest
}

fn start_of_value(text: &str, offset: usize) -> usize {
    let rest = text.get(offset..).unwrap_or_default();
    offset + (rest.len() - rest.trim_start().len())
}

/// The place where the next line begins with a brace: reading continues there after a row that is no JSON.
fn next_row(text: &str, offset: usize) -> Option<usize> {
    let mut at = offset;
    for line in text.get(offset..)?.split_inclusive('\n') {
        let indent = line.len() - line.trim_start().len();
        if at > offset && line.trim_start().starts_with('{') {
            return Some(at + indent);
        }
        at += line.len();
    }
    None
}

/// The finding for text that is no JSON; the reader began at `from`, its value at `begin`, where `cursor` stands.
fn no_json(found: &serde_json::Error, text: &str, from: usize, cursor: Cursor<'_>, begin: usize) -> Finding {
    let fault = plain(found);
    if found.is_eof() {
        let what = format!("no JSON: {fault}: the row that begins here has no end");
        let right = match text.get(begin..).is_some_and(|rest| rest.starts_with('[')) {
            true => "write the rows one after another, without [ ] around them",
            false => "close its quotes, brackets and braces",
        };
        return error(Check::Syntax, cursor.position, None, what).right(right);
    }
    let at = offset_of(text.get(from..).unwrap_or_default(), found).map_or(begin, |at| (from + at).max(begin));
    let rest = text.get(at..).unwrap_or_default();
    let finding = error(Check::Syntax, cursor.to(at).position, None, format!("no JSON: {fault}"));
    let before = text.get(begin..at).unwrap_or_default().trim_end();
    match rest.chars().next() {
        Some('/') => finding.right("a comment begins with // and has a line of its own"),
        Some(',') if at == begin => finding.right("rows are not separated by commas"),
        Some(']') if at == begin => finding.right("write the rows one after another, without [ ] around them"),
        Some('}' | ']') if before.ends_with(',') => finding.right("leave out the comma before it"),
        Some('\'') => finding.right("texts stand in double quotes"),
        Some('{') if at > begin => finding.right("the row before it is not closed: a } or a comma is missing"),
        Some('T' | 'F' | 'N') => finding.right("write true, false or null, in small letters; NaN is no number"),
        _ => finding,
    }
}

/// Byte at which serde found the fault, from its line and column, which count bytes.
fn offset_of(text: &str, found: &serde_json::Error) -> Option<usize> {
    let before: usize = text.split_inclusive('\n').take(found.line().checked_sub(1)?).map(str::len).sum();
    let mut at = (before + found.column().saturating_sub(1)).min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    Some(at)
}

/// The message without serde's own "at line 1 column 5", which counts from elsewhere.
fn plain(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or(&text).to_owned()
}

#[cfg(test)]
#[path = "parse_tests.rs"]
mod tests;
