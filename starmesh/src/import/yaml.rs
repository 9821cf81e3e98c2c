//! YAML as values that know their line.

use std::collections::HashMap;

use saphyr_parser::{Event, Parser, ScalarStyle};

/// A value and where it begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Line of the file, from 1.
    pub line: usize,
    /// The value itself.
    pub value: Value,
}

impl Node {
    /// The same in another place: each line is changed by `moved`.
    pub fn moved(self, moved: &dyn Fn(usize) -> usize) -> Self {
        let value = match self.value {
            Value::List(list) => Value::List(list.into_iter().map(|node| node.moved(moved)).collect()),
            Value::Map(map) => Value::Map(map.into_iter().map(|(key, node)| (key, node.moved(moved))).collect()),
            other => other,
        };
        Self { line: moved(self.line), value }
    }
}

/// The values that a YAML file of a site may have.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Nothing, `~` or `null`.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A number, always finite.
    Number(f64),
    /// Anything else that is plain, and all that is quoted.
    Text(String),
    /// A list.
    List(Vec<Node>),
    /// A map, in the order of the file.
    Map(Vec<(String, Node)>),
    /// There are two values under one key, and no rule decides between them; the text has their lines.
    Unclear(String),
}

/// Why a text is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct YamlError {
    /// Line of the file, from 1.
    pub line: usize,
    /// The fault and what was expected.
    pub what: String,
}

/// Larger files are no configuration of a site.
const MOST_BYTES: usize = 1 << 20;
/// Values within values, at most.
const DEEPEST: usize = 40;
/// Values of a file, those that anchors repeat included.
const MOST_VALUES: usize = 100_000;

/// Reads the one document of a text; an empty text is [`Value::Null`].
///
/// # Errors
/// [`YamlError`] for what is no YAML, has two documents, a key that is no plain word, or is nested or repeated without
/// end. A key that occurs twice costs that key alone: [`Value::Unclear`].
pub fn read(text: &str) -> Result<Node, YamlError> {
    if text.len() > MOST_BYTES {
        let what = format!("{} bytes; a configuration has at most {MOST_BYTES}", text.len());
        return Err(YamlError { line: 1, what });
    }
    let mut reader = YamlReader { anchors: HashMap::new(), open: Vec::new(), done: None, values: 0 };
    for event in Parser::new_from_str(text) {
        match event {
            Ok((event, span)) => reader.take(event, span.start.line())?,
            Err(error) => {
                return Err(YamlError { line: error.marker().line(), what: format!("no YAML: {}", error.info()) });
            }
        }
    }
    Ok(reader.done.unwrap_or(Node { line: 1, value: Value::Null }))
}

struct YamlReader {
    anchors: HashMap<usize, Node>,
    open: Vec<Open>,
    done: Option<Node>,
    values: usize,
}

/// A list or map whose end has not come yet.
struct Open {
    line: usize,
    anchor: usize,
    inside: Inside,
}

enum Inside {
    List(Vec<Node>),
    Map(Vec<(String, Node)>, Option<String>),
}

impl YamlReader {
    fn take(&mut self, event: Event<'_>, line: usize) -> Result<(), YamlError> {
        let wrong = |what: String| Err(YamlError { line, what });
        match event {
            Event::Scalar(text, style, anchor, tag) => {
                // A tag such as !!str forces a text.
                let plain = style == ScalarStyle::Plain && tag.is_none();
                let value = if plain { plain_value(&text) } else { Value::Text(text.into_owned()) };
                self.put(anchor, Node { line, value })
            }
            Event::SequenceStart(anchor, _) => self.open(line, anchor, Inside::List(Vec::new())),
            Event::MappingStart(anchor, _) => self.open(line, anchor, Inside::Map(Vec::new(), None)),
            Event::SequenceEnd | Event::MappingEnd => {
                let Some(Open { line, anchor, inside }) = self.open.pop() else {
                    return wrong("a list or map ends that never began".to_owned());
                };
                let value = match inside {
                    Inside::List(list) => Value::List(list),
                    Inside::Map(map, _) => Value::Map(merged(map)),
                };
                self.put(anchor, Node { line, value })
            }
            Event::Alias(anchor) => match self.anchors.get(&anchor).cloned() {
                Some(node) => {
                    self.values += size(&node);
                    self.put(0, Node { line, ..node })
                }
                None => wrong("an alias (*name) without its anchor (&name)".to_owned()),
            },
            Event::DocumentStart(_) if self.done.is_some() => wrong("a second document; expected one".to_owned()),
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentStart(_) | Event::DocumentEnd => {
                Ok(())
            }
        }
    }

