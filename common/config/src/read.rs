//! Reads the document into [`Observatory`], and goes on after each fault, so that one reading shows all of them.
//!
//! What is at fault is mended in the tree (a misspelt key gets its right name, a wrong value goes, a missing one gets a
//! stand-in), the tree is read once more, and so on. Nothing that was mended is ever used: a document with a fault is refused.

use std::collections::BTreeSet;

use contract::observatory::Severity;
use serde::Deserialize as _;
use toml::de::{DeTable, DeValue};

use crate::document::{Document, DocumentPlace, Step, line_at, written};
use crate::fault::Fault;
use crate::nearest::meant;
use crate::observatory::Observatory;
use crate::words::{self, Complaint};

/// More faults than so many are not looked for; each costs a reading of the file.
const MOST_FAULTS: usize = 60;

/// Stand-ins for what follows from a fault cost readings too.
const MOST_READINGS: usize = 4 * MOST_FAULTS;

/// What a reading left behind.
pub struct Reading<'a> {
    /// The document, for the lines of what is found later.
    pub document: Document<'a>,
    /// The values; stand-ins where there are faults. Absent where the reading could not go on.
    pub observatory: Option<Observatory>,
    /// What is wrong.
    pub faults: Vec<Fault>,
    /// Paths that are at fault already: nothing else is reported of them.
    pub spoilt: BTreeSet<String>,
    /// Lines of it are no TOML, so that what stands in them is not known.
    pub torn: bool,
}

/// Reads a text as far as it can be read.
pub fn read(text: &str) -> Reading<'_> {
    let (root, wrong) = DeTable::parse_recoverable(text);
    let mut reading = Reading {
        document: Document::new(text, root.into_inner()),
        observatory: None,
        faults: Vec::new(),
        spoilt: BTreeSet::new(),
        torn: !wrong.is_empty(),
    };
    let torn = reading.torn;
    for error in wrong.iter().take(MOST_FAULTS) {
        let (line, column) = error.span().map_or((0, 0), |span| line_at(text, span.start));
        let written = text.lines().nth(line.saturating_sub(1)).unwrap_or_default().trim();
        // what the parser makes of the rest of a torn line helps nobody, and neither do the keys of a block that may not be there
        let heading = text.lines().take(line).collect::<Vec<_>>().iter().rposition(|line| line.trim().starts_with('['));
        let is_reported = |fault: &Fault| {
            fault.line == line
                || (error.message().contains("duplicate key") && Some(fault.line) == heading.map(|at| at + 1))
        };
        if !reading.faults.iter().any(is_reported) {
            let what = words::syntax(error.message(), written);
            reading.faults.push(Fault { line, column, severity: Severity::Error, what });
        }
    }
    reading.shapes();
    for _ in 0..MOST_READINGS {
        if reading.faults.len() >= MOST_FAULTS {
            break;
        }
        let error = match Observatory::deserialize(toml::Deserializer::from(reading.document.tree())) {
            Ok(observatory) => {
                reading.observatory = Some(observatory);
                break;
            }
            Err(error) => error,
        };
        let Some(place) = reading.document.place(error.span()).cloned() else {
            reading.add(&DocumentPlace { steps: Vec::new(), span: 0..0, is_key: false }, error.message().to_owned());
            break;
        };
        reading.take(&place, words::complaint(error.message()), torn);
    }
    reading
}

