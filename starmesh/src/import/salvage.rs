//! A configuration with mistakes in its syntax: the parts of it that can be read.
//!
//! The file is cut where a line begins with a key, and a part that is still not YAML at the entries of its list. What
//! can be read is taken, and the rest is noted with its lines.

use super::entry::Notes;
use super::yaml::{self, Node, Value, YamlError};

/// A file with more keys at its top is no configuration.
const MOST_PARTS: usize = 200;

/// Reads a whole file, or what can be read of it.
///
/// # Errors
/// The first mistake, where nothing of the file can be read.
pub fn read(text: &str, notes: &mut Notes) -> Result<Node, YamlError> {
    let whole = match yaml::read(text) {
        Ok(node) => return Ok(node),
        Err(whole) => whole,
    };
    let parts = parts(text);
    if parts.len() > MOST_PARTS {
        return Err(whole);
    }
    let mut reader = SalvageReader { anchors: String::new(), values: Vec::new() };
    let mut lost = Vec::new();
    for part in &parts {
        match reader.part(part) {
            Ok(()) => {}
            Err(error) => lost.extend(reader.entries(part, error)),
        }
    }
    if reader.values.is_empty() {
        return Err(whole);
    }
    for (from, to, error) in lost {
        notes.add(error.line, format!("{}; lines {from} to {to} are not carried over", error.what));
    }
    Ok(Node { line: 1, value: Value::Map(reader.values) })
}

/// Some lines of the file.
struct Part<'a> {
    /// The first, from 1.
    line: usize,
    lines: Vec<&'a str>,
}

impl Part<'_> {
    fn last(&self) -> usize {
        self.line + self.lines.len().saturating_sub(1)
    }
}

/// The lines of a part that was lost, and the reason.
type Lost = (usize, usize, YamlError);

struct SalvageReader {
    /// Parts that define anchors, for those that come later.
    anchors: String,
    values: Vec<(String, Node)>,
}

impl SalvageReader {
    fn part(&mut self, part: &Part<'_>) -> Result<(), YamlError> {
        let text = part.lines.concat();
        let (key, node) = self.last_of(&text, part.line)?;
        if text.contains('&') {
            self.anchors += &text;
        }
        self.add(key, node);
        Ok(())
    }

    /// Reads the entries of a part's list one by one.
    fn entries(&mut self, part: &Part<'_>, error: YamlError) -> Vec<Lost> {
        let all = |error| vec![(part.line, part.last(), error)];
        let [head, rest @ ..] = part.lines.as_slice() else { return all(error) };
        let indent = |line: &str| line.len() - line.trim_start().len();
        let dash = |line: &str| line.trim_start().starts_with("- ") || line.trim() == "-";
        let Some(level) = rest.iter().find(|line| dash(line)).map(|line| indent(line)) else { return all(error) };
        let mut entries: Vec<Part<'_>> = Vec::new();
        for (index, line) in rest.iter().enumerate() {
            if dash(line) && indent(line) == level {
                entries.push(Part { line: part.line + 1 + index, lines: Vec::new() });
            }
            if let Some(entry) = entries.last_mut() {
                entry.lines.push(line);
            }
        }
        let mut lost = Vec::new();
        for entry in &entries {
            match self.last_of(&format!("{}\n{}", head.trim_end(), entry.lines.concat()), entry.line - 1) {
                Ok((key, node)) => self.add(key, node),
                Err(error) => lost.push((entry.line, entry.last(), error)),
            }
        }
        lost
    }

    /// The one key of a text that begins in this line of the file.
    fn last_of(&self, text: &str, line: usize) -> Result<(String, Node), YamlError> {
        let before = self.anchors.matches('\n').count();
        let moved = |at: usize| (at + line).saturating_sub(1 + before).max(line);
        let read = yaml::read(&format!("{}{text}", self.anchors));
        let node = read.map_err(|error| YamlError { line: moved(error.line), ..error })?;
        match node.value {
            Value::Map(mut map) => map.pop().map(|(key, node)| (key, node.moved(&moved))),
            _ => None,
        }
        .ok_or(YamlError { line, what: "expected a key".to_owned() })
    }

    fn add(&mut self, key: String, node: Node) {
        match self.values.iter_mut().find(|(known, _)| *known == key) {
            Some((_, Node { value: Value::List(list), .. })) => match node.value {
                Value::List(more) => list.extend(more),
                _ => list.push(node),
            },
            Some(_) => {}
            None => self.values.push((key, node)),
        }
    }
}

/// The file in parts, each of which begins with a key at the margin.
fn parts(text: &str) -> Vec<Part<'_>> {
    let mut parts: Vec<Part<'_>> = Vec::new();
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let begins = line.starts_with(|c: char| c.is_alphanumeric() || c == '_' || c == '"' || c == '\'');
        if begins {
            parts.push(Part { line: index + 1, lines: Vec::new() });
        }
        if let Some(part) = parts.last_mut() {
            part.lines.push(line);
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mistake_costs_the_entry_that_it_is_in() {
        let text = "Telescope: &t\n  - {device_name: m, ip: \"h:1\"}\nCamera:\n  - device_name: a\n    flats: {x: 1\n  - device_name: b\n    \
                    ip: h\n  - device_name: c\n   ip: h\nDome: [{device_name: d\nSame: *t\n";
        let mut notes = Notes::default();
        let node = read(text, &mut notes).unwrap();
        let Value::Map(map) = &node.value else { panic!("{node:?}") };
        let keys: Vec<&str> = map.iter().map(|(key, _)| key.as_str()).collect();
        assert_eq!(keys, ["Telescope", "Camera", "Same"]);
        let Value::List(cameras) = &map[1].1.value else { panic!("{map:?}") };
        assert_eq!((cameras.len(), cameras[0].line), (1, 6), "{cameras:?}");
        let lines: Vec<&str> = notes.lines.iter().map(|(_, what)| what.rsplit("; ").next().unwrap()).collect();
        let expected =
            ["lines 4 to 5", "lines 8 to 9", "lines 10 to 10"].map(|lines| format!("{lines} are not carried over"));
        assert_eq!(lines, expected, "{notes:?}");
        assert!(read("[1, 2\n", &mut notes).is_err());
    }
}
