//! `starmesh archive rebuild`: a new database from the telescope's nights in the network's archive.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;

use crate::console::line;

/// Where the nights are, and which database is made of them.
#[derive(Debug, Args)]
pub struct Nights {
    /// The folder of the network's archive, with the folders `telemetry`, `images` and so on.
    #[arg(long)]
    from: PathBuf,
    /// The new database; the one that the configuration names where absent.
    #[arg(long)]
    into: Option<PathBuf>,
    /// The telescope's configuration.
    #[arg(long, default_value = "observatory.toml")]
    config: PathBuf,
}

pub(super) async fn run(nights: &Nights) -> anyhow::Result<()> {
    let shown = nights.config.display();
    let (config, _) =
        node::configuration::read_config(&nights.config).with_context(|| format!("cannot use {shown}"))?;
    let into = nights.into.as_ref().unwrap_or(&config.archive.database);
    let made = node_archive::parquet::refill(&config, &nights.from, into).await?;
    line(format_args!("{} was made from {} nights", into.display(), made.nights))?;
    for (table, rows) in made.rows {
        line(format_args!("{table:12}  {rows:>10} rows"))?;
    }
    Ok(())
}
