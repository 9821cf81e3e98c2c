//! Nights as Parquet files, which make up the network's archive; and a database that is filled again from them.

mod bucket;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use config::NetworkArchive;
use parquet_nights::{NightSpan, PartReport, Partition, Refilled};
use rusqlite::Connection;
use units::Utc;

use crate::database::read_only;
use crate::delivery::store::ObjectBucket;
use crate::folder;
use crate::night::Night;

/// The files of a configuration's telescope below a folder.
fn partition(config: &config::Observatory, folder: &Path) -> Partition {
    let (site, telescope) = (config.place.site.to_string(), config.place.telescope.to_string());
    Partition { root: folder.to_owned(), site, telescope }
}

fn span(night: &Night) -> NightSpan {
    NightSpan { date: night.date.to_string(), from: night.from, to: night.to }
}

fn open(database: &Path) -> anyhow::Result<Connection> {
    read_only(database).with_context(|| format!("cannot open the database {}", database.display()))
}

/// The nights of which the database has anything, the oldest first. Blocks.
///
/// # Errors
/// The database cannot be read.
pub fn nights(config: &config::Observatory) -> anyhow::Result<Vec<Night>> {
    let connection = open(&config.archive.database)?;
    let at = |time| Night::at(time, &config.place);
    let telescope = config.place.telescope.as_str();
    let found = parquet_nights::nights_with_data(&connection, telescope, Utc::EPOCH, |time| span(&at(time)))?;
    Ok(found.into_iter().map(|night| at(night.from)).collect())
}

/// The network's archive, as the configuration names it.
#[derive(Debug)]
pub enum NightStore {
    /// A folder.
    Folder(PathBuf),
    /// A bucket of an object store.
    Bucket(Box<ObjectBucket>),
}

impl NightStore {
    /// Makes what is needed to reach it; nothing is asked of it yet.
    ///
    /// # Errors
    /// A secret or the configuration cannot be used.
    pub async fn open(place: &NetworkArchive) -> anyhow::Result<Self> {
        Ok(match place {
            NetworkArchive::Folder(folder) => Self::Folder(folder.clone()),
            NetworkArchive::Bucket(bucket) => {
                let secret =
                    notify::secret::secret(bucket.secret_file.as_deref(), bucket.secret_env.as_deref()).await?;
                Self::Bucket(Box::new(ObjectBucket::new(bucket, secret, false).await?))
            }
        })
    }

    /// The nights that are whole in it, by their dates.
    pub(crate) async fn written(&self, config: &config::Observatory) -> anyhow::Result<BTreeSet<String>> {
        match self {
            Self::Folder(folder) => {
                let partition = partition(config, folder);
                Ok(tokio::task::spawn_blocking(move || partition.nights(&parquet_nights::NIGHTS)).await??)
            }
            Self::Bucket(bucket) => bucket::written(config, bucket).await,
        }
    }

    /// Writes a night into it; a file that would be the same stays untouched.
    ///
    /// # Errors
    /// The database cannot be read, or the place takes no files.
    pub async fn write(&self, config: &config::Observatory, night: &Night) -> anyhow::Result<Vec<PartReport>> {
        let written = match self {
            Self::Folder(folder) => {
                let (config, night, folder) = (config.clone(), *night, folder.clone());
                tokio::task::spawn_blocking(move || write(&config, &night, &folder)).await?
            }
            Self::Bucket(bucket) => bucket::write(config, night, bucket).await,
        };
        written.with_context(|| format!("the night {} could not be written as Parquet", night.date))
    }
}

/// Writes a night into a folder; a file that would be the same stays untouched. Blocks.
pub(crate) fn write(config: &config::Observatory, night: &Night, folder: &Path) -> anyhow::Result<Vec<PartReport>> {
    let connection = open(&config.archive.database)?;
    Ok(parquet_nights::write_night(&connection, &partition(config, folder), &span(night))?)
}

/// Makes a new database from the Parquet files of the telescope in a folder. No database is overwritten.
///
/// # Errors
/// There is a database already, an archive node runs, or the files are damaged; then there is no new database.
pub async fn refill(config: &config::Observatory, from: &Path, into: &Path) -> anyhow::Result<Refilled> {
    ensure!(
        !into.exists(),
        "{} is there already, and a database is never overwritten: move it away, or name another file by --into",
        into.display()
    );
    let _claim = if into == config.archive.database {
        let who = "starmesh archive rebuild";
        Some(folder::claim_database(into, &config.address(), who).await?)
    } else {
        None
    };
    let (partition, raw_days, into) = (partition(config, from), config.archive.raw_days, into.to_owned());
    let fill = move |connection: &Connection| Ok(parquet_nights::refill(connection, &partition, raw_days)?);
    tokio::task::spawn_blocking(move || crate::database::make(&into, fill)).await?
}

#[cfg(test)]
mod tests;
