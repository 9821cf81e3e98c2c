//! Keeps the database for years: values become minutes when they are old, the file is copied each day, and finished
//! nights are written as Parquet.

use std::collections::BTreeSet;
use std::time::Duration;

use config::Observatory;
use contract::observatory::AlertKind;
use node::Node;
use parquet_nights::{Outcome, PartReport};
use sky::{NightDate, night_date};
use units::{Angle, Utc};

use crate::database::{Database, Write, backup};
use crate::night::Night;
use crate::parquet::{self, NightStore};
use crate::reader::Reader;

/// How often it is looked whether there is something to do; machine time.
const EVERY: Duration = Duration::from_secs(600);
/// Nights that ended so recently are looked at again each day: records that were away come late. Of older nights those in
/// which something has changed since.
const LATE_S: f64 = 7.0 * 86_400.0;
/// Between two pieces of old values, so that rows of frames do not wait behind all of them.
const BETWEEN_PIECES: Duration = Duration::from_millis(200);

/// Runs until the node is stopped.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let mut written_on = None;
    loop {
        back_up(&node, &database).await?;
        // Before values are forgotten.
        written_on = write_nights(&node, written_on).await?;
        forget_old(&node, &database).await?;
        tokio::time::sleep(EVERY).await;
    }
}

/// One copy a day, from local noon on.
async fn back_up(node: &Node, database: &Database) -> anyhow::Result<()> {
    let archive = &node.config.archive;
    if archive.backup_count == 0 {
        return Ok(());
    }
    let longitude = Angle::from_degrees(node.config.place.longitude_deg);
    let today = night_date(longitude, node.bus.clock().utc()).to_string();
    let (file, folder, count) = (database.path().to_owned(), archive.backups(), archive.backup_count as usize);
    let made = tokio::task::spawn_blocking(move || backup(&file, &folder, &today, count)).await?;
    match made {
        Ok(copy) => {
            if let Some(copy) = copy {
                tracing::info!(copy = %copy.display(), "the database was copied");
            }
            node.alerts.clear(AlertKind::ArchiveBackup, "");
        }
        Err(error) => node.alerts.raise(
            AlertKind::ArchiveBackup,
            "",
            &format!("the archive's database could not be copied: {error:#}; it is tried again every 10 min"),
        ),
    }
    Ok(())
}

/// Once a day, from local noon on: the nights that are finished. Returns the day for which that is done.
async fn write_nights(node: &Node, written_on: Option<NightDate>) -> anyhow::Result<Option<NightDate>> {
    let Some(place) = node.config.archive.parquet.clone() else { return Ok(None) };
    let now = node.bus.clock().utc();
    let today = Night::at(now, &node.config.place).date;
    if written_on == Some(today) {
        return Ok(written_on);
    }
    let work = async {
        let store = NightStore::open(&place).await?;
        let written = store.written(&node.config).await?;
        let config = node.config.clone();
        let due = move || nights_to_write(&config, &written, now);
        let mut failed = Vec::new();
        // A night at a time, so that the node can end between two; one that cannot be written is no reason to lack the others.
        for night in tokio::task::spawn_blocking(due).await?? {
            match store.write(&node.config, &night).await {
                Ok(parts) => {
                    let is_new = |part: &&PartReport| matches!(part.outcome, Outcome::Written | Outcome::Changed);
                    let files = parts.iter().filter(is_new).count();
                    if files > 0 {
                        tracing::info!(night = %night.date, files, "the night was written as Parquet");
                    }
                }
                Err(error) => failed.push(error),
            }
        }
        let others = failed.len().saturating_sub(1);
        match failed.into_iter().next() {
            None => Ok(()),
            Some(first) if others == 0 => Err(first),
            Some(first) => Err(first.context(format!("{} nights could not be written; the first", others + 1))),
        }
    };
    match work.await {
        Ok(()) => {
            node.alerts.clear(AlertKind::ArchiveParquet, "");
            Ok(Some(today))
        }
        Err(error) => {
            let why = format!("{error:#}; it is tried again every 10 min");
            node.alerts.raise(AlertKind::ArchiveParquet, "", &why);
            Ok(None)
        }
    }
}

/// The nights before today that have no file or may have another one now. Blocks.
pub(crate) fn nights_to_write(
    config: &Observatory,
    written: &BTreeSet<String>,
    now: Utc,
) -> anyhow::Result<Vec<Night>> {
    let today = Night::at(now, &config.place).date;
    let recent = now.plus_seconds(-LATE_S);
    let late = Reader::open(&config.archive.database, config.place.telescope.as_str())?.late_changes(recent)?;
    let late: BTreeSet<NightDate> = late.into_iter().map(|at| Night::at(at, &config.place).date).collect();
    let mut nights = parquet::nights(config)?;
    nights.retain(|night| {
        let is_written = written.contains(&night.date.to_string());
        night.date < today && (night.to >= recent || late.contains(&night.date) || !is_written)
    });
    Ok(nights)
}

async fn forget_old(node: &Node, database: &Database) -> anyhow::Result<()> {
    let most = node.config.archive.raw_days;
    loop {
        let file = database.path().to_owned();
        let telescope = node.config.place.telescope.clone();
        let days =
            tokio::task::spawn_blocking(move || Reader::open(&file, telescope.as_str())?.days_of_values()).await?;
        // A database that cannot be read is the writer's to report.
        if days.map_or(true, |days| days <= most) {
            return Ok(());
        }
        database.commit(vec![Write::ForgetOld { days: most }]).await?;
        tokio::time::sleep(BETWEEN_PIECES).await;
    }
}
