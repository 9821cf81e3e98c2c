//! `starmesh night parquet`: writes nights for the network's archive.

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use config::NetworkArchive;
use node_archive::night::Night;
use node_archive::parquet::NightStore;

use super::{Selection, Telescope};
use crate::console::{foreign_line, line};

/// Which nights, and where to.
#[derive(Debug, Args)]
pub struct ParquetArguments {
    /// The date of the night's evening, such as 20261121; `last` for the last night that has frames.
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    night: Option<String>,
    /// Every night of which the database has anything.
    #[arg(long)]
    all: bool,
    /// A folder of the network's archive; the folder or bucket of `[archive] parquet` of the configuration where absent.
    #[arg(long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    telescope: Telescope,
}

pub(super) async fn run(arguments: ParquetArguments) -> anyhow::Result<()> {
    let ParquetArguments { night, out, telescope, .. } = arguments;
    let (config, nights) = match night {
        Some(night) => {
            let (archive, night) = Selection { night, telescope }.open()?;
            (archive.config, vec![night])
        }
        None => {
            let config = telescope.open()?.config;
            let nights = node_archive::parquet::nights(&config)?;
            ensure!(!nights.is_empty(), "the database has no night yet");
            (config, nights)
        }
    };
    let place = out.map(NetworkArchive::Folder).or_else(|| config.archive.parquet.clone());
    let place = place.context("no folder is named: use --out DIR, or `parquet` in [archive] of the configuration")?;
    let store = NightStore::open(&place).await?;
    line(format_args!("{:8}  {:>10}  {:>8}  files", "night", "rows", "MB"))?;
    if let [night] = nights.as_slice() {
        return write(&config, night, &store).await;
    }
    let mut failed = Vec::new();
    for night in nights {
        // One night that cannot be written is no reason to lack the others.
        if let Err(error) = write(&config, &night, &store).await {
            foreign_line(format_args!("{:8}  {error:#}", night.date))?;
            failed.push(night.date.to_string());
        }
    }
    ensure!(failed.is_empty(), "{} of the nights could not be written: {}", failed.len(), failed.join(", "));
    Ok(())
}

async fn write(config: &config::Observatory, night: &Night, store: &NightStore) -> anyhow::Result<()> {
    use parquet_nights::Outcome;
    let parts = store.write(config, night).await?;
    let count = |outcome| parts.iter().filter(|part| part.outcome == outcome).count();
    let (rows, bytes) = parts.iter().fold((0, 0), |(rows, bytes), part| (rows + part.rows, bytes + part.bytes));
    ensure!(
        bytes > 0,
        "the database has nothing of the night {}; `starmesh night list` shows those with frames",
        night.date
    );
    let (new, changed, same) = (count(Outcome::Written), count(Outcome::Changed), count(Outcome::Unchanged));
    let megabytes = bytes as f64 / 1e6;
    line(format_args!(
        "{:8}  {rows:>10}  {megabytes:>8.2}  {new} written, {changed} changed, {same} as before",
        night.date
    ))
}
