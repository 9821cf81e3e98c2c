//! The places of the rows of a schedule and of their fields: lines and columns.

use std::collections::HashSet;
use std::ops::Range;

use contract::observatory::Fix;
use serde::de::IgnoredAny;
use serde_json::Value;

use crate::wrong::Mend;

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// Line, from 1.
    pub line: u32,
    /// Character of the line, from 1.
    pub column: u32,
}

/// Counts lines and columns on the way through a text, forward only, so that one long line costs no more than many.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cursor<'a> {
    text: &'a str,
    offset: usize,
    /// Where it stands.
    pub position: Position,
}

impl<'a> Cursor<'a> {
    /// At the begin of a text.
    pub fn new(text: &'a str) -> Self {
        Self { text, offset: 0, position: Position { line: 1, column: 1 } }
    }

    /// The same, further on; `offset` in bytes. It never goes back.
    pub fn to(mut self, offset: usize) -> Self {
        let passed = self.text.get(self.offset..offset).unwrap_or_default();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        match passed.rsplit_once('\n') {
            None => self.position.column = self.position.column.saturating_add(count(passed.chars().count())),
            Some((before, line)) => {
                self.position.line = self.position.line.saturating_add(count(before.matches('\n').count() + 1));
                self.position.column = count(line.chars().count() + 1);
            }
        }
        self.offset = self.offset.max(offset);
        self
    }
}

/// A row as it is written: where it begins, and each of its fields.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Its brace.
    pub begin: Position,
    /// After its last brace.
    end: Position,
    fields: Vec<WrittenField>,
}

/// One field of a row, or of its `action_value`.
#[derive(Debug, Clone, PartialEq, Eq)]
struct WrittenField {
    name: String,
    /// Of `action_value`.
    is_parameter: bool,
    key: Position,
    key_end: Position,
    value: Position,
    value_end: Position,
    /// No list and no map, in which comments may stand.
    is_plain: bool,
}

/// Of the row itself, or of its `action_value`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    Row,
    Parameters,
}

impl Written {
    /// Of the JSON object that `cursor` stands before; `end` is the byte after it.
    pub(super) fn read(cursor: Cursor<'_>, blanked: &str, end: usize) -> Self {
        let begin = cursor.offset;
        let mut here = cursor;
        let mut fields = Vec::new();
        let row = blanked.get(begin..end).unwrap_or_default();
        for FieldBytes { name, is_parameter, key: key_bytes, value: at } in spans(row) {
            here = here.to(begin + key_bytes.start);
            let key = here.position;
            here = here.to(begin + key_bytes.end);
            let key_end = here.position;
            here = here.to(begin + at);
            // The fields within it are before its end.
            let value_end = here.to(begin + end_of_value(row, at)).position;
            let is_plain = !row.get(at..).is_some_and(|value| value.starts_with(['{', '[']));
            fields.push(WrittenField { name, is_parameter, key, key_end, value: here.position, value_end, is_plain });
        }
        Self { begin: cursor.position, end: here.to(end).position, fields }
    }

    fn find(&self, of: Of, name: &str) -> Option<&WrittenField> {
        self.fields.iter().find(|field| is(field, of, name))
    }

    /// Where a field's name stands; the row's begin where it has none.
    pub(super) fn key(&self, of: Of, name: &str) -> Position {
        self.find(of, name).map_or(self.begin, |field| field.key)
    }

    /// Where a field's value stands; the row's begin where it has none.
    pub(super) fn value(&self, of: Of, name: &str) -> Position {
        self.find(of, name).map_or(self.begin, |field| field.value)
    }

    /// Where the value of a parameter stands, else that of `action_value`, else the row.
    pub fn parameter(&self, name: &str) -> Position {
        match self.find(Of::Parameters, name) {
            Some(field) => field.value,
            None => self.value(Of::Row, "action_value"),
        }
    }

    /// Where the name of a parameter stands, else the value of `action_value`, else the row.
    pub(super) fn parameter_key(&self, name: &str) -> Position {
        self.find(Of::Parameters, name).map_or_else(|| self.field("action_value"), |field| field.key)
    }

    /// Where the value of one of the row's own fields stands.
    pub fn field(&self, name: &str) -> Position {
        self.value(Of::Row, name)
    }

    /// The change of the text that mends a field. `None` where it stands twice or not at all, where its value is a list or
    /// a map that would be another one, where the name that it is to have is taken, and where a comment may be in the way.
    pub(super) fn mend(&self, of: Of, name: &str, mend: Option<Mend>) -> Option<Fix> {
        let is_only = |of, name| self.fields.iter().filter(|field| is(field, of, name)).count() == 1;
        if !is_only(of, name) || (of == Of::Parameters && !is_only(Of::Row, "action_value")) {
            return None;
        }
        let field = self.find(of, name)?;
        match mend? {
            Mend::Name(other) => {
                let text = Value::from(other.as_str()).to_string();
                self.find(of, &other).is_none().then(|| fix(field.key, field.key_end, text))
            }
            Mend::Value(text) => field.is_plain.then(|| fix(field.value, field.value_end, text)),
            Mend::Remove => self.removed(field),
        }
    }

    /// From now on a field is found under the name that it should have.
    pub(super) fn rename(&mut self, of: Of, name: &str, other: &str) {
        let named = self.fields.iter_mut().filter(|field| is(field, of, name));
        named.for_each(|field| other.clone_into(&mut field.name));
    }

