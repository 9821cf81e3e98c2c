//! A night with all that is known of it, in a new folder: files, telemetry, log, facts and guiding as CSV, everything as
//! Parquet, the report, and a manifest.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use config::Observatory;
use fits::profile::ProfileName;
use rusqlite::types::ValueRef;
use serde::Serialize;
use serde_json::json;
use units::Utc;

use crate::database::{read_only, stamp};
use crate::delivery::hash::hash_file;
use crate::delivery::manifest::{Held, Manifest, ManifestFile};
use crate::folder::{is_stored, relative_text, without_links};
use crate::night::Night;
use crate::reader::Reader;
use crate::{night_report, parquet};

/// The tables of an export: file, and what is asked; `?1` and `?2` are the night's ends, `?3` the telescope, `?4` and `?5` the ends
/// in microseconds.
const TABLES: [(&str, &str); 4] = [
    (
        "telemetry.csv",
        "SELECT strftime('%Y-%m-%dT%H:%M:%S', at_us / 1000000, 'unixepoch') || printf('.%06dZ', at_us % 1000000) AS time_utc,
            telescope, device_type, device_name, device_command AS property, value_type,
            iif(value_type = 0, NULL, value) AS value, iif(value_type = 0, value, NULL) AS no_data
         FROM samples JOIN series ON series.id = samples.series
         WHERE at_us >= ?4 AND at_us < ?5 AND telescope IN (?3, 'shared') AND ?1 < ?2 ORDER BY at_us, series.id",
    ),
    (
        "log.csv",
        "SELECT replace(datetime, ' ', 'T') || 'Z' AS time_utc, telescope, node, level, target, message FROM log
         WHERE datetime >= ?1 AND datetime < ?2 AND telescope IN (?3, 'shared') AND ?4 < ?5 ORDER BY datetime, rowid",
    ),
    (
        "guiding.csv",
        "SELECT replace(datetime, ' ', 'T') || 'Z' AS time_utc, guiding.* FROM guiding
         WHERE datetime >= ?1 AND datetime < ?2 AND telescope = ?3 AND ?4 < ?5 ORDER BY datetime",
    ),
    (
        "facts.csv",
        "SELECT replace(images.date_obs, ' ', 'T') || 'Z' AS time_utc, images.file, facts.* FROM facts JOIN images USING (frame_id)
         WHERE images.date_obs >= ?1 AND images.date_obs < ?2 AND images.telescope IN (?3, '') AND ?4 < ?5 ORDER BY images.date_obs",
    ),
];

/// What was exported.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Files of frames.
    pub frames: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Rows of each table.
    pub rows: Vec<(String, usize)>,
    /// The report and the Parquet files.
    pub documents: Vec<Document>,
    /// Files that are no longer in the archive's folder.
    pub gone: Vec<String>,
}

/// A file that is no frame and no table of the export.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Document {
    /// Where it is, relative to the folder of the export.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
}

/// Writes a night into a folder that is new or empty. Blocks.
///
/// # Errors
/// The folder is in use or cannot be written, or the archive cannot be read, as when the disk of its files is away: then nothing
/// was written. What was written so far stays, without manifest.
pub fn export(config: &Observatory, database: &Path, night: &Night, out: &Path, now: Utc) -> anyhow::Result<Exported> {
    let folder = out.display();
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {folder}"))?;
    let mut entries = fs::read_dir(out).with_context(|| format!("cannot read the folder {folder}"))?;
    ensure!(entries.next().is_none(), "the folder {folder} is not empty: name one that is new or empty");
    let frames = Reader::open(database, config.place.telescope.as_str())?.frames(night.from, night.to)?;
    let (mut exported, mut files) = (Exported::default(), Vec::new());
    let images = &config.folders.images;
    let mut here = Vec::new();
    for image in frames.iter().map(|frame| &frame.image) {
        if is_stored(images, &image.path(images))? {
            here.push(image);
        } else {
            exported.gone.push(image.file.clone());
        }
    }
    for image in here {
        let name = format!("files/{}", image.file);
        let (from, to) = (image.path(images), out.join(&name));
        let cannot = || format!("cannot copy {} to {}", from.display(), to.display());
        without_links(images, &from).with_context(cannot)?;
        fs::create_dir_all(to.parent().unwrap_or(out)).with_context(cannot)?;
        let part = to.with_extension("part");
        fs::copy(&from, &part).and_then(|_| File::open(&part)?.sync_all()).with_context(cannot)?;
        let held = hash_file(&part).with_context(cannot)?;
        let here = hash_file(&from).with_context(cannot)?;
        ensure!(
            held == here,
            "{} differs from {}: a header was completed meanwhile; try again",
            to.display(),
            image.file
        );
        fs::rename(&part, &to).with_context(cannot)?;
        exported.frames += 1;
        exported.bytes += held.bytes;
        files.push(ManifestFile::new(image, &name, &held, None));
    }
    let mut tables = Vec::new();
    for (name, sql) in TABLES {
        let path = out.join(name);
        let rows = table(database, sql, night, config.place.telescope.as_str(), &path)?;
        let held = hash_file(&path).with_context(|| format!("cannot read {}", path.display()))?;
        tables.push(json!({ "name": name, "rows": rows, "bytes": held.bytes, "sha256": held.sha256 }));
        exported.rows.push((name.to_owned(), rows));
    }
    exported.documents = documents(config, database, night, out, now)?;
    let manifest = Manifest::new(config, night, ("export", ProfileName::Astra), now, files);
    let mut document = serde_json::to_value(manifest)?;
    document["tables"] = tables.into();
    document["documents"] = json!(exported.documents);
    document["not_in_the_archive"] = exported.gone.clone().into();
    document["latitude_deg"] = json!(config.place.latitude_deg);
    document["longitude_deg"] = json!(config.place.longitude_deg);
    document["elevation_m"] = json!(config.place.elevation_m);
    write_last(out.join("manifest.json"), &serde_json::to_string_pretty(&document)?)?;
    Ok(exported)
}

