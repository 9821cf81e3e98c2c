//! The actions as people read them: the generated part of `docs/operator/schedule.md`, and what `starmesh actions` prints.

use std::fmt::Write as _;

use contract::observatory::ActionKind;
use serde_json::Value;

use super::{ACTIONS, Entry, Needs, schema};

/// A parameter, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parameter<'a> {
    /// As it stands in `action_value`; `elements.epoch` is `epoch` within the map `elements`.
    pub name: String,
    /// `number`, `text`, `list of numbers` ...
    pub kind: String,
    /// Unit; empty where there is none.
    pub unit: &'a str,
    /// `required`, the value that it has when it is not given, or nothing.
    pub default: String,
    /// Its least and largest value, or the words to choose from; empty where there is no limit.
    pub range: String,
    /// What it does.
    pub help: String,
}

impl Entry {
    /// As it is reported on the bus, and by `starmesh actions --json`.
    pub fn summary(&self) -> ActionKind {
        let needs = self.needs();
        ActionKind {
            name: self.name.to_owned(),
            help: self.help().to_owned(),
            needs_safe_sky: needs.is_some_and(|needs| needs.safe),
            moves_mount: needs.is_some_and(|needs| needs.mount),
            // a test reads every example
            example: serde_json::from_str(self.example).unwrap_or(Value::Null),
            schema: self.schema().clone(),
        }
    }

    /// What it does, in a sentence or two.
    pub fn help(&self) -> &str {
        self.schema()["description"].as_str().unwrap_or_default()
    }

    /// Its parameters, in the order of the action's own file.
    pub fn parameters(&self) -> Vec<Parameter<'_>> {
        parameters(self.schema(), "")
    }

    /// What must hold while the example is done.
    pub fn needs(&self) -> Option<Needs> {
        let example = serde_json::from_str(self.example).ok()?;
        Some(self.read(example).ok()?.needs())
    }
}

/// Those of an object, each followed by those within it.
fn parameters<'a>(whole: &'a Value, before: &str) -> Vec<Parameter<'a>> {
    let each = schema::properties(whole).flat_map(|(name, about)| {
        let path = format!("{before}{name}");
        let within = parameters(about, &format!("{path}."));
        std::iter::once(Parameter { name: path, ..parameter(whole, name, about) }).chain(within)
    });
    each.collect()
}

fn parameter<'a>(whole: &'a Value, name: &str, about: &'a Value) -> Parameter<'a> {
    let default = match &about["default"] {
        _ if schema::is_required(whole, name) => "required".to_owned(),
        Value::Null => String::new(),
        value => value.to_string(),
    };
    let help = |schema: &Value| schema["description"].as_str().unwrap_or_default().to_owned();
    let of_word = |schema: &Value| Some(format!(" `{}`: {}", schema["const"].as_str()?, help(schema)));
    let of_words: String = schema::alternatives(about).into_iter().flatten().filter_map(of_word).collect();
    Parameter {
        name: name.to_owned(),
        kind: schema::kind(about, false),
        unit: about["unit"].as_str().unwrap_or_default(),
        default,
        range: schema::range(about).unwrap_or_default(),
        help: help(about) + of_words.as_str(),
    }
}

/// All actions, as Markdown.
pub fn page() -> String {
    let mut page = String::new();
    for entry in ACTIONS {
        section(&mut page, entry);
    }
    page
}

fn section(page: &mut String, entry: &Entry) {
    let needs = entry.needs().map(Needs::in_words).unwrap_or_default();
    // writing to a text cannot fail
    let _ = writeln!(page, "## `{}`\n\n{} {needs}\n\n```json\n{}\n```\n", entry.name, entry.help(), entry.example);
    let parameters = entry.parameters();
    if parameters.is_empty() {
        let _ = writeln!(page, "No parameters.\n");
        return;
    }
    let _ = writeln!(page, "| parameter | is a | unit | default | range | |\n|---|---|---|---|---|---|");
    for parameter in parameters {
        let Parameter { name, kind, unit, default, range, help } = parameter;
        let default = if default.is_empty() || default == "required" { default } else { format!("`{default}`") };
        let cells = [format!("`{name}`"), kind, unit.to_owned(), default, range, help];
        let _ = writeln!(page, "| {} |", cells.map(|cell| cell.replace('|', "\\|")).join(" | "));
    }
    page.push('\n');
}

impl Needs {
    /// As a sentence.
    pub fn in_words(self) -> String {
        let sky = if self.safe { "Needs a safe sky" } else { "Runs whatever the sky does" };
        let mount = if self.mount { "moves the mount or the roof" } else { "leaves the mount alone" };
        format!("{sky}; {mount}.")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_has_a_description_and_every_number_its_unit_and_range() {
        for entry in ACTIONS {
            assert!(entry.help().len() > 20 && entry.needs().is_some(), "{}", entry.name);
            for parameter in entry.parameters() {
                let Parameter { name, kind, unit, range, help, .. } = &parameter;
                assert!(help.len() > 10 && help.ends_with('.'), "{} {name}: {help:?}", entry.name);
                assert!(!kind.is_empty(), "{} {name}", entry.name);
                let is_number = kind.contains("number");
                assert!(!is_number || !(unit.is_empty() || range.is_empty()), "{} {name}: {parameter:?}", entry.name);
            }
        }
    }
}
