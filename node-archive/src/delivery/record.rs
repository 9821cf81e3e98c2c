//! What this archive knows of its deliveries: a file of lines for each destination and night, in the data folder.
//!
//! A line is written before a file gets its name at the destination, so that after a kill a file that is there is known as
//! ours. Nothing here counts as delivered by itself: the destination is read. Without the file everything is read again,
//! and the only loss is that a file whose header changed between two tries is taken for another one.

use std::collections::HashMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use config::{Delivery, Observatory};
use contract::CommandId;
use node::FileLock;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use sky::NightDate;

use super::hash::hex;
use crate::night::Night;

/// How the names of folders begin that hold copies for a moment: of what is sent, and of what is read back.
pub const SENT_FOLDER: &str = "send-";
pub const FETCHED_FOLDER: &str = "back-";

/// A line of the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    /// A file is about to be sent, and the content of the archive's file of which it was made.
    Sending { name: String, sha256: String, archive_sha256: Option<String> },
    /// All frames of this set are at the destination, and the manifest too; `place` is where that was.
    Delivered { manifest: String, frames: usize, set: String, place: Option<String> },
    /// The files of this set have left the folder of images.
    Removed { set: String },
}

/// The record of one night at one destination.
#[derive(Debug)]
pub struct Record {
    file: PathBuf,
    /// By name and content: the content of the archive's file.
    sent: HashMap<String, HashMap<String, Option<String>>>,
    delivered: Option<(String, Option<String>)>,
    removed: Option<String>,
}

/// The right to deliver to a destination; it ends when this is dropped, or with the process.
#[derive(Debug)]
pub struct DeliveryTurn {
    _lock: Option<FileLock>,
}

/// The folder of the records of a telescope.
fn folder(config: &Observatory) -> PathBuf {
    config.folders.data.join(format!("delivery-{}", config.place.telescope))
}

/// Takes the destination for this process.
///
/// # Errors
/// Another process delivers to it, or the data folder cannot be written to.
pub fn take_turn(config: &Observatory, destination: &str) -> anyhow::Result<DeliveryTurn> {
    let folder = folder(config).join(destination);
    node::private::make_folder(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let path = folder.join("lock");
    let cannot = || format!("cannot open {}", path.display());
    let file = File::options().write(true).create(true).truncate(false).open(&path).with_context(cannot)?;
    match FileLock::of(file) {
        Ok(lock) => Ok(DeliveryTurn { _lock: Some(lock) }),
        Err(TryLockError::WouldBlock) => bail!(
            "another process delivers to {destination} at this moment, probably the archive node: wait until it is done"
        ),
        // A file system without locks: nothing is overwritten all the same.
        Err(TryLockError::Error(_)) => Ok(DeliveryTurn { _lock: None }),
    }
}

/// What a destination's files of this process are in; they are removed when another one has been killed.
pub fn work_folder(config: &Observatory, destination: &str) -> PathBuf {
    folder(config).join(destination)
}

/// Removes the copies that a kill left. Only in this destination's [`DeliveryTurn`]; what others read back at the moment stays.
pub fn clear_work(config: &Observatory, destination: &str) {
    const DAY: Duration = Duration::from_secs(86_400);
    for entry in fs::read_dir(work_folder(config, destination)).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_old = || {
            let age = entry.metadata().and_then(|found| found.modified()).ok().and_then(|at| at.elapsed().ok());
            age.is_some_and(|age| age > DAY)
        };
        let is_left = name.starts_with(SENT_FOLDER) || (name.starts_with(FETCHED_FOLDER) && is_old());
        if is_left && let Err(error) = fs::remove_dir_all(entry.path()) {
            tracing::warn!(folder = %entry.path().display(), %error, "copies of an earlier try cannot be removed");
        }
    }
}

/// Where a destination is, and by which profile, as one text: what was delivered to another place is not there.
pub fn place_of(delivery: &Delivery) -> String {
    let folder = delivery.directory.as_ref().map(|folder| folder.display().to_string());
    let bucket = delivery.bucket.as_ref();
    let endpoint = delivery.endpoint.as_deref().unwrap_or(&delivery.region);
    let bucket = bucket.map(|bucket| format!("{endpoint}/{bucket}/{}", delivery.prefix));
    let place = folder.or_else(|| delivery.rsync.clone()).or(bucket).unwrap_or_default();
    format!("{} {place}", delivery.profile)
}

/// The nights that were due once and are not delivered yet, whatever their age: a file for each, without content.
pub struct DueNights(PathBuf);

impl DueNights {
    /// Those of a destination.
    pub fn of(config: &Observatory, destination: &str) -> Self {
        Self(work_folder(config, destination).join("due"))
    }

    /// Their dates. Blocks.
    pub fn dates(&self) -> Vec<NightDate> {
        let entries = fs::read_dir(&self.0).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect()
    }

    /// Notes a night.
    pub fn add(&self, date: NightDate) -> anyhow::Result<()> {
        let file = self.0.join(date.to_string());
        let made =
            node::private::make_folder(&self.0).and_then(|()| File::options().create(true).append(true).open(&file));
        made.map(drop).with_context(|| format!("cannot write {}", file.display()))
    }

    /// A night is delivered, or has nothing for the destination any more.
    pub fn remove(&self, date: NightDate) -> anyhow::Result<()> {
        let file = self.0.join(date.to_string());
        match fs::remove_file(&file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", file.display()))
            }
            _ => Ok(()),
        }
    }
}

