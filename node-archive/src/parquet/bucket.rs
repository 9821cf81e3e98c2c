//! Nights as Parquet in a bucket: what is there of a night is fetched, the night is written into these files as into a
//! folder, and those that changed are put in their places and read back, that of `nights` last.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use anyhow::Context as _;
use parquet_nights::{NIGHTS, Outcome, PartReport, TABLES};

use super::partition;
use crate::delivery::hash::hash_file;
use crate::delivery::item::Item;
use crate::delivery::record::{SENT_FOLDER, clear_work, take_turn, work_folder};
use crate::delivery::store::ObjectBucket;
use crate::folder::relative_text;
use crate::night::Night;

/// Its lock and its copies are those of a destination of this name, which no name of a site can be.
const NAME: &str = ".parquet";

/// The nights that are whole in a bucket, by their dates.
pub(super) async fn written(config: &config::Observatory, bucket: &ObjectBucket) -> anyhow::Result<BTreeSet<String>> {
    let any = partition(config, Path::new("")).part(&NIGHTS, "any");
    let folder = any.parent().and_then(Path::parent).unwrap_or(Path::new(""));
    let objects = bucket.list(&relative_text(Path::new(""), folder)).await?;
    let night = |key: &String| {
        let (night, part) = key.rsplit_once('/')?;
        let night = night.rsplit_once("/night=")?.1;
        any.ends_with(part).then(|| night.to_owned())
    };
    Ok(objects.iter().filter_map(night).collect())
}

/// Writes a night into a bucket.
pub(super) async fn write(
    config: &config::Observatory,
    night: &Night,
    bucket: &ObjectBucket,
) -> anyhow::Result<Vec<PartReport>> {
    // Two writers at a time would each leave out the rows of the other.
    let _turn = take_turn(config, NAME)?;
    clear_work(config, NAME);
    let work = work_folder(config, NAME);
    let folder = tempfile::Builder::new().prefix(SENT_FOLDER).tempdir_in(&work);
    let folder = folder.with_context(|| format!("cannot make a folder in {}", work.display()))?;
    let (root, date) = (folder.path().to_owned(), night.date.to_string());
    let partition = partition(config, &root);
    let mut versions = HashMap::new();
    for table in TABLES.iter().chain([&NIGHTS]) {
        let path = partition.part(table, &date);
        tokio::fs::create_dir_all(path.parent().unwrap_or(&root)).await?;
        versions.insert(table.name, bucket.fetch(&relative_text(&root, &path), &path).await?);
    }
    let (config, night, to) = (config.clone(), *night, root.clone());
    let reports = tokio::task::spawn_blocking(move || super::write(&config, &night, &to)).await??;
    for report in reports.iter().filter(|report| matches!(report.outcome, Outcome::Written | Outcome::Changed)) {
        let (file, name) = (report.path.clone(), relative_text(&root, &report.path));
        let held = tokio::task::spawn_blocking(move || hash_file(&file)).await?;
        let held = held.with_context(|| format!("cannot read {}", report.path.display()))?;
        let item = Item { file: report.path.clone(), name, bytes: held.bytes, sha256: held.sha256 };
        bucket.replace(&item, versions.remove(report.table).flatten()).await?;
    }
    Ok(reports)
}
