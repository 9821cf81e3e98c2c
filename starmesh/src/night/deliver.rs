//! `starmesh night deliver` and `starmesh night verify`: a night at its destinations.

use anyhow::bail;
use clap::Args;
use config::{Delivery, Observatory};
use node_archive::delivery::run::{Delivered, Run};
use node_archive::delivery::verify::{Verified, verify};
use node_archive::night::Night;

use super::Selection;
use crate::console::foreign_line;

/// A night, and where it is handed over to.
#[derive(Debug, Args)]
pub struct Handover {
    #[command(flatten)]
    selection: Selection,
    /// Only this destination of `[[delivery]]`; all of them without it.
    #[arg(long, value_name = "NAME")]
    to: Option<String>,
}

/// The destinations that are asked for.
fn destinations<'a>(config: &'a Observatory, to: Option<&str>) -> anyhow::Result<Vec<&'a Delivery>> {
    if config.delivery.is_empty() {
        bail!("observatory.toml has no destination: add [[delivery]], as docs/operator/delivery.md shows");
    }
    let Some(name) = to else { return Ok(config.delivery.iter().collect()) };
    let found: Vec<_> = config.delivery.iter().filter(|delivery| delivery.name.as_str() == name).collect();
    if found.is_empty() {
        let known: Vec<_> = config.delivery.iter().map(|delivery| delivery.name.as_str()).collect();
        bail!("there is no destination {name:?}: expected one of {}", known.join(", "));
    }
    Ok(found)
}

/// Delivers a night now.
pub(super) async fn deliver(command: &Handover) -> anyhow::Result<()> {
    let (archive, night) = command.selection.open()?;
    let config = &archive.config;
    let now = archive.now().await;
    let mut failed = Vec::new();
    for delivery in destinations(config, command.to.as_deref())? {
        let run = Run { config, delivery, night, database: &config.archive.database, now };
        let (name, date) = (&delivery.name, night.date);
        match run.deliver().await {
            Ok(done) => {
                report(&night, delivery, &done)?;
                if done.frames > 0 && done.manifest.is_none() {
                    failed.push(name.to_string());
                }
            }
            Err(error) => {
                foreign_line(format_args!("{name}: night {date} was not delivered: {error:#}"))?;
                failed.push(name.to_string());
            }
        }
    }
    if !failed.is_empty() {
        bail!("night {} is not delivered to {}", night.date, failed.join(", "));
    }
    Ok(())
}

fn report(night: &Night, delivery: &Delivery, done: &Delivered) -> anyhow::Result<()> {
    let (name, date) = (&delivery.name, night.date);
    if done.frames == 0 {
        return foreign_line(format_args!("{name}: night {date} has no frames for it"));
    }
    let megabytes = done.sent_bytes as f64 / 1e6;
    let (frames, sent, there) = (done.frames, done.sent, done.there);
    foreign_line(format_args!(
        "{name}: night {date}: {frames} frames, {sent} sent ({megabytes:.1} MB), {there} were there"
    ))?;
    if done.incomplete > 0 {
        let waiting = done.incomplete;
        foreign_line(format_args!(
            "{name}: {waiting} frames wait for their headers, which the archive node completes: start it, or deliver later"
        ))?;
    }
    for warning in done.warning_lines() {
        foreign_line(format_args!("{name}: {warning}"))?;
    }
    for fault in &done.faults {
        foreign_line(format_args!("{name}: {fault}"))?;
    }
    match &done.manifest {
        Some(manifest) => foreign_line(format_args!("{name}: delivered and verified; manifest {manifest}")),
        None => Ok(()),
    }
}

/// Reads a delivered night again.
pub(super) async fn check(command: &Handover) -> anyhow::Result<()> {
    let (archive, night) = command.selection.open()?;
    let config = &archive.config;
    let mut failed = Vec::new();
    for delivery in destinations(config, command.to.as_deref())? {
        let name = &delivery.name;
        match verify(config, delivery, &night, &config.archive.database).await {
            Ok(verified) => {
                if !compare(&night, delivery, &verified)? {
                    failed.push(name.to_string());
                }
            }
            Err(error) => {
                foreign_line(format_args!("{name}: night {} cannot be verified: {error:#}", night.date))?;
                failed.push(name.to_string());
            }
        }
    }
    if !failed.is_empty() {
        bail!("night {} is not whole at {}", night.date, failed.join(", "));
    }
    Ok(())
}

/// Prints what was found; returns whether the night is whole there.
fn compare(night: &Night, delivery: &Delivery, verified: &Verified) -> anyhow::Result<bool> {
    let (name, date) = (&delivery.name, night.date);
    let Some(manifest) = &verified.manifest else {
        if verified.missing.is_empty() {
            foreign_line(format_args!("{name}: night {date} has no frames for it"))?;
            return Ok(true);
        }
        let command = format!("starmesh night deliver {date} --to {name}");
        foreign_line(format_args!("{name}: night {date} has no manifest there: it was not delivered; {command}"))?;
        return Ok(false);
    };
    let (good, same, gone) = (verified.good.len(), verified.same_here, verified.gone_here);
    foreign_line(format_args!("{name}: night {date}: {good} files are as {manifest} lists them"))?;
    foreign_line(format_args!(
        "{name}: {same} of them are in the archive as they were delivered, {gone} have left it"
    ))?;
    for file in &verified.newer_here {
        foreign_line(format_args!("{name}: {file} has a newer header in the archive than at the destination"))?;
    }
    for fault in &verified.faults {
        foreign_line(format_args!("{name}: {fault}"))?;
    }
    for file in &verified.missing {
        foreign_line(format_args!("{name}: {file} is in the archive and not in the manifest"))?;
    }
    Ok(verified.is_whole())
}
