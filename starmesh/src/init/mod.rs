//! `starmesh init`: the first files of a telescope, from the devices that answer: configuration, FITS-header table and
//! an example schedule.
//!
//! [`place`] asks where the telescope is; [`text`](mod@text) writes the configuration, [`night`] the schedule. Nothing
//! is overwritten: `--force` gives the old files other names, and [`before`] keeps the names of their devices. No device is
//! connected or moved.

mod before;
mod night;
mod place;
mod text;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use alpaca::discovery::{self, Found};
use anyhow::{Context as _, bail, ensure};
use clap::Args;
use contract::{Address, Chunk};

use self::before::Before;
use self::place::Surroundings;
use crate::console::{foreign_line, line};
use crate::new_site;

/// Options of `starmesh init`.
#[derive(Debug, Args)]
pub struct Options {
    /// Where the files go; nothing there is overwritten.
    #[arg(default_value = ".")]
    folder: PathBuf,
    /// Make the files also where there are some: those are renamed to observatory.toml.1 and so on.
    #[arg(long)]
    force: bool,
    /// Name of the site in the key tree: small letters, digits, '-'.
    #[arg(long, default_value = "my-site")]
    site: Chunk,
    /// Name of the telescope in the key tree.
    #[arg(long, default_value = "my-telescope")]
    telescope: Chunk,
    /// An Alpaca server, HOST:PORT; may be given several times. The files are made of the devices of these alone, and without
    /// one of all that answer on the local network.
    #[arg(long, value_name = "HOST:PORT")]
    server: Vec<String>,
    /// How long to wait for answers, s.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
}

const CONFIG: &str = "observatory.toml";
const HEADER: &str = "fits_header.csv";
const SCHEDULE: &str = "schedule.jsonl";
const MOST_ASIDE: usize = 100;

/// Asks what is there and writes the files.
pub async fn run(options: Options) -> anyhow::Result<()> {
    ensure!((0.1..=60.0).contains(&options.seconds), "--seconds {}: expected 0.1 to 60", options.seconds);
    ensure!(
        options.telescope.as_str() != Address::SHARED,
        "--telescope {}: this name is for the devices that all telescopes of a site share; choose that of the telescope",
        options.telescope
    );
    for name in [CONFIG, HEADER, SCHEDULE] {
        let path = options.folder.join(name);
        ensure!(
            options.force || !path.exists(),
            "{} is there already and stays as it is: choose another folder, or add --force, which renames the files that are there \
             to {name}.1 and so on",
            path.display()
        );
    }
    let found = devices(&options.server, discovery::discover(Duration::from_secs_f64(options.seconds))).await?;
    let around = place::ask(&found).await;
    let is_new = !options.folder.join(CONFIG).exists();
    let before = Before::read(&options.folder.join(CONFIG));
    let config = text::text(&options, &found, &around, &before);
    let observatory = text::prove(&config, around.place, &options.folder).context("the new configuration")?;
    let schedule = night::schedule(&observatory, &around)?;
    std::fs::create_dir_all(&options.folder).with_context(|| format!("cannot make {}", options.folder.display()))?;
    for (name, text) in
        [(CONFIG, config.as_str()), (HEADER, config::header::DEFAULT_CSV), (SCHEDULE, schedule.as_str())]
    {
        let path = options.folder.join(name);
        if let Some(aside) = put_aside(&path)? {
            line(format_args!("the old {} is {} now", path.display(), aside.display()))?;
            if name == CONFIG {
                for lost in before.lost(&observatory, &aside) {
                    foreign_line(format_args!("  {lost}"))?;
                }
            }
        }
        write(&path, text)?;
        line(format_args!("wrote {}", path.display()))?;
    }
    if is_new {
        new_site::forget_deleted(&options.folder.join(CONFIG))?;
    }
    print_summary(&options, &found, &around)
}

