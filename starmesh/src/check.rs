//! `starmesh check`: proves a configuration and its schedule.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use contract::Name;

use crate::console::line;

/// Options of `starmesh check`.
#[derive(Debug, Args)]
pub struct Options {
    /// The observatory.toml.
    file: PathBuf,
}

/// Proves the file, the FITS-header table and the schedule that it names.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let (config, header) = bus::node::read_config(&options.file)?;
    line(format_args!("{}: valid", options.file.display()))?;
    line(format_args!("  telescope {}", config.address()))?;
    for (kind, common) in config.devices() {
        line(format_args!("  {kind:20} {:16} http://{} number {}", common.name, common.server, common.number))?;
    }
    line(format_args!("  {} rows in the FITS-header table", header.rows.len()))?;
    let schedule = &config.schedule.file;
    if !schedule.exists() {
        line(format_args!("  no schedule yet at {}", schedule.display()))?;
        return Ok(());
    }
    let text = std::fs::read_to_string(schedule).with_context(|| format!("cannot read {}", schedule.display()))?;
    let cameras: Vec<Name> = config.camera.iter().map(|camera| camera.common.name.clone()).collect();
    let rows = node_observatory::schedule::parse(&text, &cameras)
        .with_context(|| format!("{} is not a valid schedule", schedule.display()))?;
    line(format_args!("{}: valid ({} rows)", schedule.display(), rows.len()))?;
    Ok(())
}
