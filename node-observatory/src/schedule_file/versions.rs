//! Every schedule that was in force, with who brought it, when and why: `schedules/` in the data folder holds each text
//! as it was, and `index.jsonl` with one line per version.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use node::private::write_whole;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use units::Utc;

/// Older versions than so many are forgotten: some years of a schedule a night, or a few weeks of one that is changed
/// all the time.
pub const MOST_VERSIONS: usize = 1000;
/// And so are those beyond so many bytes of text, but for the newest.
const MOST_BYTES: u64 = 100_000_000;
/// No index is larger: a thousand lines, each with a reason of at most a thousand letters.
const MOST_INDEX_BYTES: u64 = 20_000_000;
/// A reason is cut after so many letters.
const MOST_REASON: usize = 1000;

/// The author of a schedule, and the reason for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Author {
    /// Such as `web/ana`; `file` for a person or program that wrote the file itself.
    pub name: String,
    /// In their words.
    pub reason: String,
}

/// One line of the index.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Version {
    /// Counts up from 1.
    pub version: u64,
    /// Sky time when it was taken.
    pub at_utc: Utc,
    /// The author.
    pub author: String,
    /// Why.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Rows.
    pub rows: usize,
    /// Length of the text.
    pub bytes: u64,
    /// Of the text, in hexadecimal digits.
    pub sha256: String,
}

/// The versions of one telescope. Cheap to clone; clones write one after another.
#[derive(Debug, Clone)]
pub struct Versions {
    folder: PathBuf,
    pen: Arc<Mutex<()>>,
}

impl Versions {
    /// Those of a configuration; nothing is read or made yet.
    pub fn of(config: &config::Observatory) -> Self {
        Self::within(&config.folders.data, config.place.telescope.as_str())
    }

    /// Those of a telescope in a data folder.
    pub fn within(data: &Path, telescope: &str) -> Self {
        Self { folder: data.join(format!("schedules-{telescope}")), pen: Arc::default() }
    }

    /// All that are kept, oldest first; none where there is no folder yet. A line that a crash left half is passed
    /// over.
    ///
    /// # Errors
    ///
    /// The index cannot be read, or is larger than any index.
    pub fn list(&self) -> io::Result<Vec<Version>> {
        Ok(self.read_index()?.0)
    }

    /// The versions, and what is wrong with other lines of the index.
    fn read_index(&self) -> io::Result<(Vec<Version>, Option<String>)> {
        let index = self.index();
        let length = match fs::metadata(&index) {
            Ok(about) => about.len(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok((Vec::new(), None)),
            Err(error) => return Err(error),
        };
        if length > MOST_INDEX_BYTES {
            return Err(io::Error::other(format!("{} has {length} bytes, which no index has", index.display())));
        }
        let text = String::from_utf8_lossy(&fs::read(&index)?).into_owned();
        let (mut versions, mut damage): (_, Option<String>) = (Vec::new(), None);
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            match serde_json::from_str(line) {
                Ok(version) => versions.push(version),
                Err(error) => damage = damage.or_else(|| Some(format!("line {} cannot be read: {error}", number + 1))),
            }
        }
        Ok((versions, damage))
    }

    /// The text of a version, as it was.
    ///
    /// # Errors
    ///
    /// There is no such version, or its text is not the one that was kept.
    pub fn text(&self, version: u64) -> io::Result<String> {
        let known = self.list()?.into_iter().rfind(|known| known.version == version);
        let Some(known) = known else {
            let (folder, kind) = (self.folder.display(), io::ErrorKind::NotFound);
            return Err(io::Error::new(kind, format!("{folder} has no version {version}")));
        };
        let path = self.path(version);
        let text = fs::read_to_string(&path)?;
        if sha256(&text) != known.sha256 {
            return Err(io::Error::other(format!("{} is not what was kept; its hash differs", path.display())));
        }
        Ok(text)
    }

