//! `starmesh actions`: what a schedule may ask for, with every parameter's unit, default, range and what it does.

use std::fmt::Write as _;

use anyhow::bail;
use clap::Args;
use node_observatory::action::{ACTIONS, Entry, Needs, Parameter};
use node_observatory::schedule::meant;

use crate::console::line;

/// Options of `starmesh actions`.
#[derive(Debug, Args)]
pub struct Options {
    /// Only this one, such as object.
    action: Option<String>,
    /// One JSON object a line, as the bus tells it, with the JSON Schema of the parameters.
    #[arg(long)]
    json: bool,
}

/// Prints all actions, or one.
pub fn run(options: &Options) -> anyhow::Result<()> {
    for entry in wanted(options.action.as_deref())? {
        if options.json {
            line(format_args!("{}", serde_json::to_string(&entry.told())?))?;
        } else {
            line(format_args!("{}", text(entry)))?;
        }
    }
    Ok(())
}

fn wanted(name: Option<&str>) -> anyhow::Result<Vec<&'static Entry>> {
    let Some(name) = name else { return Ok(ACTIONS.iter().collect()) };
    match ACTIONS.iter().find(|entry| entry.name == name) {
        Some(entry) => Ok(vec![entry]),
        None => bail!("no action is called {name:?}; {}", meant(name, ACTIONS.iter().map(|entry| entry.name))),
    }
}

fn text(entry: &Entry) -> String {
    let needs = entry.needs().map(Needs::in_words).unwrap_or_default();
    let mut text = format!("{}\n  {} {needs}\n", entry.name, entry.help());
    let parameters = entry.parameters();
    if parameters.is_empty() {
        text.push_str("  No parameters.\n");
    }
    for Parameter { name, kind, unit, default, range, help } in parameters {
        let range = [range.as_str(), unit].join(" ");
        let default = if default.is_empty() || default == "required" { default } else { format!("default {default}") };
        let about = [kind.as_str(), range.trim(), default.as_str()];
        let about: Vec<&str> = about.into_iter().filter(|word| !word.is_empty()).collect();
        // writing to a text cannot fail
        let _ = writeln!(text, "\n  {name}: {}\n    {help}", about.join("; "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_is_told_with_unit_range_default_and_help() {
        let told = text(wanted(Some("calibrate_guiding")).unwrap()[0]);
        assert!(told.starts_with("calibrate_guiding\n  Learns from pulses"), "{told}");
        let settle = "\n  settle_time: number; 0 to 600 s; default 1.0\n    Rest between a pulse and the exposure.\n";
        assert!(told.contains(settle), "{told}");
        assert!(text(wanted(Some("object")).unwrap()[0]).contains("\n  object: text; required\n    OBJECT keyword"));
        assert!(text(wanted(Some("open")).unwrap()[0]).contains("No parameters."));
    }

    #[test]
    fn an_action_that_nobody_knows_is_refused_with_the_one_that_was_meant() {
        let refused = wanted(Some("objekt")).err().unwrap().to_string();
        assert_eq!(refused, "no action is called \"objekt\"; did you mean \"object\"?");
        assert_eq!(wanted(None).unwrap().len(), ACTIONS.len());
    }
}
