//! One map of the predecessor's files, read key by key; keys that nobody read are reported.

use super::yaml::{Node, Value};

/// The keys that could not be carried over, or should be checked, each with its line.
#[derive(Debug, Default)]
pub struct Notes {
    /// Line of the file, from 1, and a sentence.
    pub lines: Vec<(usize, String)>,
}

impl Notes {
    /// Adds a note.
    pub fn add(&mut self, line: usize, what: impl Into<String>) {
        self.lines.push((line, what.into()));
    }
}

/// A map that is read key by key.
#[derive(Debug)]
pub struct Entry<'a> {
    /// The name of the map, for messages: `Telescope mount_a`.
    pub place: String,
    /// Its first line.
    pub line: usize,
    /// Line of the key that was asked for last.
    pub last: usize,
    /// The keys that nobody has asked for.
    left: Vec<(&'a str, &'a Node)>,
}

impl<'a> Entry<'a> {
    /// A node as a map; anything else is noted.
    pub fn of(place: &str, node: &'a Node, notes: &mut Notes) -> Option<Self> {
        match &node.value {
            Value::Map(map) => {
                let left = map.iter().map(|(key, node)| (key.as_str(), node)).collect();
                Some(Self { place: place.to_owned(), line: node.line, last: node.line, left })
            }
            Value::Null => None,
            other => {
                notes.add(node.line, format!("{place}: expected keys and values, found {}", in_words(other)));
                None
            }
        }
    }

    /// The value of a key, if it has one.
    pub fn take(&mut self, key: &str) -> Option<&'a Node> {
        let at = self.left.iter().position(|(known, _)| *known == key)?;
        let (_, node) = self.left.remove(at);
        self.last = node.line;
        (node.value != Value::Null).then_some(node)
    }

    /// Whether a key is there, be it without a value.
    pub fn has(&self, key: &str) -> bool {
        self.left.iter().any(|(known, _)| *known == key)
    }

    /// Notes a key without a value.
    fn note_empty(&mut self, key: &str, notes: &mut Notes) {
        if let Some((_, node)) = self.left.iter().find(|(known, node)| *known == key && node.value == Value::Null) {
            notes.add(node.line, format!("{}: {key}: has no value; it is taken as if it were not there", self.place));
        }
    }

    /// A number.
    pub fn number(&mut self, key: &str, notes: &mut Notes) -> Option<f64> {
        self.typed(key, "a number", notes, |value| match value {
            Value::Number(number) => Some(*number),
            Value::Text(text) => text.trim().parse().ok().filter(|number: &f64| number.is_finite()),
            _ => None,
        })
    }

    /// A number without fraction.
    pub fn whole(&mut self, key: &str, notes: &mut Notes) -> Option<i64> {
        self.typed(key, "a whole number", notes, |value| match value {
            // Beyond 2^53 no number of a device is written.
            Value::Number(number) if number.fract() == 0.0 && number.abs() < 9e15 => Some(*number as i64),
            Value::Text(text) => text.trim().parse().ok(),
            _ => None,
        })
    }

    /// A text; numbers and truth values are taken as they are written.
    pub fn text(&mut self, key: &str, notes: &mut Notes) -> Option<String> {
        self.typed(key, "a text", notes, |value| match value {
            Value::Text(text) => Some(text.clone()),
            Value::Number(number) => Some(number.to_string()),
            Value::Bool(word) => Some(word.to_string()),
            _ => None,
        })
    }

    /// `true` or `false`; words and numbers that mean one of them are taken for it, and noted.
    pub fn flag(&mut self, key: &str, notes: &mut Notes) -> Option<bool> {
        let is_plain = |node: &Node| matches!(node.value, Value::Bool(_) | Value::Null);
        let odd = self.left.iter().find(|(known, node)| *known == key && !is_plain(node)).map(|(_, node)| *node);
        let flag = self.typed(key, "true or false", notes, |value| match value {
            Value::Bool(flag) => Some(*flag),
            Value::Number(number) if *number == 0.0 || *number == 1.0 => Some(*number == 1.0),
            Value::Text(text) => match text.trim().to_ascii_lowercase().as_str() {
                "true" | "yes" | "on" | "y" => Some(true),
                "false" | "no" | "off" | "n" => Some(false),
                _ => None,
            },
            _ => None,
        });
        if let (Some(flag), Some(node)) = (flag, odd) {
            let found = in_words(&node.value);
            let what = format!("{found} is taken for {flag}; Astra takes every text that is not empty for true");
            notes.add(node.line, format!("{}: {key}: {what}", self.place));
        }
        flag
    }

    /// A list of texts.
    pub fn texts(&mut self, key: &str, notes: &mut Notes) -> Vec<String> {
        let texts = self.typed(key, "a list of names", notes, |value| match value {
            Value::List(list) => list
                .iter()
                .map(|node| match &node.value {
                    Value::Text(text) => Some(text.clone()),
                    Value::Number(number) => Some(number.to_string()),
                    _ => None,
                })
                .collect::<Option<Vec<String>>>(),
            // One name that is not in a list.
            Value::Text(text) => Some(vec![text.clone()]),
            _ => None,
        });
        texts.unwrap_or_default()
    }

    /// A map within.
    pub fn entry(&mut self, key: &str, notes: &mut Notes) -> Option<Entry<'a>> {
        self.note_empty(key, notes);
        let node = self.take(key)?;
        Entry::of(&format!("{}: {key}", self.place), node, notes)
    }

    /// A list of maps within; a single map counts as a list of one.
    pub fn entries(&mut self, key: &str, notes: &mut Notes) -> Vec<Entry<'a>> {
        let place = format!("{}: {key}", self.place);
        self.note_empty(key, notes);
        let Some(node) = self.take(key) else { return Vec::new() };
        match &node.value {
            Value::List(list) => list
                .iter()
                .filter_map(|node| {
                    if node.value == Value::Null {
                        notes.add(node.line, format!("{place}: an entry without keys; not carried over"));
                    }
                    Entry::of(&place, node, notes)
                })
                .collect(),
            _ => Entry::of(&place, node, notes).into_iter().collect(),
        }
    }

    /// Names of all keys that nobody has asked for yet.
    pub fn keys(&self) -> Vec<String> {
        self.left.iter().map(|(key, _)| (*key).to_owned()).collect()
    }

    /// Notes all keys that nobody has asked for, and why.
    pub fn rest(self, why: &str, notes: &mut Notes) {
        for (key, node) in self.left {
            notes.add(node.line, format!("{}: {key} = {}: {why}", self.place, in_words(&node.value)));
        }
    }

    fn typed<T>(
        &mut self,
        key: &str,
        expected: &str,
        notes: &mut Notes,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Option<T> {
        self.note_empty(key, notes);
        let node = self.take(key)?;
        let value = read(&node.value);
        if value.is_none() {
            let found = in_words(&node.value);
            notes
                .add(node.line, format!("{}: {key}: expected {expected}, found {found}; not carried over", self.place));
        }
        value
    }
}

/// A value in few words.
fn in_words(value: &Value) -> String {
    match value {
        Value::Null => "nothing".to_owned(),
        Value::Bool(flag) => flag.to_string(),
        Value::Number(number) => number.to_string(),
        Value::Text(text) => format!("{text:?}"),
        Value::List(list) => format!("a list of {}", list.len()),
        Value::Map(map) => {
            let keys: Vec<&str> = map.iter().map(|(key, _)| key.as_str()).collect();
            format!("{{{}}}", keys.join(", "))
        }
        Value::Unclear(what) => what.clone(),
    }
}