    /// Keeps a text, unless it is the newest version already; returns the version's number, and whether it is new. The
    /// text is on disk before its line, so a line never lies. Blocks.
    ///
    /// # Errors
    ///
    /// The disk does not take it; what was kept before stays.
    pub fn keep(&self, text: &str, rows: usize, author: &Author, at_utc: Utc) -> io::Result<(u64, bool)> {
        let _pen = self.pen.lock().unwrap_or_else(PoisonError::into_inner);
        fs::create_dir_all(&self.folder)?;
        let (mut stored, damage) = self.read_index()?;
        let sha256 = sha256(text);
        if let Some(newest) = stored.last().filter(|newest| newest.sha256 == sha256) {
            return Ok((newest.version, false));
        }
        let mut version = stored.last().map_or(1, |newest| newest.version + 1);
        if let Some(damage) = &damage {
            // The text of a line that is lost keeps its number.
            version = version.max(self.newest_text() + 1);
            node::aside::keep_copy(&self.index(), damage, "The texts of its lost lines stay in the folder.");
        }
        let reason = author.reason.chars().take(MOST_REASON).collect();
        let bytes = text.len() as u64;
        write_whole(&self.path(version), text.as_bytes())?;
        stored.push(Version { version, at_utc, author: author.name.clone(), reason, rows, bytes, sha256 });
        let written = self.write_index(bounded(&stored));
        if written.is_err() {
            // Without its line it is no version.
            let _ = fs::remove_file(self.path(version));
        }
        written?;
        if damage.is_none() && !self.was_damaged() {
            self.sweep(bounded(&stored));
        }
        Ok((version, true))
    }

    /// The highest number of a text in the folder, whether the index names it or not; 0 where there is none.
    fn newest_text(&self) -> u64 {
        let numbers = fs::read_dir(&self.folder).into_iter().flatten().flatten().filter_map(|file| {
            let name = file.file_name().into_string().ok()?;
            name.strip_suffix(".jsonl")?.parse::<u64>().ok()
        });
        numbers.max().unwrap_or(0)
    }

    /// Has the index lost lines before? Then their texts are all that is left of them.
    fn was_damaged(&self) -> bool {
        let mut files = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        files.any(|file| file.file_name().to_string_lossy().starts_with("index.jsonl.bad-"))
    }

    /// Forgets the newest version, where it is this one: it did not come into force. Blocks.
    pub fn take_back(&self, version: u64) -> io::Result<()> {
        let _pen = self.pen.lock().unwrap_or_else(PoisonError::into_inner);
        let mut stored = self.list()?;
        if stored.pop_if(|newest| newest.version == version).is_some() {
            self.write_index(&stored)?;
            fs::remove_file(self.path(version))?;
        }
        Ok(())
    }

    fn write_index(&self, versions: &[Version]) -> io::Result<()> {
        let lines: Result<Vec<String>, _> = versions.iter().map(serde_json::to_string).collect();
        write_whole(&self.index(), (lines?.join("\n") + "\n").as_bytes())
    }

    /// Removes texts that the index does not name; what cannot be removed is tried again with the next version.
    fn sweep(&self, versions: &[Version]) {
        let named: BTreeSet<PathBuf> = versions.iter().map(|version| self.path(version.version)).collect();
        for file in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let path = file.path();
            let is_text = path.extension().is_some_and(|extension| extension == "jsonl") && path != self.index();
            if is_text && !named.contains(&path) {
                let _ = fs::remove_file(&path);
            }
        }
    }

    fn index(&self) -> PathBuf {
        self.folder.join("index.jsonl")
    }

    fn path(&self, version: u64) -> PathBuf {
        self.folder.join(format!("{version:06}.jsonl"))
    }
}

/// The newest versions that are few and small enough to be kept, and in any case the newest of all.
fn bounded(stored: &[Version]) -> &[Version] {
    let mut bytes = 0_u64;
    let fits = |version: &&Version| {
        bytes = bytes.saturating_add(version.bytes);
        bytes <= MOST_BYTES
    };
    let count = stored.iter().rev().take(MOST_VERSIONS).take_while(fits).count().max(1);
    stored.get(stored.len().saturating_sub(count)..).unwrap_or(stored)
}

/// Of a text, as lower-case hex.
pub(super) fn sha256(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
#[path = "versions_tests.rs"]
mod tests;