/// The devices of the servers that are named; where none is, those of all that `others` finds.
async fn devices(
    servers: &[String],
    others: impl Future<Output = std::io::Result<Vec<Found>>>,
) -> anyhow::Result<Vec<Found>> {
    if servers.is_empty() {
        let mut found: Vec<Found> = Vec::new();
        for device in others.await? {
            let is_same = |old: &Found| !device.unique_id.is_empty() && old.unique_id == device.unique_id;
            if !found.iter().any(|old| is_same(old) || is_at_one_place(old, &device)) {
                found.push(device);
            }
        }
        return Ok(found);
    }
    let mut found: Vec<Found> = Vec::new();
    for server in servers {
        config::host_port(server).map_err(|why| anyhow::anyhow!("--server {server}: expected HOST:PORT; {why}"))?;
        match discovery::configured_devices(server).await {
            Ok(devices) => {
                for device in devices {
                    if !found.iter().any(|old| is_at_one_place(old, &device)) {
                        found.push(device);
                    }
                }
            }
            Err(error) => bail!("--server {server}: it does not list its devices: {error}"),
        }
    }
    Ok(found)
}

fn is_at_one_place(a: &Found, b: &Found) -> bool {
    (a.kind, a.number, &a.server) == (b.kind, b.number, &b.server)
}

/// Gives a file that is there another name, which is returned.
fn put_aside(path: &Path) -> anyhow::Result<Option<PathBuf>> {
    if !path.exists() {
        return Ok(None);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let free =
        (1..MOST_ASIDE).map(|number| path.with_file_name(format!("{name}.{number}"))).find(|aside| !aside.exists());
    let aside = free.with_context(|| format!("{} has {MOST_ASIDE} older ones: remove some", path.display()))?;
    std::fs::rename(path, &aside).with_context(|| format!("cannot rename {}", path.display()))?;
    Ok(Some(aside))
}

/// The command that asks a server for the devices that were not found, for the same files.
fn command_for_server(options: &Options) -> String {
    format!(
        "starmesh init {} --force --site {} --telescope {} --server HOST:PORT",
        for_shell(&options.folder),
        options.site,
        options.telescope
    )
}

/// A path as a shell takes it.
fn for_shell(path: &Path) -> String {
    let path = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+@%=:,".contains(c) || c == std::path::MAIN_SEPARATOR;
    if path.chars().all(is_plain) { path } else { format!("'{}'", path.replace('\'', "'\\''")) }
}

/// Writes a new file.
fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let new = std::fs::OpenOptions::new().write(true).create_new(true).open(path);
    new.and_then(|mut file| file.write_all(text.as_bytes())).with_context(|| format!("cannot write {}", path.display()))
}

fn print_summary(options: &Options, found: &[Found], around: &Surroundings) -> anyhow::Result<()> {
    let file = options.folder.join(CONFIG);
    let (typed, file) = (for_shell(&file), file.display());
    if found.is_empty() && !options.server.is_empty() {
        let servers = options.server.join(", ");
        line(format_args!("\nNo device is at {servers}: the devices in {file} are examples, each behind a #."))?;
    } else if found.is_empty() {
        line(format_args!(
            "\nNo Alpaca device answered within {} s on UDP port {}: the devices in {file} are examples, each behind a #.\n\
             Servers in another subnet, or without discovery: write them by hand, or\n     {}",
            options.seconds,
            discovery::PORT,
            command_for_server(options)
        ))?;
    } else {
        line(format_args!("\n{} devices answered:", found.len()))?;
        for device in found {
            foreign_line(format_args!(
                "  {:20} {} number {}  {}",
                device.kind, device.server, device.number, device.name
            ))?;
        }
    }
    for told in &around.told {
        foreign_line(format_args!("  {told}"))?;
    }
    if around.place.is_none() {
        line(format_args!(
            "\nTo be filled in: latitude_deg, longitude_deg and elevation_m, as no mount reported its position."
        ))?;
    }
    line(format_args!(
        "\nNow: read {file}, then\n     starmesh check {typed}\n     starmesh up {typed}\n     starmesh order {}/{} start\n\
         Nothing opens before the last of them.",
        options.site, options.telescope
    ))
}

#[cfg(test)]
mod tests;
