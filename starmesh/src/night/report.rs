//! `starmesh night report`: what each second of a night was used for, and what came out.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use node_archive::night_report;

use super::Selection;
use crate::console::{foreign_line, line};

/// The options of the report.
#[derive(Debug, Args)]
pub struct ReportOptions {
    #[command(flatten)]
    night: Selection,
    /// JSON instead of a page; it is printed where no file is named.
    #[arg(long)]
    json: bool,
    /// The file to write; without it `report-NIGHT.html` in this folder.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(options: &ReportOptions) -> anyhow::Result<()> {
    let (archive, night) = options.night.open()?;
    let now = night_report::now(&archive.reader, bus::Clock::machine_clock().utc())?;
    let report = night_report::make(&archive.config, &archive.reader, &night, now)?;
    let text = if options.json { serde_json::to_string_pretty(&report)? } else { report::html::page(&report) };
    let file = match (&options.out, options.json) {
        (None, true) => return line(format_args!("{text}")),
        (Some(file), _) => file.clone(),
        (None, false) => PathBuf::from(format!("report-{}.html", night.date)),
    };
    std::fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))?;
    line(format_args!(
        "night {}, {} to {} UTC",
        report.night,
        report.from_utc.strftime("%H:%M:%S"),
        report.to_utc.strftime("%H:%M:%S")
    ))?;
    for time in report.times.iter().filter(|time| time.time_s > 0.0) {
        let longest = time.kinds.first().map_or("", |kind| kind.kind.as_str());
        let longest = contract::printable(longest);
        line(format_args!(
            "{:18}  {:>9.1} s  {:>5.1} %  {longest}",
            time.group.words(),
            time.time_s,
            100.0 * time.share
        ))?;
    }
    if let Some(why) = &report.nothing_tried {
        foreign_line(format_args!("nothing was tried: {why}"))?;
    }
    for what in &report.unreadable {
        foreign_line(format_args!("left out, as it cannot be read: {what}"))?;
    }
    line(format_args!("written to {}", file.display()))
}
