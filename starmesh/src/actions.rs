//! `starmesh actions`: the actions of a schedule, with every parameter's unit, default, range and effect.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use config::Observatory;
use schedule::action::{ACTIONS, Entry, Needs, Parameter};
use schedule::meant;
use serde_json::{Value, json};
use units::Utc;

use crate::console::line;

/// Options of `starmesh actions`.
#[derive(Debug, Args)]
pub struct Options {
    /// Only this one, such as object.
    action: Option<String>,
    /// The configuration whose camera and filters the example rows name; observatory.toml of this folder where absent.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One JSON object a line, as the bus shows it, with the JSON Schema of the parameters.
    #[arg(long)]
    json: bool,
}

/// Prints all actions, or one.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let site = site(options.config.as_deref())?;
    for entry in wanted(options.action.as_deref())? {
        if options.json {
            line(format_args!("{}", serde_json::to_string(&entry.summary())?))?;
        } else {
            line(format_args!("{}", text(entry)))?;
            line(format_args!(
                "  Example:\n    {}\n",
                example(entry, site.as_ref(), bus::Clock::machine_clock().utc())
            ))?;
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

/// The configuration that was named, or that of this folder if there is one.
fn site(named: Option<&Path>) -> anyhow::Result<Option<Observatory>> {
    let here = Path::new("observatory.toml");
    match named {
        Some(file) => Ok(Some(node::configuration::read_observatory(file)?)),
        None if here.exists() => Ok(node::configuration::read_observatory(here).ok()),
        None => Ok(None),
    }
}

/// A row for the coming night, of the site's first camera.
fn example(entry: &Entry, site: Option<&Observatory>, now: Utc) -> String {
    let camera = site.and_then(|site| site.camera.first());
    let name = camera.map_or("camera", |camera| camera.common.name.as_str());
    let mut value: Value = serde_json::from_str(entry.example).unwrap_or_default();
    let wheel = camera.map(|camera| camera.filterwheel.as_ref());
    let wheel = wheel.map(|name| site.and_then(|site| site.filterwheel.iter().find(|w| Some(&w.common.name) == name)));
    match (wheel, value.as_object_mut()) {
        // A camera without a wheel.
        (Some(None), Some(value)) => {
            let was_list = value.shift_remove("filter").is_some_and(|filter| filter.is_array());
            if let Some(Value::Array(n)) = value.get_mut("n").filter(|_| was_list) {
                n.truncate(1);
            }
        }
        (Some(Some(wheel)), Some(value)) => {
            if let (Some(filter), Some(first)) = (value.get_mut("filter"), wheel.filters.first()) {
                let was_list = filter.is_array();
                *filter = if was_list { json!([first]) } else { json!(first) };
                if let Some(Value::Array(n)) = value.get_mut("n").filter(|_| was_list) {
                    n.truncate(1);
                }
            }
        }
        _ => {}
    }
    // Ten in the evening by the Sun.
    let longitude_deg = site.map_or(0.0, |site| site.place.longitude_deg);
    let local_s = now.seconds() + longitude_deg * 240.0;
    let start_s = (local_s / 86_400.0).floor() * 86_400.0 + 22.0 * 3600.0 - longitude_deg * 240.0;
    let start_s = (if start_s < now.seconds() { start_s + 86_400.0 } else { start_s } / 600.0).round() * 600.0;
    let at = |seconds: f64| Utc::from_micros((seconds * 1e6) as i64).strftime("%Y-%m-%d %H:%M:%S");
    let row = json!({
        "device_name": name, "action_type": entry.name, "action_value": value,
        "start_time": at(start_s), "end_time": at(start_s + 7200.0),
    });
    row.to_string()
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
        // Writing to a text cannot fail.
        let _ = writeln!(text, "\n  {name}: {}\n    {help}", about.join("; "));
    }
    text
}

#[cfg(test)]
mod tests {
    use schedule::validate::{KnownFacts, validate};

    use super::*;

    #[test]
    fn a_parameter_is_printed_with_unit_range_default_and_help() {
        let printed = text(wanted(Some("calibrate_guiding")).unwrap()[0]);
        assert!(printed.starts_with("calibrate_guiding\n  Learns from pulses"), "{printed}");
        let settle = "\n  settle_time: number; 0 to 600 s; default 1.0\n    Rest between a pulse and the exposure.\n";
        assert!(printed.contains(settle), "{printed}");
        assert!(text(wanted(Some("object")).unwrap()[0]).contains("\n  object: text; required\n    OBJECT keyword"));
        assert!(text(wanted(Some("open")).unwrap()[0]).contains("No parameters."));
    }

    #[test]
    fn every_example_is_a_row_that_passes_the_check() {
        let place = "[observatory]\nsite = \"p\"\ntelescope = \"t\"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n\
                     elevation_m = 2518\n[[telescope]]\nname = \"mount\"\nserver = \"a:1\"\n[[camera]]\nname = \"main\"\n\
                     server = \"a:1\"\ntemperature_c = -20\n";
        let wheel = "[[filterwheel]]\nname = \"wheel\"\nserver = \"a:1\"\nfilters = [\"g\", \"r\"]\n";
        let now: Utc = "2026-11-21T12:00:00Z".parse().unwrap();
        for text in [place.to_owned(), format!("{place}{wheel}")] {
            let site = config::parse(&text, Path::new("/none")).unwrap();
            let known = KnownFacts::of(std::sync::Arc::new(site.clone())).at(now);
            for entry in ACTIONS.iter() {
                let row = example(entry, Some(&site), now);
                let found = validate(&row, &known);
                assert!(found.valid, "{row}: {:?}", found.findings);
            }
        }
    }

    #[test]
    fn an_action_that_nobody_knows_is_refused_with_the_one_that_was_meant() {
        let refused = wanted(Some("objekt")).err().unwrap().to_string();
        assert_eq!(refused, "no action is called \"objekt\"; did you mean \"object\"?");
        assert_eq!(wanted(None).unwrap().len(), ACTIONS.len());
    }
}