/// Writes the report as page and as JSON, and the night's Parquet files.
fn documents(
    config: &Observatory,
    database: &Path,
    night: &Night,
    out: &Path,
    now: Utc,
) -> anyhow::Result<Vec<Document>> {
    let cannot = || format!("cannot write the report or the Parquet files into {}", out.display());
    let reader = Reader::open(database, config.place.telescope.as_str())?;
    let report = night_report::make(config, &reader, night, night_report::now(&reader, now)?)?;
    let page = report::html::page(&report).into_bytes();
    let mut written = Vec::new();
    for (name, content) in [("report.html", page), ("report.json", serde_json::to_vec_pretty(&report)?)] {
        let path = out.join(name);
        fs::write(&path, content).and_then(|()| File::open(&path)?.sync_all()).with_context(cannot)?;
        written.push(path);
    }
    let parts = parquet::write(config, night, &out.join("parquet")).with_context(cannot)?;
    written.extend(parts.into_iter().filter(|part| part.bytes > 0).map(|part| part.path));
    let document = |path: PathBuf| {
        let Held { bytes, sha256 } = hash_file(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(Document { name: relative_text(out, &path), bytes, sha256 })
    };
    written.into_iter().map(document).collect()
}

/// The manifest appears whole or not at all.
fn write_last(path: PathBuf, text: &str) -> anyhow::Result<()> {
    let part = path.with_extension("part");
    fs::write(&part, format!("{text}\n"))
        .and_then(|()| File::open(&part)?.sync_all())
        .and_then(|()| fs::rename(&part, &path))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Writes what a question gives as CSV; returns the number of rows.
fn table(database: &Path, sql: &str, night: &Night, telescope: &str, path: &Path) -> anyhow::Result<usize> {
    let cannot = || format!("cannot write {} from {}", path.display(), database.display());
    let connection = read_only(database).with_context(cannot)?;
    let mut statement = connection.prepare(sql).with_context(cannot)?;
    let columns: Vec<String> = statement.column_names().into_iter().map(str::to_owned).collect();
    let mut csv = csv::Writer::from_path(path).with_context(cannot)?;
    csv.write_record(&columns).with_context(cannot)?;
    let ends = (stamp(night.from), stamp(night.to), telescope, night.from.micros(), night.to.micros());
    let mut rows = statement.query(ends).with_context(cannot)?;
    let mut count = 0;
    while let Some(row) = rows.next().with_context(cannot)? {
        let mut record = csv::StringRecord::new();
        for column in 0..columns.len() {
            let field = match row.get_ref(column).with_context(cannot)? {
                ValueRef::Null => String::new(),
                ValueRef::Integer(value) => value.to_string(),
                ValueRef::Real(value) => value.to_string(),
                ValueRef::Text(text) => String::from_utf8_lossy(text).into_owned(),
                ValueRef::Blob(bytes) => crate::delivery::hash::hex(bytes),
            };
            record.push_field(&field);
        }
        csv.write_record(&record).with_context(cannot)?;
        count += 1;
    }
    csv.flush().with_context(cannot)?;
    Ok(count)
}
