//! The TOML document as a tree in which every key and value knows its path and its place in the text.

use std::collections::BTreeMap;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// A step from a table or list to what is in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// By key.
    Key(String),
    /// By position, from 0.
    Index(usize),
}

/// Where a key or value of the document stands.
#[derive(Debug, Clone)]
pub struct DocumentPlace {
    /// From the root.
    pub steps: Vec<Step>,
    /// Bytes of the text.
    pub span: Range<usize>,
    /// The key, not its value.
    pub is_key: bool,
}

/// A document whose keys and values carry a number in place of their span, so that an error about one of them names exactly
/// this one.
pub struct Document<'a> {
    text: &'a str,
    root: DeTable<'a>,
    places: Vec<DocumentPlace>,
    lines: BTreeMap<String, usize>,
}

/// A path as people write it: `camera[1].flats.sun_min_deg`.
pub fn written(steps: &[Step]) -> String {
    let mut path = String::new();
    for step in steps {
        match step {
            Step::Key(key) if path.is_empty() => path.push_str(key),
            Step::Key(key) => {
                path.push('.');
                path.push_str(key);
            }
            Step::Index(index) => path.push_str(&format!("[{index}]")),
        }
    }
    path
}

impl<'a> Document<'a> {
    /// Numbers the tree.
    pub fn new(text: &'a str, root: DeTable<'a>) -> Self {
        let mut document = Self { text, root, places: Vec::new(), lines: BTreeMap::new() };
        document.number();
        document
    }

    /// Numbers every key and value anew, after each change of the tree.
    fn number(&mut self) {
        let whole = DocumentPlace { steps: Vec::new(), span: 0..0, is_key: false };
        let before = std::mem::replace(&mut self.places, vec![whole]);
        let root = std::mem::take(&mut self.root);
        self.root = self.table(root, &mut Vec::new(), &before);
        let starts = self.places.iter().enumerate().filter(|(_, place)| !place.is_key).map(|(number, place)| {
            // a key stands before its value; elements of lists have a place of their own
            let before = number.checked_sub(1).and_then(|before| self.places.get(before));
            let key = before.filter(|key| key.is_key && key.steps == place.steps);
            (written(&place.steps), key.unwrap_or(place).span.clone())
        });
        // stand-ins have no place
        self.lines = starts.filter(|(_, span)| !span.is_empty()).map(|(path, span)| (path, span.start)).collect();
    }

    fn note(&mut self, steps: &[Step], span: Range<usize>, is_key: bool, before: &[DocumentPlace]) -> Range<usize> {
        let number = self.places.len();
        let span =
            if before.is_empty() { span } else { before.get(span.start).map_or(0..0, |place| place.span.clone()) };
        self.places.push(DocumentPlace { steps: steps.to_vec(), span, is_key });
        number..number + 1
    }

    fn table(&mut self, table: DeTable<'a>, steps: &mut Vec<Step>, before: &[DocumentPlace]) -> DeTable<'a> {
        let entries = table.into_iter().map(|(key, value)| {
            steps.push(Step::Key(key.get_ref().to_string()));
            let number = self.note(steps, key.span(), true, before);
            let value = self.value(value, steps, before);
            steps.pop();
            (Spanned::new(number, key.into_inner()), value)
        });
        entries.collect()
    }

    fn value(
        &mut self,
        value: Spanned<DeValue<'a>>,
        steps: &mut Vec<Step>,
        before: &[DocumentPlace],
    ) -> Spanned<DeValue<'a>> {
        let number = self.note(steps, value.span(), false, before);
        let inner = match value.into_inner() {
            DeValue::Table(table) => DeValue::Table(self.table(table, steps, before)),
            DeValue::Array(array) => {
                let elements = array.into_iter().enumerate().map(|(index, element)| {
                    steps.push(Step::Index(index));
                    let element = self.value(element, steps, before);
                    steps.pop();
                    element
                });
                DeValue::Array(elements.collect())
            }
            plain => plain,
        };
        Spanned::new(number, inner)
    }

    /// Lists that stand where `one` says that a table belongs, and what is no table where `of_many` wants one.
    pub fn misshapen(&self, one: fn(&[Step]) -> bool, of_many: fn(&[Step]) -> bool) -> Vec<DocumentPlace> {
        let wrong = |place: &&DocumentPlace| {
            let value = || value_ref(&self.root, &place.steps);
            !place.is_key
                && ((one(&place.steps) && value().is_some_and(DeValue::is_array))
                    || (of_many(&place.steps) && value().is_some_and(|value| !value.is_table())))
        };
        let mut found: Vec<DocumentPlace> = self.places.iter().filter(wrong).cloned().collect();
        // what is taken out later must not move what is taken out before
        found.reverse();
        found
    }

    /// What an error's span is about.
    pub fn place(&self, span: Option<Range<usize>>) -> Option<&DocumentPlace> {
        self.places.get(span?.start)
    }

