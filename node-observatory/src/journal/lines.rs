//! The lines of the journal's file.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use contract::CommandId;
use contract::observatory::RowStatus;
use schedule::RowId;
use serde::{Deserialize, Serialize};
use units::Utc;

/// One line of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub(super) enum JournalLine {
    /// A frame may have been started under this id.
    Intended { at_utc: Utc, row: RowId, frame: CommandId, sequence: u32 },
    /// A frame in addition to the row's own may have been started under this id, such as one that shows where the
    /// telescope looks; it never counts.
    Aside { at_utc: Utc, row: RowId, frame: CommandId, sequence: u32 },
    /// A frame was taken of another place than the row's target, so far from it; it does not count.
    Astray { at_utc: Utc, row: RowId, frame: CommandId, off_target_arcmin: f64 },
    /// The frame was exposed.
    Taken { at_utc: Utc, row: RowId, frame: CommandId },
    /// The dome hid so much of a frame's light; too much for it to count, or not.
    Hidden { at_utc: Utc, row: RowId, frame: CommandId, lost_percent: f64, counts: bool },
    /// A flat was judged by its level: does it count, and of which filter is it?
    Judged {
        at_utc: Utc,
        row: RowId,
        frame: CommandId,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        filter: Option<String>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        level_adu: Option<f64>,
        counts: bool,
    },
    /// A row ended.
    Ended { at_utc: Utc, row: RowId, status: RowStatus, detail: String },
    /// Somebody has a row run again: `anew`, so that no frame of before counts, or from where it stopped.
    Again { at_utc: Utc, row: RowId, anew: bool },
    /// Somebody turned the robotic switch.
    Robotic { at_utc: Utc, on: bool },
}

impl JournalLine {
    pub(super) fn at(&self) -> Utc {
        match self {
            Self::Intended { at_utc, .. }
            | Self::Aside { at_utc, .. }
            | Self::Astray { at_utc, .. }
            | Self::Taken { at_utc, .. }
            | Self::Hidden { at_utc, .. }
            | Self::Judged { at_utc, .. }
            | Self::Ended { at_utc, .. }
            | Self::Again { at_utc, .. }
            | Self::Robotic { at_utc, .. } => *at_utc,
        }
    }

    pub(super) fn is_switch(&self) -> bool {
        matches!(self, Self::Robotic { .. })
    }
}

/// A line is JSON, which has no NaN: what could not be computed is -1.
pub(super) fn known(value: f64) -> f64 {
    if value.is_finite() { value } else { -1.0 }
}

/// Puts a text at the end of the file, and waits for the disk.
pub(super) fn append(file: &mut File, text: &str) -> io::Result<()> {
    file.write_all(text.as_bytes())?;
    file.sync_data()
}

/// All lines that can be read, and what is wrong with others.
pub(super) fn read(path: &Path) -> io::Result<(Vec<JournalLine>, Option<String>)> {
    let text = match std::fs::read(path) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error),
    };
    let (mut lines, mut damage): (Vec<JournalLine>, Option<String>) = (Vec::new(), None);
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        match serde_json::from_str(line) {
            Ok(line) => lines.push(line),
            Err(error) => damage = damage.or_else(|| Some(format!("line {} cannot be read: {error}", number + 1))),
        }
    }
    Ok((lines, damage))
}

/// Writes a whole new file next to the old one and renames it into its place.
pub(super) fn rewrite(path: &Path, lines: &[JournalLine]) -> io::Result<()> {
    let mut new: PathBuf = path.to_owned();
    new.set_extension("jsonl.new");
    let mut file = File::create(&new)?;
    for line in lines {
        serde_json::to_writer(&mut file, line)?;
        file.write_all(b"\n")?;
    }
    file.sync_all()?;
    drop(file);
    std::fs::rename(&new, path)
}
