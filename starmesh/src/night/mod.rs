//! `starmesh night`: what the archive has of a night. Each command reads the archive's database, also while the archive
//! node runs.

mod cube;
mod deliver;
mod export;
mod list;
mod parquet;
mod report;

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use bus::Clock;
use clap::{Args, Subcommand};
use config::Observatory;
use node_archive::night::Night;
use node_archive::reader::Reader;
use units::Utc;

/// What `starmesh night` does.
#[derive(Debug, Subcommand)]
pub enum NightCommand {
    /// The nights that have frames.
    List(Telescope),
    /// Write all frames of a target as one file: a cube, and a table of what varies.
    Cube(cube::Options),
    /// Write a night as Parquet files, for the network's archive.
    Parquet(parquet::ParquetArguments),
    /// What each second of a night was used for, and what came out, as a page or as JSON; also while the night runs.
    Report(report::ReportOptions),
    /// Hand a night over to the destinations of [[delivery]]; what is there already is verified.
    Deliver(deliver::Handover),
    /// Read a delivered night again, and compare it with its manifest and with the archive.
    Verify(deliver::Handover),
    /// Copy a night with its telemetry, log, facts and guiding into a folder.
    Export(export::Export),
}

/// Whose archive.
#[derive(Debug, Args)]
pub struct Telescope {
    /// The telescope's configuration.
    #[arg(long, default_value = "observatory.toml")]
    config: PathBuf,
}

/// A night of an archive.
#[derive(Debug, Args)]
pub struct Selection {
    /// The date of the night's evening, such as 20261121; `last` for the last night that has frames.
    night: String,
    #[command(flatten)]
    telescope: Telescope,
}

/// A telescope's archive, open for reading.
pub struct Archive {
    /// The telescope's configuration.
    pub config: Observatory,
    /// Reads its database.
    pub reader: Reader,
}

impl Archive {
    /// Sky time, for stamps: of the simulator while it runs, else of this machine.
    async fn now(&self) -> Utc {
        let simulator = self.config.clock.simulator.as_ref();
        let simulated = match simulator {
            Some(base) => Clock::of_simulator(base).await.ok(),
            None => None,
        };
        simulated.unwrap_or_else(Clock::machine_clock).utc()
    }
}

impl Telescope {
    /// Opens the archive that the configuration names.
    ///
    /// # Errors
    /// The configuration or the database cannot be used.
    pub fn open(&self) -> anyhow::Result<Archive> {
        let shown = self.config.display();
        let config =
            node::configuration::read_observatory(&self.config).with_context(|| format!("cannot use {shown}"))?;
        let database = &config.archive.database;
        if !database.exists() {
            bail!(
                "there is no archive yet: {} does not exist; the archive node makes it when it first runs",
                database.display()
            );
        }
        let reader = Reader::open(database, config.place.telescope.as_str())?;
        Ok(Archive { config, reader })
    }
}

impl Selection {
    fn open(&self) -> anyhow::Result<(Archive, Night)> {
        let archive = self.telescope.open()?;
        let night = match self.night.as_str() {
            "last" => {
                let span = archive.reader.span_of_frames()?;
                let (_, newest) = span.context("no frame is stored yet, so there is no last night")?;
                Night::at(newest, &archive.config.place)
            }
            date => {
                let date = date.replace('-', "").parse();
                let date = date.with_context(|| {
                    format!("{:?} is no night: give the date of its evening, such as 20261121, or `last`", self.night)
                })?;
                Night::new(date, &archive.config.place)
            }
        };
        Ok((archive, night))
    }
}

/// Runs the command.
///
/// # Errors
/// The configuration, the database or the night cannot be used.
pub async fn run(command: NightCommand) -> anyhow::Result<()> {
    match command {
        NightCommand::List(telescope) => list::run(&telescope.open()?),
        NightCommand::Cube(options) => cube::run(&options),
        NightCommand::Parquet(arguments) => parquet::run(arguments).await,
        NightCommand::Report(options) => report::run(&options),
        NightCommand::Deliver(handover) => deliver::deliver(&handover).await,
        NightCommand::Verify(handover) => deliver::check(&handover).await,
        NightCommand::Export(command) => export::run(&command).await,
    }
}
