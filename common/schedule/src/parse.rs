//! Reads a schedule: JSON objects one after another, with `//` comment lines; one bad row refuses the file.
//!
//! Reading continues after each fault, so that one list of findings is enough to correct a file: what is surely mended
//! is read as it is then. Nothing is written here: the file with its comments stays as people wrote it.

use std::collections::HashMap;
use std::ops::ControlFlow;

use contract::Name;
use contract::observatory::{Check, Finding, Fix};
use serde_json::{Map, Value};

use crate::fault::{Fault, MOST_FINDINGS, Right as _, error, in_order};
use crate::fields::{self, Defaults};
use crate::row::{PartOfRow, Row, RowId};
use crate::written::{self, Cursor, Position, Written};

/// A night has a few hundred rows; a file beyond this is no schedule.
pub(super) const MOST_BYTES: usize = 5_000_000;
const MOST_ROWS: usize = 10_000;
/// So many faults of one value are mended for the reading of its rest.
const MOST_REPAIRS: usize = 16;

/// The result of reading a schedule.
#[derive(Debug, Clone, Default)]
pub struct Reading {
    /// The rows that could be read, in order of their start; those whose faults are surely mended as they are then.
    pub rows: Vec<Row>,
    /// As much as could be read of the others.
    pub parts: Vec<PartOfRow>,
    /// The faults.
    pub findings: Vec<Finding>,
}

/// Reads the rows of a schedule, in order of their start.
///
/// # Errors
/// All that is wrong with the file.
pub fn parse(text: &str, cameras: &[Name]) -> Result<Vec<Row>, Fault> {
    let Reading { rows, findings, .. } = read(text, cameras);
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
    let mut twins: HashMap<RowId, usize> = HashMap::new();
    each_value(text, |cursor, blanked, found| {
        let (value, end) = match found {
            Piece::Value { value, end } => (value, end),
            Piece::NoJson(finding) => {
                reading.findings.push(finding);
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
        let written = Written::read(cursor, blanked, end);
        let twin = twins.entry(RowId::of(&value, 0)).and_modify(|count| *count += 1).or_insert(0);
        // Its id is that of the row as it is written: a change of the defaults makes no new row.
        let id = RowId::of(&value, *twin);
        match fields::row(object, id, written, (cameras, defaults), &mut reading.findings) {
            Ok(row) => reading.rows.push(row),
            Err(part) => reading.parts.push(part),
        }
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
    let mut objects = Vec::new();
    each_value(text.trim_start_matches('\u{feff}'), |cursor, _, found| {
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
    /// No JSON.
    NoJson(Finding),
}

fn go_on(does: bool) -> ControlFlow<()> {
    if does { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
}

/// Takes each value of a text with its place, and with the text without comments, until `take` ends it. What is no JSON
/// is read again where it is surely mended; else reading goes on with the next row.
fn each_value<'t>(text: &'t str, mut take: impl FnMut(Cursor<'t>, &str, Piece) -> ControlFlow<()>) {
    let (mut blanked, mut cursor) = (without_comments(text), Cursor::new(text));
    let (mut from, mut repairs) = (0, 0);
    loop {
        let (fault, begin) = {
            let rest = blanked.get(from..).unwrap_or_default();
            let mut values = serde_json::Deserializer::from_str(rest).into_iter::<Value>();
            loop {
                let begin = start_of_value(&blanked, from + values.byte_offset());
                cursor = cursor.to(begin);
                let value = match values.next() {
                    None => return,
                    Some(Err(fault)) => break (fault, begin),
                    Some(Ok(value)) => value,
                };
                repairs = 0;
                if take(cursor, &blanked, Piece::Value { value, end: from + values.byte_offset() }).is_break() {
                    return;
                }
            }
        };
        let (finding, repair) = no_json(&fault, &blanked, from, cursor, begin);
        if take(cursor, &blanked, Piece::NoJson(finding)).is_break() {
            return;
        }
        match repair.filter(|_| repairs < MOST_REPAIRS) {
            Some(Repair { at, by }) => {
                blanked.replace_range(at..at + by.len(), by);
                (from, repairs) = (begin, repairs + 1);
            }
            None => match next_row(&blanked, begin) {
                Some(next) => (from, repairs) = (next, 0),
                None => return,
            },
        }
    }
}

/// A change that makes JSON of a text: as many bytes as before, so that everything else stays in its place.
struct Repair {
    at: usize,
    by: &'static str,
}

impl Repair {
    /// Of the fault at `at`, in the value that begins at `begin`, where that is sure: a comma too many, Python's words.
    fn of(text: &str, begin: usize, at: usize) -> Option<Self> {
        let rest = text.get(at..)?;
        match rest.chars().next()? {
            ',' if at == begin => Some(Self { at, by: " " }),
            '}' | ']' => {
                let before = text.get(begin..at)?.trim_end().strip_suffix(',')?;
                Some(Self { at: begin + before.len(), by: " " })
            }
            _ => {
                let words = [("True", "true"), ("False", "false"), ("None", "null")];
                let (_, by) = words.into_iter().find(|(word, _)| {
                    rest.strip_prefix(*word).is_some_and(|after| !after.starts_with(char::is_alphanumeric))
                })?;
                Some(Self { at, by })
            }
        }
    }

    /// The same for a person's text; `cursor` stands before it.
    fn fix(&self, cursor: Cursor<'_>) -> Fix {
        let from = cursor.to(self.at);
        written::fix(from.position, from.to(self.at + self.by.len()).position, self.by.trim().to_owned())
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

/// The finding for text that is no JSON, and what surely mends it. The reader began at `from`, its value at `begin`,
/// where `cursor` stands.
fn no_json(
    found: &serde_json::Error,
    text: &str,
    from: usize,
    cursor: Cursor<'_>,
    begin: usize,
) -> (Finding, Option<Repair>) {
    let fault = plain(found);
    if found.is_eof() {
        let what = format!("no JSON: {fault}: the row that begins here has no end");
        let right = match text.get(begin..).is_some_and(|rest| rest.starts_with('[')) {
            true => "write the rows one after another, without [ ] around them",
            false => "close its quotes, brackets and braces",
        };
        return (error(Check::Syntax, cursor.position, None, what).right(right), None);
    }
    let at = offset_of(text.get(from..).unwrap_or_default(), found).map_or(begin, |at| (from + at).max(begin));
    let rest = text.get(at..).unwrap_or_default();
    let repair = Repair::of(text, begin, at);
    let finding = error(Check::Syntax, cursor.to(at).position, None, format!("no JSON: {fault}"));
    let finding = finding.fix(repair.as_ref().map(|repair| repair.fix(cursor)));
    let before = text.get(begin..at).unwrap_or_default().trim_end();
    let finding = match rest.chars().next() {
        Some('/') => finding.right("a comment begins with // and has a line of its own"),
        Some(',') if at == begin => finding.right("rows are not separated by commas"),
        Some(']') if at == begin => finding.right("write the rows one after another, without [ ] around them"),
        Some('}' | ']') if before.ends_with(',') => finding.right("leave out the comma before it"),
        Some('\'') => finding.right("texts stand in double quotes"),
        Some('{') if at > begin => finding.right("the row before it is not closed: a } or a comma is missing"),
        Some('T' | 'F' | 'N') => finding.right("write true, false or null, in small letters; NaN is no number"),
        _ => finding,
    };
    (finding, repair)
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
