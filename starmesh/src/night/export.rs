//! `starmesh night export`: a night with all that is known of it, in a folder.

use std::path::PathBuf;

use clap::Args;

use super::Selection;
use crate::console::foreign_line;

/// A night, and the folder that it is copied to.
#[derive(Debug, Args)]
pub struct Export {
    #[command(flatten)]
    selection: Selection,
    /// The folder; new or empty.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) async fn run(command: &Export) -> anyhow::Result<()> {
    let (archive, night) = command.selection.open()?;
    let now = archive.now().await;
    let out = command.out.clone();
    let work = move || {
        let config = &archive.config;
        node_archive::export::export(config, &config.archive.database, &night, &out, now)
    };
    let exported = tokio::task::spawn_blocking(work).await??;
    let (frames, megabytes, out) = (exported.frames, exported.bytes as f64 / 1e6, command.out.display());
    foreign_line(format_args!("night {}: {frames} files ({megabytes:.1} MB) in {out}", night.date))?;
    for (table, rows) in &exported.rows {
        foreign_line(format_args!("{table}: {rows} rows"))?;
    }
    foreign_line(format_args!(
        "report.html, report.json and {} Parquet files",
        exported.documents.len().saturating_sub(2)
    ))?;
    for file in &exported.gone {
        foreign_line(format_args!("{file} is no longer in the archive's folder"))?;
    }
    Ok(())
}
