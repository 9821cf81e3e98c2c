//! A frame's row, and its file.

use std::fs::{File, Metadata};
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};
use std::time::{Instant, SystemTime};

use config::Observatory;
use contract::CommandId;
use contract::archived_frame::{ArchiveRefusal, FrameDetails, NotGiven};

use super::refused;
use crate::folder::without_links;
use crate::reader::Reader;

/// Where the frames of a telescope are.
#[derive(Debug, Clone)]
pub struct Shelf {
    database: PathBuf,
    images: PathBuf,
    telescope: String,
}

/// A file that was opened.
#[derive(Debug)]
pub struct OpenedFile {
    /// The open file.
    pub file: File,
    /// Where it is.
    pub path: PathBuf,
    /// Its name for people, relative to the folder of images.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Differs after any change.
    pub version: String,
}

impl Shelf {
    /// That of a node.
    pub fn of(config: &Observatory) -> Self {
        Self {
            database: config.archive.database.clone(),
            images: config.folders.images.clone(),
            telescope: config.place.telescope.to_string(),
        }
    }

    /// A reader that stops in time.
    pub fn reader(&self, deadline: Instant) -> Result<Reader, ArchiveRefusal> {
        Reader::open(&self.database, &self.telescope).and_then(|reader| reader.until(deadline)).map_err(failed)
    }

    /// What is known of a frame of this telescope.
    pub fn find(&self, frame: &CommandId, deadline: Instant) -> Result<FrameDetails, ArchiveRefusal> {
        let reader = self.reader(deadline)?;
        match reader.stored_frame(frame).map_err(failed)? {
            Some(found) => Ok(found),
            None if reader.is_cut() => {
                Err(refused(NotGiven::Busy, "the archive did not find it in time; ask again in some seconds"))
            }
            None => {
                let detail = format!("no frame {:?} of {} is stored", frame.0, self.telescope);
                Err(refused(NotGiven::Unknown, detail))
            }
        }
    }

    /// The file of a frame.
    pub fn open(&self, details: &FrameDetails) -> Result<OpenedFile, ArchiveRefusal> {
        let name = &details.frame.file;
        let relative = Path::new(name);
        let is_inside = relative.components().all(|part| matches!(part, Component::Normal(_)));
        if name.is_empty() || !is_inside {
            let detail = "the row of the frame names a file outside of the archive's folder of images; it is not given";
            return Err(refused(NotGiven::FileDamaged, detail));
        }
        let path = self.images.join(relative);
        let unreadable = |error: std::io::Error| match error.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => {
                let detail = format!(
                    "the file {name} is not in the archive's folder of images: it was delivered and removed, or its disk is away"
                );
                refused(NotGiven::FileAway, detail)
            }
            _ => refused(NotGiven::FileDamaged, format!("the file {name} cannot be read: {error}")),
        };
        without_links(&self.images, &path).map_err(|_| {
            refused(NotGiven::FileDamaged, format!("a part of {name} is a link, and links are not followed"))
        })?;
        let file = File::open(&path).map_err(unreadable)?;
        let metadata = file.metadata().map_err(unreadable)?;
        if !metadata.is_file() {
            return Err(refused(NotGiven::FileDamaged, format!("{name} is no file")));
        }
        let version = version(&metadata);
        Ok(OpenedFile { file, path, name: name.clone(), bytes: metadata.len(), version })
    }
}

/// Size and time of the last change: a header is completed in place.
pub fn version(metadata: &Metadata) -> String {
    let changed = metadata.modified().ok().and_then(|at| at.duration_since(SystemTime::UNIX_EPOCH).ok());
    format!("{:x}-{:x}", metadata.len(), changed.map_or(0, |at| at.as_nanos()))
}

/// The database failed.
pub fn failed(error: impl std::fmt::Display) -> ArchiveRefusal {
    tracing::warn!(%error, "a question about a frame has no answer");
    refused(NotGiven::Failed, "the archive cannot read its database; its log says why")
}