/// A set of frames as one text.
pub fn set_of<'a>(frames: impl Iterator<Item = &'a CommandId>) -> String {
    let mut ids: Vec<&str> = frames.map(|id| id.0.as_str()).collect();
    ids.sort_unstable();
    hex(&Sha256::digest(ids.join("\n")))
}

impl Record {
    /// Reads the record; an empty one where there is none. Lines that cannot be read are left out.
    pub fn read(config: &Observatory, destination: &str, night: &Night) -> anyhow::Result<Self> {
        let file = folder(config).join(destination).join(format!("{}.jsonl", night.date));
        let text = match fs::read(&file) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
        };
        let mut record = Self { file, sent: HashMap::new(), delivered: None, removed: None };
        for line in text.lines().filter_map(|line| serde_json::from_str(line).ok()) {
            record.take(line);
        }
        Ok(record)
    }

    fn take(&mut self, line: Line) {
        match line {
            Line::Sending { name, sha256, archive_sha256 } => {
                self.sent.entry(name).or_default().insert(sha256, archive_sha256);
            }
            Line::Delivered { set, place, .. } => self.delivered = Some((set, place)),
            Line::Removed { set } => self.removed = Some(set),
        }
    }

    /// Was this content sent under this name? Then the content of the archive's file of which it was made.
    pub fn sent(&self, name: &str, sha256: &str) -> Option<Option<&str>> {
        self.sent.get(name)?.get(sha256).map(Option::as_deref)
    }

    /// Are these frames delivered to this place, and no others? Lines of before name no place.
    pub fn is_delivered(&self, set: &str, place: &str) -> bool {
        let is_it = |(known, at): &(String, Option<String>)| known == set && at.as_deref().is_none_or(|at| at == place);
        self.delivered.as_ref().is_some_and(is_it)
    }

    /// Have the files of these frames left the folder of images?
    pub fn is_removed(&self, set: &str) -> bool {
        self.removed.as_deref() == Some(set)
    }

    /// Notes that files are about to be sent: name, content, and content of the archive's file.
    pub fn sending<'a>(&mut self, files: impl Iterator<Item = [&'a str; 3]>) -> anyhow::Result<()> {
        let is_new = |[name, sha256, archive]: &[&str; 3]| self.sent(name, sha256) != Some(Some(*archive));
        let line = |[name, sha256, archive]: [&str; 3]| Line::Sending {
            name: name.to_owned(),
            sha256: sha256.to_owned(),
            archive_sha256: Some(archive.to_owned()),
        };
        let lines = files.filter(is_new).map(line).collect();
        self.append(lines)
    }

    /// Notes that a set of frames is delivered.
    pub fn delivered(&mut self, manifest: &str, frames: usize, set: &str, place: &str) -> anyhow::Result<()> {
        if self.is_delivered(set, place) {
            return Ok(());
        }
        let (manifest, set, place) = (manifest.to_owned(), set.to_owned(), Some(place.to_owned()));
        self.append(vec![Line::Delivered { manifest, frames, set, place }])
    }

    /// Notes that the files of a set of frames have left the folder of images.
    pub fn removed(&mut self, set: &str) -> anyhow::Result<()> {
        self.append(vec![Line::Removed { set: set.to_owned() }])
    }

    fn append(&mut self, lines: Vec<Line>) -> anyhow::Result<()> {
        if lines.is_empty() {
            return Ok(());
        }
        // Begins with a new line: the last one may be half written.
        let mut text = String::from("\n");
        for line in &lines {
            text.push_str(&serde_json::to_string(line)?);
            text.push('\n');
        }
        write_durably(&self.file, &text)
            .with_context(|| format!("cannot write {}: nothing is delivered without it", self.file.display()))?;
        lines.into_iter().for_each(|line| self.take(line));
        Ok(())
    }
}

fn write_durably(path: &Path, text: &str) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        node::private::make_folder(folder)?;
    }
    let mut file = File::options().append(true).create(true).open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_sent_and_delivered_is_known_after_a_torn_last_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("d/20261121.jsonl");
        let mut record = Record { file, sent: HashMap::new(), delivered: None, removed: None };
        record.sending([["a.fits", "11", "10"]].into_iter()).unwrap();
        record.delivered("m.json", 1, "set", "/there").unwrap();
        let mut text = fs::read(&record.file).unwrap();
        text.extend(b"{\"sending\":{\"name\":\"b.fi");
        fs::write(&record.file, text).unwrap();
        record.sending([["c.fits", "33", "33"]].into_iter()).unwrap();
        let text = fs::read_to_string(&record.file).unwrap();
        let mut again = Record { file: record.file, sent: HashMap::new(), delivered: None, removed: None };
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).for_each(|line| again.take(line));
        assert_eq!((again.sent("a.fits", "11"), again.sent("c.fits", "33")), (Some(Some("10")), Some(Some("33"))));
        assert!(again.sent("a.fits", "22").is_none() && again.is_delivered("set", "/there"));
        assert!(!again.is_delivered("other", "/there") && !again.is_delivered("set", "/elsewhere"));
        // Lines of before have no content of the archive's file.
        again.take(serde_json::from_str(r#"{"sending":{"name":"d.fits","sha256":"44"}}"#).unwrap());
        assert_eq!(again.sent("d.fits", "44"), Some(None));
    }
}
