//! `starmesh import-astra`: a site's files of Astra, as `observatory.toml`, FITS-header table and schedule.
//!
//! - [`find`] finds the files, [`yaml`] and [`entry`] read them with their lines.
//! - [`devices`] and [`guider`] convert each key; [`telescopes`] distributes the devices of one observatory.
//! - [`schedule`] gives each row to the telescope of its camera; [`site`] asks the mount for its place.
//! - [`prove`] removes what is not valid here; [`block`] and [`file`](mod@file) write our text.
//! - [`trial`] gives a simulator the properties of the site; [`differences`] lists how a night differs.
//!
//! The import lists everything that cannot be carried over with its line, and overwrites nothing.

mod block;
mod devices;
mod differences;
mod entry;
mod fair;
mod file;
mod find;
mod guider;
mod prove;
mod salvage;
pub mod schedule;
pub mod site;
mod telescopes;
mod text;
mod trial;
mod yaml;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use contract::{Chunk, Kind};

use self::block::Block;
use self::entry::{Entry, Notes};
use self::site::Location;
use self::telescopes::File;
use crate::console::line;
use crate::new_site;

/// Options of `starmesh import-astra`.
#[derive(Debug, Args)]
pub struct Options {
    /// Astra's asset folder (with `observatory_config/` and `schedules/`), any folder with NAME_config.yml in it, or the one
    /// with astra_config.yml, which names the asset folder.
    folder: PathBuf,
    /// Where the new files go; nothing there is overwritten.
    #[arg(long, default_value = "starmesh-site")]
    out: PathBuf,
    /// Which observatory, where the folder holds several.
    #[arg(long)]
    name: Option<String>,
    /// Name of the site in the key tree; the observatory's name where absent.
    #[arg(long)]
    site: Option<Chunk>,
    /// Geodetic latitude, degrees; where it is absent the mount is asked.
    #[arg(long, allow_hyphen_values = true, requires_all = ["longitude_deg", "elevation_m"])]
    latitude_deg: Option<f64>,
    /// Longitude, degrees, east positive.
    #[arg(long, allow_hyphen_values = true, requires = "latitude_deg")]
    longitude_deg: Option<f64>,
    /// Height above the sea, m.
    #[arg(long, allow_hyphen_values = true, requires = "latitude_deg")]
    elevation_m: Option<f64>,
    /// Ask no device for anything.
    #[arg(long)]
    offline: bool,
    /// To try the site: put a Starmesh simulator (HOST:PORT) and its clock in the place of every device.
    #[arg(long, value_name = "HOST:PORT")]
    simulator: Option<String>,
}

