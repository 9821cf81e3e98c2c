//! `starmesh schedule`: puts another schedule in force, from any machine on the bus, and looks at those that were, where the
//! observatory node keeps them.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, Subcommand};
use contract::OrderKind;
use node_observatory::schedule::versions::Versions;

use crate::console::line;
use crate::join::Join;
use crate::order;

/// What `starmesh schedule` does.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Put a file in the place of the schedule in force; a bad one is refused, and nothing changes.
    Put(Put),
    /// Every schedule that was in force: number, time, author, rows, reason.
    List(Kept),
    /// Print one of them.
    Show {
        #[command(flatten)]
        kept: Kept,
        /// Its number in the list; the newest where absent.
        version: Option<u64>,
    },
}

/// Options of `starmesh schedule put`.
#[derive(Debug, Args)]
pub struct Put {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    /// The new schedule.
    file: PathBuf,
    /// Why, for the list of versions and the log.
    #[arg(long)]
    reason: String,
    #[command(flatten)]
    join: Join,
}

/// Where the versions are: in the data folder of the observatory node, which this must be the host of.
#[derive(Debug, Args)]
pub struct Kept {
    /// The telescope's configuration.
    #[arg(long, default_value = "observatory.toml")]
    config: PathBuf,
}

impl Kept {
    fn versions(&self) -> anyhow::Result<Versions> {
        let shown = self.config.display();
        let text = std::fs::read_to_string(&self.config).with_context(|| format!("cannot read {shown}"))?;
        let folder = self.config.parent().unwrap_or(Path::new("."));
        let config = config::parse(&text, folder).with_context(|| format!("{shown} is not taken"))?;
        Ok(Versions::of(&config))
    }
}

/// Does it.
pub async fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Put(put) => {
            let shown = put.file.display();
            let text = std::fs::read_to_string(&put.file).with_context(|| format!("cannot read {shown}"))?;
            order::give(&put.telescope, OrderKind::PutSchedule { text }, put.reason, put.join).await
        }
        Command::List(kept) => list(&kept.versions()?),
        Command::Show { kept, version } => show(&kept.versions()?, version),
    }
}

fn list(versions: &Versions) -> anyhow::Result<()> {
    for kept in versions.list().context("the versions cannot be read")? {
        let (version, at_utc, author, rows) = (kept.version, kept.at_utc, kept.author, kept.rows);
        line(format_args!("{version:6}  {at_utc}  {rows:5} rows  {author}  {}", kept.reason))?;
    }
    Ok(())
}

fn show(versions: &Versions, version: Option<u64>) -> anyhow::Result<()> {
    let newest = || anyhow::Ok(versions.list()?.last().context("no schedule was kept yet")?.version);
    let version = version.map_or_else(newest, Ok)?;
    let text = versions.text(version)?;
    for row in text.lines() {
        line(format_args!("{row}"))?;
    }
    Ok(())
}