    /// A field goes with the comma before it, the first one with that after it.
    fn removed(&self, field: &WrittenField) -> Option<Fix> {
        let beside = |other: &&WrittenField| other.is_parameter == field.is_parameter;
        let before = self.fields.iter().filter(beside).take_while(|other| other.key < field.key).last();
        let after = self.fields.iter().filter(beside).find(|other| other.key > field.key);
        let (from, to, gap) = match (before, after) {
            (Some(before), _) => (before.value_end, field.value_end, (before.value_end, field.key)),
            (None, Some(after)) => (field.key, after.key, (field.value_end, after.key)),
            (None, None) => (field.key, field.value_end, (field.key, field.key)),
        };
        // A comment has a line of its own.
        (gap.1.line <= gap.0.line.saturating_add(1)).then(|| fix(from, to, String::new()))
    }

    /// The change of the text that takes the whole row out.
    pub(super) fn without(&self) -> Fix {
        fix(self.begin, self.end, String::new())
    }

    /// Names that stand a second time, with their places.
    pub(super) fn doubled(&self) -> impl Iterator<Item = (&str, Position)> {
        let mut seen = HashSet::new();
        let again = self.fields.iter().filter(move |field| !seen.insert((field.is_parameter, field.name.as_str())));
        again.map(|field| (field.name.as_str(), field.key))
    }
}

fn is(field: &WrittenField, of: Of, name: &str) -> bool {
    field.is_parameter == (of == Of::Parameters) && field.name == name
}

/// The change that puts a text between two places.
pub(super) fn fix(from: Position, to: Position, text: String) -> Fix {
    Fix { line: from.line, column: from.column, end_line: to.line, end_column: to.column, text }
}

/// A field as bytes of its row.
struct FieldBytes {
    name: String,
    is_parameter: bool,
    key: Range<usize>,
    /// Where its value begins.
    value: usize,
}

/// The fields of an object, and those of its `action_value`; the text is known to be JSON.
fn spans(text: &str) -> Vec<FieldBytes> {
    let bytes = text.as_bytes();
    let mut found: Vec<FieldBytes> = Vec::new();
    let (mut at, mut depth) = (0, 0_usize);
    // Containers around `at`: is it an object, and is it the one whose fields are parameters?
    let mut around: Vec<(bool, bool)> = Vec::new();
    let (mut expects_key, mut expects_value) = (false, false);
    while let Some(byte) = bytes.get(at).copied() {
        let is_value = expects_value && !byte.is_ascii_whitespace() && byte != b':';
        if is_value {
            expects_value = false;
            if let Some(span) = found.last_mut() {
                span.value = at;
            }
        }
        match byte {
            b'"' => {
                let end = end_of_string(bytes, at);
                let (is_object, is_parameters) = around.last().copied().unwrap_or_default();
                if is_object && expects_key && (depth == 1 || is_parameters) {
                    let raw = text.get(at..end).unwrap_or_default();
                    let name = serde_json::from_str(raw).unwrap_or_else(|_| raw.trim_matches('"').to_owned());
                    found.push(FieldBytes { name, is_parameter: depth == 2, key: at..end, value: at });
                    expects_value = true;
                }
                expects_key = false;
                at = end;
                continue;
            }
            b'{' => {
                let named = found.last().is_some_and(|span| !span.is_parameter && span.name == "action_value");
                around.push((true, depth == 1 && is_value && named));
                (depth, expects_key) = (depth + 1, true);
            }
            b'[' => {
                around.push((false, false));
                depth += 1;
            }
            b'}' | b']' => {
                around.pop();
                depth = depth.saturating_sub(1);
                expects_key = false;
            }
            b',' => expects_key = around.last().is_some_and(|(is_object, _)| *is_object),
            _ => {}
        }
        at += 1;
    }
    found
}

/// The byte after the value that begins at `at`.
fn end_of_value(text: &str, at: usize) -> usize {
    let rest = text.get(at..).unwrap_or_default();
    let mut values = serde_json::Deserializer::from_str(rest).into_iter::<IgnoredAny>();
    let _ = values.next();
    at + values.byte_offset()
}

/// The byte after the string that begins at `at`.
fn end_of_string(bytes: &[u8], at: usize) -> usize {
    let mut end = at + 1;
    while let Some(byte) = bytes.get(end) {
        match byte {
            b'\\' => end += 2,
            b'"' => return end + 1,
            _ => end += 1,
        }
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(line: u32, column: u32) -> Position {
        Position { line, column }
    }

    #[test]
    fn fields_are_found_where_they_stand_and_not_in_what_they_hold() {
        let text = "  {\"device_name\": \"a \\\"exptime\\\": 5\",\n \"action_value\": {\"object\": \"é{,}\", \"exptime\" : 10,\n\"metadata\": {\"exptime\": 7}}, \"list\": [{\"exptime\": 1}], \"end_time\": \"x\"}";
        let written = Written::read(Cursor::new(text).to(2), text, text.len());
        assert_eq!(written.begin, at(1, 3));
        assert_eq!(written.field("device_name"), at(1, 19));
        assert_eq!(written.key(Of::Parameters, "object"), at(2, 19));
        assert_eq!(written.parameter("exptime"), at(2, 49));
        assert_eq!(written.parameter("metadata"), at(3, 13));
        assert_eq!(written.field("end_time"), at(3, 68));
        assert_eq!(written.parameter("filter"), written.field("action_value"));
        assert_eq!(written.field("start_time"), at(1, 3));
        assert_eq!(written.doubled().count(), 0);
    }

    #[test]
    fn a_name_that_stands_twice_is_seen() {
        let text = "{\"a\": 1, \"action_value\": {\"a\": 1, \"b\": 2,\n \"b\": 3}, \"a\": 2}";
        let written = Written::read(Cursor::new(text), text, text.len());
        let doubled: Vec<_> = written.doubled().collect();
        assert_eq!(doubled, [("b", at(2, 2)), ("a", at(2, 11))]);
    }
}
