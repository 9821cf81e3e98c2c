//! `starmesh import-astra`: a site's files of Astra, as `observatory.toml`, FITS-header table and schedule.
//!
//! - [`find`] knows where the files lie, [`yaml`] and [`entry`] read them with their lines.
//! - [`devices`] and [`guider`] say what each key is here; [`telescopes`] distributes the devices of one observatory.
//! - [`schedule`] gives each row to the telescope of its camera; [`site`] asks the mount where it stands.
//! - [`block`] and [`file`](mod@file) write our text.
//!
//! What cannot be carried over is listed with its line, and nothing is overwritten.

mod block;
mod devices;
mod entry;
mod file;
mod find;
mod guider;
mod schedule;
mod site;
mod telescopes;
mod yaml;

use std::collections::BTreeSet;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use contract::{Chunk, Kind, Name};

use self::block::Block;
use self::entry::{Entry, Notes};
use self::site::Location;
use self::telescopes::File;
use crate::console::line;

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
    let (mut blocks, templates) = read_config(&found.config, &mut notes)?;
    if let Some(server) = &options.simulator {
        simulate(&mut blocks, server)?;
    }
    let site = options.site.as_ref().map_or_else(|| block::chunk(&found.name), ToString::to_string);
    let location = match (options.latitude_deg, options.longitude_deg, options.elevation_m) {
        (Some(latitude_deg), Some(longitude_deg), Some(elevation_m)) => {
            Some(Location { latitude_deg, longitude_deg, elevation_m })
        }
        _ if options.offline => None,
        _ => site::ask(&blocks).await,
    };
    if !options.offline {
        site::spare_absent(&mut blocks, &mut notes).await;
    }
    let header = found.header.as_deref().map(|path| read_header(path, &mut notes)).transpose()?;
    let (pieces, mut rest) = match &found.schedule {
        Some(path) => {
            let text = read(path)?;
            let about = || format!("{} cannot be taken apart", path.display());
            schedule::pieces(&text).with_context(about)?
        }
        None => (Vec::new(), String::new()),
    };

    let mut schedule_notes = Notes::default();
    let mut new: Vec<(PathBuf, String)> = Vec::new();
    telescopes::give_calibrations(&mut blocks, &mut notes);
    let files = telescopes::distribute(blocks, &site, &mut notes);
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
        let text = file::text(file, &about);
        file::prove(&text, location, &folder)
            .with_context(|| format!("what was made of {}", found.config.display()))?;
        new.push((folder.join("observatory.toml"), text));
        new.extend(header.clone().map(|table| (folder.join(file::HEADER), table)));
        let cameras = cameras(file)?;
        if !cameras.is_empty() && !pieces.is_empty() {
            let mut text = schedule::of_telescope(&pieces, &cameras, &mut schedule_notes);
            text += std::mem::take(&mut rest).trim_start_matches(['\n', '\r']);
            new.push((folder.join("schedule.jsonl"), text));
        }
    }
    let known: Vec<String> = files.iter().flat_map(File::cameras).map(|camera| camera.old_name.clone()).collect();
    for piece in pieces.iter().filter(|piece| !piece.camera.as_ref().is_some_and(|camera| known.contains(camera))) {
        let camera = piece.camera.as_deref().unwrap_or("nothing");
        schedule_notes
            .add(piece.line, format!("a row for {camera}, which is no camera of the configuration; left out"));
    }
    write(&new)?;

    line(format_args!("read  {}", found.config.display()))?;
    for (path, _) in &new {
        line(format_args!("wrote {}", path.display()))?;
    }
    if location.is_none() {
        line(format_args!(
            "\nTo be filled in: latitude_deg, longitude_deg, elevation_m of [observatory]: no mount told where it stands."
        ))?;
    }
    tell("To be looked at, by line of the old configuration:", &notes)?;
    tell("Rows of the old schedule:", &schedule_notes)?;
    let first = new.first().map(|(path, _)| path.display().to_string()).unwrap_or_default();
    line(format_args!("\nNow: starmesh check {first}"))
}