    fn open(&mut self, line: usize, anchor: usize, inside: Inside) -> Result<(), YamlError> {
        if let Some(Open { inside: Inside::Map(_, None), .. }) = self.open.last() {
            return Err(YamlError { line, what: "a list or map stands where a key was expected".to_owned() });
        }
        if self.open.len() >= DEEPEST {
            return Err(YamlError { line, what: format!("nested deeper than {DEEPEST}") });
        }
        self.open.push(Open { line, anchor, inside });
        Ok(())
    }

    fn put(&mut self, anchor: usize, node: Node) -> Result<(), YamlError> {
        let line = node.line;
        self.values += 1;
        if self.values > MOST_VALUES {
            return Err(YamlError { line, what: format!("more than {MOST_VALUES} values, repeated ones included") });
        }
        if anchor != 0 {
            self.values += size(&node);
            self.anchors.insert(anchor, node.clone());
        }
        match self.open.last_mut().map(|open| &mut open.inside) {
            None => self.done = Some(node),
            Some(Inside::List(list)) => list.push(node),
            Some(Inside::Map(map, key)) => match key.take() {
                Some(key) => add(map, key, node),
                None => {
                    let word = match node.value {
                        Value::Text(text) => text,
                        Value::Number(number) => number.to_string(),
                        Value::Bool(word) => word.to_string(),
                        _ => return Err(YamlError { line, what: "expected a word as key".to_owned() }),
                    };
                    *key = Some(word);
                }
            },
        }
        Ok(())
    }
}

/// YAML 1.1's key for values that are taken over from another map.
const MERGE: &str = "<<";

/// Adds a value to a map. Two lists under one key become one; of two other values that differ no rule decides which one
/// holds.
fn add(map: &mut Vec<(String, Node)>, key: String, node: Node) {
    let Some((_, known)) = map.iter_mut().find(|(known, _)| *known == key && key != MERGE) else {
        return map.push((key, node));
    };
    match (&mut known.value, node.value) {
        (Value::List(list), Value::List(more)) => list.extend(more),
        (known, new) if is_same(known, &new) => {}
        (known_value, _) => {
            let what = format!("two values, in lines {} and {}", known.line, node.line);
            *known_value = Value::Unclear(what);
        }
    }
}

/// Whether two values are equal, wherever they are.
fn is_same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::List(a), Value::List(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(&a.value, &b.value))
        }
        (Value::Map(a), Value::Map(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.0 == b.0 && is_same(&a.1.value, &b.1.value))
        }
        _ => a == b,
    }
}

/// A map with what it takes over by `<<`; its own values hold before those.
fn merged(map: Vec<(String, Node)>) -> Vec<(String, Node)> {
    let (sources, mut own): (Vec<_>, Vec<_>) = map.into_iter().partition(|(key, _)| key == MERGE);
    for (key, source) in sources {
        let maps = match source.value {
            Value::List(list) => list,
            _ => vec![source],
        };
        for node in maps {
            match node.value {
                Value::Map(values) => {
                    for (key, value) in values {
                        if !own.iter().any(|(known, _)| *known == key) {
                            own.push((key, value));
                        }
                    }
                }
                Value::Null => {}
                // Stored under its own name, so that it is listed.
                _ => own.push((key.clone(), node)),
            }
        }
    }
    own
}

fn size(node: &Node) -> usize {
    1 + match &node.value {
        Value::List(list) => list.iter().map(size).sum(),
        Value::Map(map) => map.iter().map(|(_, node)| size(node)).sum(),
        _ => 0,
    }
}

