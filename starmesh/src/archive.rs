//! `starmesh archive`: copies the archive's database, puts a copy back in its place, makes it again from Parquet, and
//! finds frames in it.

mod frames;
mod rebuild;

use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use config::Observatory;

use crate::console::line;

/// What `starmesh archive` does.
#[derive(Debug, Subcommand)]
pub enum ArchiveCommand {
    /// Copy the database as it is now; the archive node may run meanwhile.
    Backup(CopyFile),
    /// Put a copy in the place of the database, which is kept under another name. Stop the archive node before.
    Restore(CopyFile),
    /// Find frames by night, target, filter, type, quality, or a place that they show.
    Frames(frames::Options),
    /// Make a new database from the telescope's nights in the network's archive; no database is overwritten.
    Rebuild(rebuild::Nights),
}

/// The copy, and whose database.
#[derive(Debug, Args)]
pub struct CopyFile {
    /// The copy. Those that the archive node makes each day are in the folder `backups` next to the database.
    copy: PathBuf,
    /// The telescope's configuration.
    #[arg(long, default_value = "observatory.toml")]
    config: PathBuf,
}

impl CopyFile {
    fn config(&self) -> anyhow::Result<Observatory> {
        let shown = self.config.display();
        node::configuration::read_observatory(&self.config).with_context(|| format!("cannot use {shown}"))
    }
}

/// Runs the command.
///
/// # Errors
/// The configuration, the copy or the database cannot be used, or an archive node uses the database.
pub async fn run(command: ArchiveCommand) -> anyhow::Result<()> {
    match command {
        ArchiveCommand::Backup(file) => backup(&file),
        ArchiveCommand::Restore(file) => restore(&file).await,
        ArchiveCommand::Frames(options) => frames::run(&options),
        ArchiveCommand::Rebuild(nights) => rebuild::run(&nights).await,
    }
}

fn backup(file: &CopyFile) -> anyhow::Result<()> {
    let database = file.config()?.archive.database;
    node_archive::database::copy_now(&database, &file.copy)?;
    line(format_args!("{} was copied to {}", database.display(), file.copy.display()))
}

async fn restore(file: &CopyFile) -> anyhow::Result<()> {
    let config = file.config()?;
    let aside = node_archive::restore(&config, &file.copy).await?;
    line(format_args!("{} is what {} holds now", config.archive.database.display(), file.copy.display()))?;
    aside.map_or(Ok(()), |aside| line(format_args!("the database of before is {}", aside.display())))
}