/// Reads the old files and writes the new ones.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let home = std::env::home_dir();
    let found = find::find(&options.folder, options.name.as_deref(), home.as_deref())?;
    let mut notes = Notes::default();
    for class in &found.classes {
        let what = "a site's own class is no part of this; steps around opening and closing: docs/operator/hooks.md";
        notes.add(0, format!("{}: {what}", class.display()));
    }
    if let Some(lost) = &found.lost_catalogue {
        let what = "gaia_db is not there; the catalogue that is shipped is taken";
        notes.add(0, format!("{}: {what}", lost.display()));
    }
    let (mut blocks, templates) = read_config(&found.config, &mut notes)?;
    let mut schedule_notes = Notes::default();
    let (pieces, mut rest) = match &found.schedule {
        Some(path) => schedule::pieces(&text::read(path, &mut schedule_notes)?)
            .with_context(|| format!("{} cannot be taken apart", path.display()))?,
        None => (Vec::new(), String::new()),
    };
    let site = options.site.as_ref().map_or_else(|| block::chunk(&found.name), ToString::to_string);
    let mut location = match (options.latitude_deg, options.longitude_deg, options.elevation_m) {
        (Some(latitude_deg), Some(longitude_deg), Some(elevation_m)) => {
            Some(Location { latitude_deg, longitude_deg, elevation_m })
        }
        _ if options.offline => None,
        _ => site::ask(&blocks).await,
    };
    if !options.offline {
        site::spare_absent(&mut blocks, &mut notes).await;
    }
    let mut lines = Vec::new();
    if let Some(server) = &options.simulator {
        let wanted = trial::Wanted::of(&blocks, &pieces, location);
        let ready = if options.offline { None } else { Some(trial::prepare(server, &wanted).await?) };
        location = ready.as_ref().map(|ready| ready.location).or(location);
        lines = trial::replace(&mut blocks, server, ready.as_ref())?;
    }
    let header = found.header.as_deref().map(|path| read_header(path, &mut notes)).transpose()?.flatten();

    let mut new: Vec<(PathBuf, String)> = Vec::new();
    telescopes::give_calibrations(&mut blocks, &mut notes);
    let files = telescopes::distribute(blocks, &site, &mut notes);
    let with_rows = files.iter().position(|file| file.cameras().next().is_some());
    let known: Vec<String> = files.iter().flat_map(File::cameras).map(|camera| camera.old_name.clone()).collect();
    let strays = schedule::strays(&pieces, &known, &mut schedule_notes);
    for (index, file) in files.iter().enumerate() {
        let folder = if files.len() > 1 { options.out.join(&file.telescope) } else { options.out.clone() };
        let about = file::About {
            site: &site,
            location,
            templates: &templates,
            catalogue: found.catalogue.as_deref(),
            header: header.is_some(),
            simulator: options.simulator.as_deref(),
            index,
        };
        let text = file::text(file, &about, &mut notes);
        file::prove(&text, location, &folder)
            .with_context(|| format!("what was made of {}", found.config.display()))?;
        new.push((folder.join("observatory.toml"), text));
        new.extend(header.clone().map(|table| (folder.join(file::HEADER), table)));
        let cameras = schedule::cameras(file)?;
        if !cameras.is_empty() && found.schedule.is_some() {
            let mut text = schedule::of_telescope(&pieces, &cameras, &mut schedule_notes);
            if Some(index) == with_rows {
                text += &strays;
                text += std::mem::take(&mut rest).trim_start_matches(['\n', '\r']);
            }
            new.push((folder.join("schedule.jsonl"), text));
        }
    }
    write(&new)?;

    line(format_args!("read  {}", found.config.display()))?;
    for (path, _) in &new {
        line(format_args!("wrote {}", path.display()))?;
        if path.ends_with("observatory.toml") {
            new_site::forget_deleted(path)?;
        }
    }
    if location.is_none() {
        line(format_args!(
            "\nTo be filled in: latitude_deg, longitude_deg, elevation_m of [observatory]: no mount reported its position."
        ))?;
    }
    let config = found.config.display();
    print_notes(&format!("To be looked at, by line of {config}:"), &notes)?;
    if let Some(schedule) = &found.schedule {
        print_notes(&format!("Rows, by line of {}:", schedule.display()), &schedule_notes)?;
    }
    let other = differences::of(&files, &pieces);
    if !other.is_empty() {
        line(format_args!("\nWhat will go otherwise than with Astra, and the key that brings its way back:"))?;
    }
    for what in other.iter().chain(&lines) {
        line(format_args!("  - {what}"))?;
    }
    let configurations: Vec<_> =
        new.iter().map(|(path, _)| path).filter(|path| path.ends_with("observatory.toml")).collect();
    for (index, path) in configurations.iter().enumerate() {
        let begin = if index == 0 { "\nNow:" } else { "    " };
        line(format_args!("{begin} starmesh check {}", path.display()))?;
    }
    // The document of imports describes what follows a trial.
    for path in configurations.iter().filter(|_| options.simulator.is_none()) {
        line(format_args!("     starmesh up {}", path.display()))?;
    }
    for file in files.iter().filter(|file| file.telescope != contract::Address::SHARED && options.simulator.is_none()) {
        line(format_args!(
            "     starmesh order {site}/{} start     once it is up and you want it to observe",
            file.telescope
        ))?;
    }
    Ok(())
}

fn print_notes(title: &str, notes: &Notes) -> anyhow::Result<()> {
    if notes.lines.is_empty() {
        return Ok(());
    }
    line(format_args!("\n{title}"))?;
    for (number, what) in &notes.lines {
        line(format_args!("  {number:4}  {what}"))?;
    }
    Ok(())
}