/// The value of an unquoted word, by the core schema of YAML 1.2; a number that is not finite stays a text.
fn plain_value(text: &str) -> Value {
    match text {
        "" | "~" | "null" | "Null" | "NULL" => return Value::Null,
        "true" | "True" | "TRUE" => return Value::Bool(true),
        "false" | "False" | "FALSE" => return Value::Bool(false),
        _ => {}
    }
    for (prefix, radix) in [("0x", 16), ("0o", 8)] {
        if let Some(number) = text.strip_prefix(prefix).and_then(|digits| u32::from_str_radix(digits, radix).ok()) {
            return Value::Number(f64::from(number));
        }
    }
    // Rust also takes "inf" and "nan".
    let looks = text.trim_start_matches(['+', '-']).starts_with(|c: char| c.is_ascii_digit() || c == '.');
    match text.parse::<f64>() {
        Ok(number) if looks && number.is_finite() => Value::Number(number),
        _ => Value::Text(text.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn get<'a>(node: &'a Node, key: &str) -> &'a Node {
        let Value::Map(map) = &node.value else { panic!("{node:?}") };
        &map.iter().find(|(known, _)| known == key).unwrap().1
    }

    #[test]
    fn values_have_their_types_and_lines() {
        let node = read("a:\n  - n: 1.5 # comment\n    t: '1.5'\n    b: false\n+x: East\nempty:\n").unwrap();
        let Value::List(list) = &get(&node, "a").value else { panic!() };
        assert_eq!(*get(&list[0], "n"), Node { line: 2, value: Value::Number(1.5) });
        assert_eq!(*get(&list[0], "t"), Node { line: 3, value: Value::Text("1.5".to_owned()) });
        assert_eq!(get(&list[0], "b").value, Value::Bool(false));
        assert_eq!(get(&node, "+x").value, Value::Text("East".to_owned()));
        assert_eq!(get(&node, "empty").value, Value::Null);
    }

    #[test]
    fn anchors_are_followed_but_not_without_end() {
        let node = read("a: &one {x: 1}\nb: *one\n").unwrap();
        assert_eq!(get(get(&node, "b"), "x").value, Value::Number(1.0));
        let mut bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n".to_owned();
        for n in 1..10 {
            let refs = vec![format!("*a{}", n - 1); 10].join(", ");
            bomb += &format!("a{n}: &a{n} [{refs}]\n");
        }
        assert!(read(&bomb).unwrap_err().what.contains("values"));
    }

    #[test]
    fn a_map_takes_over_what_it_does_not_set_itself() {
        let text = "base: &b {ip: h, n: 1}\nother: &o {n: 5, m: 6}\na:\n  <<: *b\n  n: 2\nb: {<<: [*b, *o], x: 3}\n";
        let node = read(text).unwrap();
        let a = get(&node, "a");
        assert_eq!(get(a, "ip").value, Value::Text("h".to_owned()));
        assert_eq!(get(a, "n").value, Value::Number(2.0), "its own value holds");
        let b = get(&node, "b");
        assert_eq!((&get(b, "n").value, &get(b, "m").value), (&Value::Number(1.0), &Value::Number(6.0)));
    }

    #[test]
    fn of_two_values_under_one_key_none_is_taken_unless_they_are_equal() {
        let node = read("a: 1\nb: 2\na: 3\nb: 2\nc: [1]\nc: [2]\n").unwrap();
        assert_eq!(get(&node, "a").value, Value::Unclear("two values, in lines 1 and 3".to_owned()));
        assert_eq!(get(&node, "b").value, Value::Number(2.0));
        assert!(matches!(&get(&node, "c").value, Value::List(list) if list.len() == 2));
    }

    #[test]
    fn what_is_wrong_is_reported_with_its_line() {
        for (text, line, what) in [
            ("a: [1, 2\nb: 3\n", 2, "no YAML"),
            ("a: 1\n---\nb: 2\n", 2, "second document"),
            ("? [1]\n: 2\n", 1, "key"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.what.contains(what) && error.line.abs_diff(line) <= 1, "{text}: {error}");
        }
        for deep in ["[", "{a: ", "- ", "? ", "[[]\n,"] {
            assert!(read(&deep.repeat(100_000)).is_err(), "{deep}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_ends_the_program(text in "[-:a&*#|>\\[\\]{},?! \\n\"'1%.]{0,200}") {
            let _ = read(&text);
        }
    }
}