    /// The tree, to be read once more.
    pub fn tree(&self) -> Spanned<DeTable<'a>> {
        Spanned::new(0..1, self.root.clone())
    }

    /// The text of a place, on one line and not longer than a message can bear.
    pub fn quoted(&self, place: &DocumentPlace) -> String {
        let whole = self.text.get(place.span.clone()).unwrap_or_default();
        let line = whole.lines().next().unwrap_or_default().trim();
        if line.chars().count() <= 60 { line.to_owned() } else { line.chars().take(57).chain("...".chars()).collect() }
    }

    /// Line and column, from 1, of a path; of what it is in where it stands nowhere itself.
    pub fn line_of(&self, path: &str) -> (usize, usize) {
        let mut path = path;
        loop {
            if let Some(start) = self.lines.get(path).filter(|_| !path.is_empty()) {
                return line_at(self.text, *start);
            }
            match path.rfind(['.', '[']) {
                Some(end) => path = &path[..end],
                None => return (0, 0),
            }
        }
    }

    /// Line and column, from 1, of a place.
    pub fn line_of_place(&self, place: &DocumentPlace) -> (usize, usize) {
        if place.steps.is_empty() { (0, 0) } else { line_at(self.text, place.span.start) }
    }

    /// Line and column, from 1, of the first text in quotes that is this one.
    pub fn line_with(&self, quoted: &str) -> Option<(usize, usize)> {
        let start = self.text.find(&format!("\"{quoted}\""))?;
        Some(line_at(self.text, start))
    }

    /// Keys of the table at a path.
    pub fn keys(&self, steps: &[Step]) -> Vec<String> {
        let at = descend_ref(&self.root, steps);
        at.map(|table| table.keys().map(|key| key.get_ref().to_string()).collect()).unwrap_or_default()
    }

    /// The text that stands at a path, if one does.
    pub fn text_at(&self, steps: &[Step], key: &str) -> Option<String> {
        let table = descend_ref(&self.root, steps)?;
        let value = table.iter().find(|(have, _)| have.get_ref() == key)?.1;
        value.get_ref().as_str().map(str::to_owned)
    }

    /// Takes what stands at a path out of the tree; with an element that is no table, the whole list.
    pub fn remove(&mut self, steps: &[Step]) {
        self.take_out(steps);
        self.number();
    }

    fn take_out(&mut self, steps: &[Step]) {
        let Some((last, before)) = steps.split_last() else {
            self.root = DeTable::new();
            return;
        };
        match (last, self.value_mut(before)) {
            (Step::Key(key), None) if before.is_empty() => drop(self.root.remove(key.as_str())),
            (Step::Key(key), Some(DeValue::Table(table))) => drop(table.remove(key.as_str())),
            (Step::Index(index), Some(DeValue::Array(list)))
                if list.get(*index).is_some_and(|element| element.get_ref().is_table()) =>
            {
                let others =
                    std::mem::replace(list, DeArray::new()).into_iter().enumerate().filter(|(at, _)| at != index);
                *list = others.map(|(_, element)| element).collect();
            }
            (Step::Index(_), _) => self.take_out(before),
            _ => {}
        }
    }

    /// Gives an entry another key.
    pub fn rename(&mut self, steps: &[Step], key: &str) {
        let Some((Step::Key(old), before)) = steps.split_last() else { return };
        let table = match self.value_mut(before) {
            None if before.is_empty() => &mut self.root,
            Some(DeValue::Table(table)) => table,
            _ => return,
        };
        if let Some((old, value)) = table.remove_entry(old.as_str()) {
            table.insert(Spanned::new(old.span(), key.to_owned().into()), value);
        }
        self.number();
    }

    /// Puts a value where one is missing; `steps` are those of the table.
    pub fn insert(&mut self, steps: &[Step], key: &str, value: DeValue<'a>) {
        let table = match self.value_mut(steps) {
            None if steps.is_empty() => &mut self.root,
            Some(DeValue::Table(table)) => table,
            _ => return,
        };
        table.insert(Spanned::new(0..1, key.to_owned().into()), Spanned::new(0..1, value));
        self.number();
    }

    /// Puts another value in the place of one.
    pub fn replace(&mut self, steps: &[Step], with: impl FnOnce(DeValue<'a>) -> DeValue<'a>) {
        if let Some(value) = self.value_mut(steps) {
            *value = with(std::mem::replace(value, DeValue::Boolean(false)));
        }
        self.number();
    }

    fn value_mut(&mut self, steps: &[Step]) -> Option<&mut DeValue<'a>> {
        let (Step::Key(first), rest) = steps.split_first()? else { return None };
        let mut value = self.root.get_mut(first.as_str())?.get_mut();
        for step in rest {
            value = match (step, value) {
                (Step::Key(key), DeValue::Table(table)) => table.get_mut(key.as_str())?.get_mut(),
                (Step::Index(index), DeValue::Array(array)) => array.get_mut(*index)?.get_mut(),
                _ => return None,
            };
        }
        Some(value)
    }
}

fn value_ref<'t, 'a>(root: &'t DeTable<'a>, steps: &[Step]) -> Option<&'t DeValue<'a>> {
    let (Step::Key(first), rest) = steps.split_first()? else { return None };
    let mut value = root.get(first.as_str())?.get_ref();
    for step in rest {
        value = match (step, value) {
            (Step::Key(key), DeValue::Table(table)) => table.get(key.as_str())?.get_ref(),
            (Step::Index(index), DeValue::Array(array)) => array.get(*index)?.get_ref(),
            _ => return None,
        };
    }
    Some(value)
}

fn descend_ref<'t, 'a>(root: &'t DeTable<'a>, steps: &[Step]) -> Option<&'t DeTable<'a>> {
    if steps.is_empty() { Some(root) } else { value_ref(root, steps)?.as_table() }
}

/// Line and column, from 1, of a byte of a text.
pub fn line_at(text: &str, byte: usize) -> (usize, usize) {
    let before = text.get(..byte).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    (line, column)
}