impl Reading<'_> {
    fn add(&mut self, place: &DocumentPlace, what: String) {
        let (line, column) = self.document.line_of_place(place);
        // nothing else is reported of a line that is no TOML
        if line == 0 || self.faults.iter().all(|fault| fault.line != line || !fault.what.starts_with(words::TORN)) {
            self.faults.push(Fault { line, column, severity: Severity::Error, what });
        }
    }

    /// Lists where tables belong and the other way round; the reader would take some of them for tables without keys.
    fn shapes(&mut self) {
        for place in self.document.misshapen(words::is_one_table, words::is_list_of_tables) {
            if self.faults.len() >= MOST_FAULTS {
                return;
            }
            let complaint = match place.steps.as_slice() {
                [Step::Key(_)] => Complaint::OneTable,
                _ => Complaint::Value(words::Expected::Sort("a table")),
            };
            self.take(&place, complaint, false);
        }
    }

    /// Where a person finds it: `camera "main": flats.sun_min_deg`, `observatory.site`.
    fn shown(&self, steps: &[Step]) -> String {
        let (block, rest) = match steps {
            [Step::Key(kind), Step::Index(index), rest @ ..] => {
                let name = self.document.text_at(&[Step::Key(kind.clone()), Step::Index(*index)], "name");
                let which = name.map_or_else(|| format!("number {}", index + 1), |name| format!("\"{name}\""));
                (format!("{kind} {which}: "), rest)
            }
            rest => (String::new(), rest),
        };
        format!("{block}{}", written(rest))
    }

    fn take(&mut self, place: &DocumentPlace, complaint: Complaint<'_>, torn: bool) {
        let steps = place.steps.as_slice();
        match complaint {
            Complaint::UnknownKey { key, known } => self.unknown_key(place, key, &known),
            Complaint::MissingKey(key) => {
                let mut path = steps.to_vec();
                path.push(Step::Key(key.to_owned()));
                let is_reported = torn || !self.spoilt.insert(written(&path));
                if !is_reported {
                    let shown = self.shown(&path);
                    self.add(place, format!("{shown} is missing: expected {}", words::about(&path)));
                }
                match words::stand_in(key, self.faults.len()) {
                    Some(value) => self.document.insert(steps, key, value),
                    None => self.document.remove(steps),
                }
            }
            Complaint::List => {
                let shown = self.shown(steps);
                let what = match steps {
                    [Step::Key(key)] if words::is_list_of_blocks(key) => {
                        format!("[{key}] is written [[{key}]], with two brackets, since there may be several")
                    }
                    _ => format!("{shown}: expected a list in square brackets, such as [{}]", words::about(steps)),
                };
                self.add(place, what);
                let is_block = matches!(steps, [Step::Key(key)] if words::is_list_of_blocks(key));
                if is_block {
                    self.document.replace(steps, |value| {
                        let mut list = toml::de::DeArray::new();
                        list.push(toml::Spanned::new(0..1, value));
                        DeValue::Array(list)
                    });
                } else {
                    self.spoil(steps);
                }
            }
            Complaint::OneTable => {
                let shown = self.shown(steps);
                self.add(place, format!("[[{shown}]] is written [{shown}], with one bracket, and stands there once"));
                self.document.replace(steps, |value| match value {
                    DeValue::Array(list) => {
                        list.into_iter().next().map_or(DeValue::Boolean(false), toml::Spanned::into_inner)
                    }
                    other => other,
                });
            }
            Complaint::Value(expected) => {
                let (shown, quoted) = (self.shown(steps), self.document.quoted(place));
                let expected = words::expected(&expected, steps, &quoted);
                self.add(place, format!("{shown} = {quoted}: {expected}"));
                self.spoil(steps);
            }
        }
    }

    fn spoil(&mut self, steps: &[Step]) {
        let table = steps.iter().rposition(|step| matches!(step, Step::Key(_))).map_or(steps, |last| &steps[..=last]);
        self.spoilt.insert(written(table));
        self.document.remove(steps);
    }

    fn unknown_key(&mut self, place: &DocumentPlace, key: &str, known: &[&str]) {
        let table = place.steps.split_last().map_or(&[][..], |(_, before)| before);
        let keys: Vec<Step> = table.iter().filter(|step| matches!(step, Step::Key(_))).cloned().collect();
        let within = match table {
            [] => "this file".to_owned(),
            [.., Step::Index(_)] => format!("[[{}]]", written(&keys)),
            _ => format!("[{}]", written(&keys)),
        };
        let shown = self.shown(table);
        let begin = match table {
            [Step::Key(kind), Step::Index(_), rest @ ..] if words::is_list_of_blocks(kind) => {
                shown.strip_suffix(written(rest).as_str()).unwrap_or_default().to_owned()
            }
            _ => String::new(),
        };
        let elsewhere = words::belongs_to(key, table);
        let help = elsewhere.unwrap_or_else(|| meant(key, known.iter().copied()));
        self.add(place, format!("{begin}there is no key \"{key}\" in {within}; {help}"));
        let have = self.document.keys(table);
        let near =
            crate::nearest::nearest(key, known.iter().copied()).filter(|near| !have.iter().any(|key| key == near));
        let Some(near) = near else { return self.document.remove(&place.steps) };
        self.document.rename(&place.steps, near);
        let mut renamed = table.to_vec();
        renamed.push(Step::Key(near.to_owned()));
        // a list under the name of one table, or the other way round, was meant to be something else; and a value may be in
        // another unit, so that it is kept only where one must be
        let misshapen = self.document.misshapen(words::is_one_table, words::is_list_of_tables);
        let has_keys = !self.document.keys(&renamed).is_empty() || words::is_list_of_blocks(near);
        let is_needed = has_keys || words::stand_in(near, 0).is_some();
        if !is_needed || misshapen.iter().any(|wrong| wrong.steps == renamed) {
            self.spoil(&renamed);
        }
    }
}
