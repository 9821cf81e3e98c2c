//! One map of the predecessor's files, read key by key; what nobody asked for is told.

use super::yaml::{Node, Value};

/// What could not be carried over, or should be looked at, each with its line.
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
    /// What it is, for messages: `Telescope mount_a`.
    pub place: String,
    /// Its first line.
    pub line: usize,
    /// What nobody has asked for.
    left: Vec<(&'a str, &'a Node)>,
}

impl<'a> Entry<'a> {
    /// A node as a map; anything else is noted.
    pub fn of(place: &str, node: &'a Node, notes: &mut Notes) -> Option<Self> {
        match &node.value {
            Value::Map(map) => {
                let left = map.iter().map(|(key, node)| (key.as_str(), node)).collect();
                Some(Self { place: place.to_owned(), line: node.line, left })
            }
            Value::Null => None,
            other => {
                notes.add(node.line, format!("{place}: expected keys and values, found {}", told(other)));
                None
            }
        }
    }

    /// The value of a key, if it has one.
    pub fn take(&mut self, key: &str) -> Option<&'a Node> {
        let at = self.left.iter().position(|(known, _)| *known == key)?;
        let (_, node) = self.left.remove(at);
        (node.value != Value::Null).then_some(node)
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
            // beyond 2^53 no number of a device is written
            Value::Number(number) if number.fract() == 0.0 && number.abs() < 9e15 => Some(*number as i64),
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

    /// `true` or `false`.
    pub fn flag(&mut self, key: &str, notes: &mut Notes) -> Option<bool> {
        self.typed(key, "true or false", notes, |value| match value {
            Value::Bool(flag) => Some(*flag),
            _ => None,
        })
    }

    /// A list of texts.
    pub fn texts(&mut self, key: &str, notes: &mut Notes) -> Vec<String> {
        let texts = self.typed(key, "a list of names", notes, |value| match value {
            Value::List(list) => list
                .iter()
                .map(|node| match &node.value {
                    Value::Text(text) => Some(text.clone()),
                    _ => None,
                })
                .collect::<Option<Vec<String>>>(),
            _ => None,
        });
        texts.unwrap_or_default()
    }

    /// A map within.
    pub fn entry(&mut self, key: &str, notes: &mut Notes) -> Option<Entry<'a>> {
        let node = self.take(key)?;
        Entry::of(&format!("{}: {key}", self.place), node, notes)
    }

    /// A list of maps within; a single map counts as a list of one.
    pub fn entries(&mut self, key: &str, notes: &mut Notes) -> Vec<Entry<'a>> {
        let place = format!("{}: {key}", self.place);
        let Some(node) = self.take(key) else { return Vec::new() };
        match &node.value {
            Value::List(list) => list.iter().filter_map(|node| Entry::of(&place, node, notes)).collect(),
            _ => Entry::of(&place, node, notes).into_iter().collect(),
        }
    }

    /// Names of all keys that nobody has asked for yet.
    pub fn keys(&self) -> Vec<String> {
        self.left.iter().map(|(key, _)| (*key).to_owned()).collect()
    }

    /// Notes all that nobody has asked for, and why.
    pub fn rest(self, why: &str, notes: &mut Notes) {
        for (key, node) in self.left {
            notes.add(node.line, format!("{}: {key} = {}: {why}", self.place, told(&node.value)));
        }
    }

    fn typed<T>(
        &mut self,
        key: &str,
        expected: &str,
        notes: &mut Notes,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Option<T> {
        let node = self.take(key)?;
        let value = read(&node.value);
        if value.is_none() {
            let found = told(&node.value);
            notes
                .add(node.line, format!("{}: {key}: expected {expected}, found {found}; not carried over", self.place));
        }
        value
    }
}

/// A value in few words.
fn told(value: &Value) -> String {
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
    }
}
