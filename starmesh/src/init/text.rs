//! The text of a first `observatory.toml`, with the purpose of each key.

use std::collections::BTreeSet;
use std::path::Path;

use alpaca::discovery::{Found, as_toml};
use contract::Kind;

use super::before::Before;
use super::place::Surroundings;
use super::{HEADER, Options, SCHEDULE};
use crate::first_tables::{ALERTS, BUS};
use crate::import::site::Location;

const PLACE: [&str; 3] = ["latitude_deg", "longitude_deg", "elevation_m"];
const UNKNOWN: &str = "?  # fill in";

/// Keys that people often configure for a device of each kind, as comments after its block.
fn hints(kind: Kind) -> &'static str {
    match kind {
        Kind::Telescope => {
            "# meridian_flip = true                  # a German mount turns over between two frames\n\
             # limits = { altitude_min_deg = 20.0 }  # tracking stops there, whatever the schedule asks for\n"
        }
        Kind::Camera => {
            "# temperature_c = -20.0                 # cooler set point; without it the camera is not cooled\n\
             # flats = { target_adu = 28000 }        # what a good flat is: docs/operator/flats.md\n"
        }
        Kind::FilterWheel => {
            "# filters = [\"B\", \"V\", \"R\"]            # for schedules that are checked while the wheel is away\n"
        }
        Kind::Focuser => "# best_position = 12000                 # steps, until autofocus has found a better one\n",
        Kind::Dome => {
            "# \"parked_only\" for a roof that would hit the telescope; \"parked_within_s\" waits a little for the park\n\
             close_with_mount = \"alongside\"\n\
             # follow = \"off\"                        # where something else turns the dome, or nothing may\n"
        }
        Kind::SafetyMonitor => {
            "dwell_min = 15.0                        # safe again only after so long without an unsafe reading\n"
        }
        Kind::ObservingConditions => {
            "# what the sky must not exceed; the dome opens again after dwell_min below it\n\
             limit = [\n    { parameter = \"Humidity\", upper = 85.0, dwell_min = 15.0 },\n    \
             { parameter = \"WindSpeed\", upper = 12.0, dwell_min = 15.0 },\n    \
             { parameter = \"RainRate\", upper = 0.0, dwell_min = 20.0 },\n]\n"
        }
        Kind::Switch | Kind::Rotator | Kind::CoverCalibrator => "",
    }
}

/// The whole text.
pub fn text(options: &Options, found: &[Found], around: &Surroundings, before: &Before) -> String {
    let mut text = String::from(
        "# Made by `starmesh init`. Every key is explained in docs/operator/config.md; what is behind a # is an example.\n\n\
         [observatory]\n# the place in the key tree of the network\n",
    );
    text += &format!("site = \"{}\"\ntelescope = \"{}\"\n", options.site, options.telescope);
    for told in &around.told {
        text += &format!("# {}\n", contract::printable(told));
    }
    match around.place {
        Some(Location { latitude_deg, longitude_deg, elevation_m }) => {
            text += &format!(
                "latitude_deg = {latitude_deg:?}\nlongitude_deg = {longitude_deg:?}  # east positive\nelevation_m = {elevation_m:?}\n"
            );
        }
        None => PLACE.iter().for_each(|key| text += &format!("# {key} = {UNKNOWN}\n")),
    }
    if let Some(server) = found.first().filter(|_| around.simulated.is_some()).map(|device| &device.server) {
        text += &format!(
            "\n[clock]\n# these devices are simulated: their night is the night here\nsimulator = \"http://{server}\"\n"
        );
    }
    text += &format!(
        "\n[schedule]\nfile = \"{SCHEDULE}\"\n# nothing opens before a person says `starmesh order ... start`, or this is true\nrobotic = false\n"
    );
    if around.simulated.is_some() {
        text += "\n[pointing]\n# the simulated mount repeats itself to some arcseconds, and its pixels may be large; 0.1 at a real one\nthreshold_arcmin = 0.5\n";
    }
    text += &format!("\n[archive]\n# which keywords a frame gets, and from where\nfits_header = \"{HEADER}\"\n");
    text += &format!("\n{BUS}\n{ALERTS}");
    text += "\n[web]\n# the page; another address than this host's own needs users (`starmesh user add`, docs/operator/users.md)\nlisten = \"127.0.0.1:8080\"\n\n";
    if found.is_empty() {
        text += "# No device answered. Take the # away from those that you have.\n\n";
        for (index, kind) in Kind::ALL.into_iter().enumerate() {
            let name = format!("my_{kind}");
            let device = Found {
                server: format!("10.0.0.{}:11111", index + 5),
                kind,
                number: 0,
                name,
                unique_id: String::new(),
            };
            text += &commented(&format!("{}{}", as_toml(&device), hints(kind)));
            text.push('\n');
        }
        return text;
    }
    let mut kinds = BTreeSet::new();
    for device in found {
        let block = format!("{}{}", before.named(device, as_toml(device)), hints(device.kind));
        // One of each kind is a telescope; a site with more names which.
        let block = if kinds.insert(device.kind) {
            block
        } else {
            format!("# a second {}:\n{}", device.kind, commented(&block))
        };
        text += &block;
        text.push('\n');
    }
    if !kinds.contains(&Kind::SafetyMonitor) {
        text += "# No safety monitor answered: without one, or a weather station with limits, nothing decides when to close.\n";
    }
    text
}

fn commented(block: &str) -> String {
    let line = |line: &str| if line.starts_with('#') { format!("{line}\n") } else { format!("# {line}\n") };
    block.lines().map(line).collect()
}

/// Reads the text as every node will; a place that is not known is taken for some other.
pub fn prove(text: &str, place: Option<Location>, folder: &Path) -> anyhow::Result<config::Observatory> {
    let mut known = text.to_owned();
    for key in PLACE.iter().filter(|_| place.is_none()) {
        known = known.replace(&format!("# {key} = {UNKNOWN}"), &format!("{key} = 0"));
    }
    Ok(config::parse(&known, folder)?)
}
