//! `starmesh plan`: prints what a schedule will do, row by row, before anything moves.

mod json;
mod text;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use clap::Args;
use config::Observatory;
use node_archive::reader::Reader;
use schedule::plan::overheads::TOOK;
use schedule::plan::{Evidence, PlannedNight, Site, TakenFrame, forecast};
use schedule::read_text;
use schedule::validate::{KnownFacts, accept};
use units::Utc;

use crate::check;
use crate::console::line;

/// Frames and lines of the archive that overheads are measured from, the newest ones: some nights.
const MOST_FRAMES: u32 = 3000;
const MOST_LINES: u32 = 20_000;

/// Options of `starmesh plan`.
#[derive(Debug, Args)]
pub struct Options {
    /// Schedules, .jsonl; a folder stands for all that are in it. Each is planned for itself.
    #[arg(required = true)]
    schedules: Vec<PathBuf>,
    /// The configuration that they are for; observatory.toml next to the first one where absent.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The archive's database, of which overheads are measured; that of the configuration where absent.
    #[arg(long, value_name = "FILE")]
    archive: Option<PathBuf>,
    /// The weather is not safe then; any number of times.
    #[arg(long = "unsafe", value_name = "FROM..TO", value_parser = span)]
    unsafe_spans: Vec<(Utc, Utc)>,
    /// One JSON object a line: overheads, rows with their altitudes every 5 min, nights.
    #[arg(long)]
    json: bool,
}

/// A file with its plan.
struct Planned {
    file: PathBuf,
    night: PlannedNight,
}

/// Plans the schedules and prints the forecast.
///
/// # Errors
/// A schedule that `starmesh check` would refuse, with the same text; there is no forecast then.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let files = files(&options.schedules)?;
    let Some(first) = files.first() else { bail!("no schedule ends in .jsonl there") };
    let default = first.with_file_name("observatory.toml");
    let of = options.config.as_deref().unwrap_or(&default);
    let (config, _) = node::configuration::read_config(of)
        .context("a schedule is planned with the configuration of its telescope; name it by --config")?;
    let config = Arc::new(config);
    let evidence = evidence(options.archive.as_deref(), &config)?;
    let mut site = Site::new(config.clone(), evidence.overheads(&config))?;
    site.unsafe_spans.clone_from(&options.unsafe_spans);
    let known = KnownFacts::of(config);
    let mut planned = Vec::new();
    for file in files {
        let shown = file.display();
        let text = read_text(&file).with_context(|| format!("cannot read {shown}"))?;
        let rows = match accept(&text, &known) {
            Ok(rows) => rows,
            Err(fault) => {
                check::print_findings(&file, &text, &fault.findings)?;
                bail!("{shown} is not a valid schedule: {} errors; there is no plan", fault.findings.len());
            }
        };
        let night = forecast(rows, &mut site).with_context(|| format!("{shown}: its sky"))?;
        planned.push(Planned { file, night });
    }
    let lines = if options.json { json::lines(&planned, &site) } else { text::lines(&planned, &site) };
    lines.iter().try_for_each(|text| line(format_args!("{text}")))
}

/// Files as given, and those of folders in the order of their names.
fn files(given: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in given {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let shown = path.display();
        let inside = std::fs::read_dir(path).with_context(|| format!("cannot read the folder {shown}"))?;
        let mut inside: Vec<PathBuf> = inside.map(|entry| Ok(entry?.path())).collect::<std::io::Result<_>>()?;
        inside.retain(|file| file.extension().is_some_and(|ending| ending == "jsonl"));
        inside.sort();
        files.append(&mut inside);
    }
    Ok(files)
}

/// The archive's evidence of earlier nights; nothing where there is none yet.
fn evidence(given: Option<&Path>, config: &Observatory) -> anyhow::Result<Evidence> {
    let database = given.unwrap_or(&config.archive.database);
    if given.is_none() && !database.exists() {
        return Ok(Evidence::default());
    }
    let reader = Reader::open(database, config.place.telescope.as_str())?;
    let frames =
        reader.newest_images(MOST_FRAMES)?.into_iter().map(|image| TakenFrame::of(&image.frame, image.bytes)).collect();
    Ok(Evidence { frames, lines: reader.diary(&format!("{TOOK} "), MOST_LINES)? })
}

/// `FROM..TO`.
fn span(text: &str) -> Result<(Utc, Utc), String> {
    let wrong = || format!("expected FROM..TO such as 2026-11-21T03:00:00Z..2026-11-21T04:00:00Z, found {text:?}");
    let (from, to) = text.split_once("..").ok_or_else(wrong)?;
    let (from, to): (Utc, Utc) = from.trim().parse().ok().zip(to.trim().parse().ok()).ok_or_else(wrong)?;
    if from < to { Ok((from, to)) } else { Err(wrong()) }
}
