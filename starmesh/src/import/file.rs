//! The text of one new `observatory.toml`.

use std::path::Path;

use anyhow::Context as _;
use contract::{Address, Kind};

use super::block::{Lines, list, quoted};
use super::site::Location;
use super::telescopes::File;

/// Name of the FITS-header table beside it.
pub const HEADER: &str = "fits_header.csv";
/// Port of the first page; those of the other files follow, or two would want the same.
const PORT: usize = 8080;
/// What a comment says where the place is not known: the file is refused until somebody fills it in.
const UNKNOWN: &str = "?  # fill in: no mount told where it stands";

const PLACE: [&str; 3] = ["latitude_deg", "longitude_deg", "elevation_m"];

/// What the file does not know by itself.
pub struct About<'a> {
    /// Name of the site.
    pub site: &'a str,
    /// Where it is.
    pub location: Option<Location>,
    /// File-name templates by action.
    pub templates: &'a [(String, String)],
    /// The star catalogue.
    pub catalogue: Option<&'a Path>,
    /// There is a FITS-header table.
    pub header: bool,
    /// The simulator that all devices are, `host:port`.
    pub simulator: Option<&'a str>,
    /// Which telescope, from 0.
    pub index: usize,
}

/// The whole text.
pub fn text(file: &File, about: &About<'_>) -> String {
    let is_shared = file.telescope == Address::SHARED;
    let mut lines = Lines::default();
    lines.comment("Made by `starmesh import-astra`. Every key is explained in docs/operator/config.md.");
    lines.0 += "\n[observatory]\n";
    lines.key("site", quoted(about.site), "");
    lines.key("telescope", quoted(&file.telescope), "");
    match about.location {
        Some(location) => {
            lines.key("latitude_deg", location.latitude_deg, "north positive");
            lines.key("longitude_deg", location.longitude_deg, "east positive");
            lines.key("elevation_m", location.elevation_m, "");
        }
        None => PLACE.iter().for_each(|key| lines.comment(&format!("{key} = {UNKNOWN}"))),
    }
    if let Some(server) = about.simulator {
        lines.0 += "\n[clock]\n";
        lines.key(
            "simulator",
            quoted(&format!("http://{server}")),
            "its sky goes as fast as it says; not for real devices",
        );
    }
    if !is_shared {
        lines.0 += "\n[schedule]\n";
        lines.key("file", quoted("schedule.jsonl"), "");
        lines.key("robotic", false, "nothing opens before a person switches it on");
    }
    lines.0 += "\n[web]\n";
    lines.key("listen", quoted(&format!("127.0.0.1:{}", PORT + about.index)), "the page");
    if about.header {
        lines.0 += "\n[archive]\n";
        lines.key("fits_header", quoted(HEADER), "as it was");
    }
    if let Some(catalogue) = about.catalogue.filter(|_| !is_shared) {
        lines.0 += "\n[imaging]\n";
        lines.key("catalogue", quoted(&catalogue.display().to_string()), "gaia_db");
    }
    if !about.templates.is_empty() && !is_shared {
        lines.0 += "\n[archive.filename]\n";
        for (action, template) in about.templates {
            lines.key(action, quoted(template), "");
        }
    }
    if !file.shared.is_empty() {
        lines.0 += "\n[shared]\n";
        lines.comment("devices of the file of telescope \"shared\" that this one heeds");
        for (kind, names) in &file.shared {
            lines.key(&kind.ascom().to_lowercase(), list(names), "");
        }
        lines.maybe("dwell_min", file.dwell_min, "of the shared safety monitors");
        if !file.limits.is_empty() {
            lines.0 += &format!("limit = [\n    {},\n]\n", file.limits.join(",\n    "));
        }
    }
    for (table, about_it) in file.blocks.iter().flat_map(|block| &block.tables) {
        if !about_it.0.is_empty() {
            lines.0 += &format!("\n[{table}]\n{}", about_it.0);
        }
    }
    for block in &file.blocks {
        lines.0 += &block.text(&pairs(file, &block.pairs));
    }
    lines.0
}

/// What a camera is paired with, by the names of this file; a camera is no pair of itself.
fn pairs(file: &File, old: &std::collections::BTreeMap<Kind, String>) -> Vec<(Kind, String)> {
    let name_of = |kind: &Kind, old_name: &String| {
        let own = file.blocks.iter().find(|block| block.kind == *kind && block.old_name == *old_name);
        let own = own.map(|block| block.name.clone());
        own.or_else(|| {
            let name = super::block::name(old_name);
            file.shared.get(kind).filter(|names| names.contains(&name)).map(|_| name)
        })
    };
    let pairs = old.iter().filter(|(kind, _)| **kind != Kind::Camera);
    pairs.filter_map(|(kind, old_name)| Some((*kind, name_of(kind, old_name)?))).collect()
}

/// Proves the text as every node will read it; a place that is not known is taken for some other.
pub fn prove(text: &str, location: Option<Location>, folder: &Path) -> anyhow::Result<()> {
    let mut known = text.to_owned();
    for key in PLACE.iter().filter(|_| location.is_none()) {
        known = known.replace(&format!("# {key} = {UNKNOWN}"), &format!("{key} = 0"));
    }
    config::parse(&known, folder).context("the new configuration is not valid; please report this").map(|_| ())
}