/// File-name templates by action.
type Templates = Vec<(String, String)>;

/// The devices and the templates of a configuration.
fn read_config(path: &Path, notes: &mut Notes) -> anyhow::Result<(Vec<Block>, Templates)> {
    let about = || format!("{} is not taken", path.display());
    let text = text::read(path, notes)?;
    let node = salvage::read(&text, notes).with_context(about)?;
    devices_of(&node, notes).with_context(about)
}

fn devices_of(node: &yaml::Node, notes: &mut Notes) -> anyhow::Result<(Vec<Block>, Templates)> {
    let Some(mut top) = Entry::of("the file", node, notes) else { bail!("it holds no devices") };
    let mut templates = Vec::new();
    if let Some(mut misc) = top.entry("Misc", notes) {
        // A night's data are stored as they come; there is no dump at some hour.
        misc.take("backup_time");
        if let Some(mut map) = misc.entry("filename_templates", notes) {
            for action in map.keys() {
                templates.extend(map.text(&action, notes).map(|template| (map.last, action, template)));
            }
        }
        misc.rest("the page has no such thing yet; not carried over", notes);
    }
    let (mut blocks, mut refused) = (Vec::new(), Vec::new());
    for key in top.keys() {
        let Ok(kind) = key.parse::<Kind>() else { continue };
        for (index, mut entry) in top.entries(&key, notes).into_iter().enumerate() {
            entry.place = kind.ascom().to_owned();
            let block = match devices::device(kind, entry, notes) {
                Ok(block) => block,
                Err(bad) => {
                    notes.add(bad.line, format!("{bad}; THE DEVICE IS LEFT OUT"));
                    refused.push(format!("line {}: {bad}", bad.line));
                    continue;
                }
            };
            if index > 0 && matches!(kind, Kind::SafetyMonitor | Kind::ObservingConditions) {
                let what = "Astra used only the first of its kind; this one counts too, with its limits";
                notes.add(block.line, format!("{}: {what}", block.place()));
            }
            blocks.push(block);
        }
    }
    top.rest("expected an ASCOM device type or Misc; not carried over", notes);
    let devices = prove::prune(blocks, notes);
    ensure!(!devices.is_empty(), "it holds no devices that can be taken\n{}", refused.join("\n"));
    Ok((devices, prove::templates(templates, notes)))
}

/// A table has some hundred rows; of one with more mistakes than this none is taken.
const MOST_BAD_ROWS: usize = 100;

/// The FITS-header table without the rows that cannot be read; `None` where nothing of it can be.
fn read_header(path: &Path, notes: &mut Notes) -> anyhow::Result<Option<String>> {
    let text = text::read(path, notes)?;
    let mut lines: Vec<(usize, &str)> = text.split_inclusive('\n').enumerate().collect();
    for _ in 0..MOST_BAD_ROWS {
        let table: String = lines.iter().map(|(_, line)| *line).collect();
        let Err(error) = table.parse::<config::header::HeaderTable>() else { return Ok(Some(table)) };
        let at = usize::try_from(error.line).unwrap_or(usize::MAX);
        // The first line names the columns.
        if at < 2 || at > lines.len() {
            notes.add(0, format!("{}: {}; the usual table is taken", path.display(), error.fault));
            return Ok(None);
        }
        let (number, _) = lines.remove(at - 1);
        notes.add(0, format!("{}, line {}: {}; the row is left out", path.display(), number + 1, error.fault));
    }
    notes.add(0, format!("{}: too many rows cannot be read; the usual table is taken", path.display()));
    Ok(None)
}

/// Writes all files, or none: a name that is taken is refused before anything is written.
fn write(new: &[(PathBuf, String)]) -> anyhow::Result<()> {
    if let Some((path, _)) = new.iter().find(|(path, _)| path.exists()) {
        bail!("{} is there already and stays as it is; choose another folder with --out", path.display());
    }
    for (path, text) in new {
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

#[cfg(test)]
mod fuzz_tests;
#[cfg(test)]
mod strict_tests;
#[cfg(test)]
mod tests;