/// Puts a simulator in the place of every device.
fn simulate(blocks: &mut [Block], server: &str) -> anyhow::Result<()> {
    let mut kinds = BTreeSet::new();
    for block in blocks {
        let place = format!("line {}: {} {}", block.line, block.kind.ascom(), block.old_name);
        ensure!(
            kinds.insert(block.kind),
            "{place} is a second one, and a simulator has one device of each kind: import without --simulator and give \
             each telescope's devices the address of a simulator of its own"
        );
        (block.server, block.number) = (server.to_owned(), 0);
        // nobody else turns the simulated dome
        let others = block.lines.0.lines().filter(|line| !line.starts_with(devices::FOLLOW));
        block.lines.0 = others.map(|line| format!("{line}\n")).collect();
    }
    Ok(())
}

fn tell(title: &str, notes: &Notes) -> anyhow::Result<()> {
    if notes.lines.is_empty() {
        return Ok(());
    }
    line(format_args!("\n{title}"))?;
    for (number, what) in &notes.lines {
        line(format_args!("  {number:4}  {what}"))?;
    }
    Ok(())
}

/// No more of a file is read: what takes it apart refuses one that is so large.
const MOST_BYTES: u64 = 5_000_001;

fn read(path: &Path) -> anyhow::Result<String> {
    let mut text = String::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(MOST_BYTES).read_to_string(&mut text));
    read.with_context(|| format!("cannot read {}", path.display()))?;
    Ok(text)
}

/// File-name templates by action.
type Templates = Vec<(String, String)>;

/// The devices and the templates of a configuration.
fn read_config(path: &Path, notes: &mut Notes) -> anyhow::Result<(Vec<Block>, Templates)> {
    let node = yaml::read(&read(path)?).with_context(|| format!("{} is not taken", path.display()))?;
    devices_of(&node, notes).with_context(|| format!("{} is not taken", path.display()))
}

fn devices_of(node: &yaml::Node, notes: &mut Notes) -> anyhow::Result<(Vec<Block>, Templates)> {
    let Some(mut top) = Entry::of("the file", node, notes) else { bail!("it holds no devices") };
    let mut templates = Vec::new();
    if let Some(mut misc) = top.entry("Misc", notes) {
        // a night's data are kept as they come; there is no dump at some hour
        misc.take("backup_time");
        if let Some(mut map) = misc.entry("filename_templates", notes) {
            for action in map.keys() {
                templates.extend(map.text(&action, notes).map(|template| (action, template)));
            }
        }
        misc.rest("the page has no such thing yet; not carried over", notes);
    }
    let mut blocks = Vec::new();
    for key in top.keys() {
        let Ok(kind) = key.parse::<Kind>() else { continue };
        for (index, mut entry) in top.entries(&key, notes).into_iter().enumerate() {
            entry.place = kind.ascom().to_owned();
            let block = devices::device(kind, entry, notes)?;
            if index > 0 && matches!(kind, Kind::SafetyMonitor | Kind::ObservingConditions) {
                let what = "Astra heeded only the first of its kind; this one counts too, with its limits";
                notes.add(block.line, format!("{} {}: {what}", kind.ascom(), block.old_name));
            }
            blocks.push(block);
        }
    }
    top.rest("expected an ASCOM device type or Misc; not carried over", notes);
    ensure!(!blocks.is_empty(), "it holds no devices");
    Ok((blocks, templates))
}

/// The FITS-header table as it is, if it can be read here.
fn read_header(path: &Path, notes: &mut Notes) -> anyhow::Result<String> {
    let text = read(path)?;
    if let Err(error) = text.parse::<config::header::HeaderTable>() {
        notes.add(0, format!("{}: copied, but not taken as it stands: {error}", path.display()));
    }
    Ok(text)
}

/// Old and new names of a file's cameras.
fn cameras(file: &File) -> anyhow::Result<Vec<(String, Name)>> {
    file.cameras().map(|camera| Ok((camera.old_name.clone(), camera.name.parse::<Name>()?))).collect()
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
mod tests;
