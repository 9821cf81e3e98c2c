//! The text of one new `observatory.toml`.

use std::path::Path;

use anyhow::Context as _;
use contract::{Address, Kind};

use super::block::{Block, TableLines, limits, list, quoted};
use super::entry::Notes;
use super::site::Location;
use super::telescopes::File;

/// Name of the FITS-header table in the same folder.
pub const HEADER: &str = "fits_header.csv";
/// Port of the first page; those of the other files follow, or two would want the same.
const PORT: usize = 8080;
/// The value where the place is not known: the file is refused until somebody fills it in.
const UNKNOWN: &str = "?  # fill in: no mount reported its position";

const PLACE: [&str; 3] = ["latitude_deg", "longitude_deg", "elevation_m"];

/// The values that the file does not have by itself.
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
pub fn text(file: &File, about: &About<'_>, notes: &mut Notes) -> String {
    let is_shared = file.telescope == Address::SHARED;
    let mut lines = TableLines::default();
    lines.comment("Made by `starmesh import-astra`. Every key is explained in docs/operator/config.md.");
    lines.table("observatory");
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
        lines.table("clock");
        lines.key(
            "simulator",
            quoted(&format!("http://{server}")),
            "its sky goes as fast as it says; not for real devices",
        );
    }
    if !is_shared {
        lines.table("schedule");
        lines.key("file", quoted("schedule.jsonl"), "");
        match about.simulator {
            Some(_) => {
                lines.key("robotic", true, "nothing real moves here; false at a real site until a person changes it")
            }
            None => lines.key("robotic", false, "nothing opens before a person switches it on"),
        }
    }
    lines.text_of(crate::first_tables::BUS);
    lines.text_of(crate::first_tables::ALERTS);
    lines.table("web");
    lines.key("listen", quoted(&format!("127.0.0.1:{}", PORT + about.index)), "the page");
    if about.header || !is_shared {
        lines.table("archive");
        lines.key("profile", quoted("astra"), "files are named as before");
        if about.header {
            lines.key("fits_header", quoted(HEADER), "as it was");
        }
    }
    if let Some(catalogue) = about.catalogue.filter(|_| !is_shared) {
        lines.table("imaging");
        lines.key("catalogue", quoted(&catalogue.display().to_string()), "gaia_db");
    }
    if !about.templates.is_empty() && !is_shared {
        lines.table("archive.filename");
        for (action, template) in about.templates {
            lines.key(action, quoted(template), "");
        }
    }
    let mut text = lines.text();
    if !file.shared.is_empty() {
        let mut lines = TableLines::default();
        lines.table("shared");
        lines.comment("devices of the file of telescope \"shared\" that this one uses");
        for (kind, names) in &file.shared {
            lines.key(&kind.ascom().to_lowercase(), list(names), "");
        }
        lines.maybe("dwell_min", file.dwell_min, "of the shared safety monitors");
        text += &lines.text();
        text += &limits(file.limits.iter());
    }
    for (table, about_it) in file.blocks.iter().flat_map(|block| &block.tables) {
        if !about_it.is_empty() {
            text += &format!("\n[{table}]\n{}", about_it.text());
        }
    }
    for block in &file.blocks {
        text += &block.text(&pairs(file, block, notes));
    }
    text
}

/// Kinds whose only device of a telescope would be moved for a camera that names none.
const MOVED: [Kind; 4] = [Kind::Telescope, Kind::Focuser, Kind::FilterWheel, Kind::Rotator];

/// The devices that are paired with a camera, by the names of this file; a camera is no pair of itself. Here the only
/// device of a kind is a camera's where it names none, which is noted.
fn pairs(file: &File, camera: &Block, notes: &mut Notes) -> Vec<(Kind, String)> {
    let name_of = |kind: &Kind, old_name: &String| {
        let own = file.blocks.iter().find(|block| block.kind == *kind && block.old_name == *old_name);
        let own = own.map(|block| block.name.clone());
        own.or_else(|| {
            let name = super::block::name(old_name);
            file.shared.get(kind).filter(|names| names.contains(&name)).map(|_| name)
        })
    };
    let only = |kind: Kind| {
        let mut of_kind = file.blocks.iter().filter(|block| block.kind == kind);
        of_kind.next().filter(|_| of_kind.next().is_none())
    };
    let mut pairs = Vec::new();
    for (kind, old_name) in camera.pairs.iter().filter(|(kind, _)| **kind != Kind::Camera) {
        match name_of(kind, old_name) {
            Some(name) => pairs.push((*kind, name)),
            None => {
                let what = format!("is paired with {} {old_name:?}, which is not in this file", kind.ascom());
                let instead =
                    only(*kind).map_or(String::new(), |device| format!(", and works with {:?} now", device.name));
                notes.add(camera.line, format!("{}: {what}{instead}", camera.place()));
            }
        }
    }
    if camera.kind == Kind::Camera {
        for device in MOVED.iter().filter(|kind| !camera.pairs.contains_key(kind)).filter_map(|kind| only(*kind)) {
            let what = format!(
                "names no {0}: here the only {0} of its telescope, {1:?}, works with it",
                device.kind.ascom(),
                device.name
            );
            notes.add(camera.line, format!("{}: {what}; Astra moved none for it", camera.place()));
        }
    }
    pairs
}

/// Proves the text as every node will read it; a place that is not known is taken for some other.
pub fn prove(text: &str, location: Option<Location>, folder: &Path) -> anyhow::Result<()> {
    let mut known = text.to_owned();
    for key in PLACE.iter().filter(|_| location.is_none()) {
        known = known.replace(&format!("# {key} = {UNKNOWN}"), &format!("{key} = 0"));
    }
    config::parse(&known, folder).context("the new configuration is not valid; please report this").map(|_| ())
}
