//! The journal: what was begun and what was finished, on disk before it is done, so that a restart goes on from there.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use contract::CommandId;
use contract::observatory::RowStatus;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::schedule::RowId;

/// One line of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
enum Line {
    /// A frame may have been started under this id.
    Intended { at_utc: Utc, row: RowId, frame: CommandId, sequence: u32 },
    /// The frame was exposed.
    Taken { at_utc: Utc, row: RowId, frame: CommandId },
    /// A row ended.
    Ended { at_utc: Utc, row: RowId, status: RowStatus, detail: String },
    /// Somebody turned the robotic switch.
    Robotic { at_utc: Utc, on: bool },
}

impl Line {
    fn at(&self) -> Utc {
        match self {
            Self::Intended { at_utc, .. }
            | Self::Taken { at_utc, .. }
            | Self::Ended { at_utc, .. }
            | Self::Robotic { at_utc, .. } => *at_utc,
        }
    }
}

/// A frame that may be started now: its id is on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Intent {
    /// Id of the frame and of its `expose` command.
    pub frame: CommandId,
    /// Counts the frames of the row from 0.
    pub sequence: u32,
}

/// How far a row got.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress {
    /// Frames exposed.
    pub taken: u32,
    /// Frames that may have been started and are not known to be exposed.
    pub open: Vec<CommandId>,
    /// How it ended, and why.
    pub ended: Option<(RowStatus, String)>,
}

#[derive(Debug, Default)]
struct Record {
    intended: u32,
    open: Vec<CommandId>,
    taken: BTreeSet<String>,
    ended: Option<(RowStatus, String)>,
    /// Intended by this life and not sent.
    spare: Option<Intent>,
}

#[derive(Debug, Default)]
struct Book {
    rows: BTreeMap<RowId, Record>,
    row_of: HashMap<String, RowId>,
    robotic: Option<(Utc, bool)>,
}

/// The journal of one telescope. Nodes that stand by for one another may share its file: only the one that commands
/// writes it anew, and from then on what its predecessor still writes goes nowhere.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// Open for the one that commands.
    file: Mutex<Option<File>>,
    book: Mutex<Book>,
}

/// Lines older than this, against the newest, are dropped when a node takes over, sky s.
const KEPT_S: f64 = 3.0 * 86_400.0;

impl Journal {
    /// Reads a journal; half a line at its end is the mark of a crash.
    pub fn open(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let book = Book::of(&read(path)?);
        Ok(Self { path: path.to_owned(), file: Mutex::new(None), book: Mutex::new(book) })
    }

    /// Learns what another node wrote meanwhile, drops what is old, and makes the file this node's own.
    pub fn take_over(&self) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lines = read(&self.path)?;
        let newest = lines.iter().map(Line::at).max().unwrap_or(Utc::EPOCH);
        lines.retain(|line| newest.seconds_since(line.at()) <= KEPT_S);
        rewrite(&self.path, &lines)?;
        *file = Some(OpenOptions::new().append(true).open(&self.path)?);
        *self.book() = Book::of(&lines);
        Ok(())
    }

    /// How far a row got.
    pub fn progress(&self, row: &RowId) -> Progress {
        let book = self.book();
        let Some(record) = book.rows.get(row) else { return Progress::default() };
        Progress {
            taken: u32::try_from(record.taken.len()).unwrap_or(u32::MAX),
            open: record.open.clone(),
            ended: record.ended.clone(),
        }
    }

    /// Makes an id for the next frame of a row and returns when it is on disk.
    pub fn intend(&self, row: &RowId, at_utc: Utc) -> io::Result<Intent> {
        let sequence = {
            let mut book = self.book();
            let record = book.rows.entry(row.clone()).or_default();
            if let Some(spare) = &record.spare {
                return Ok(spare.clone());
            }
            record.intended
        };
        let intent = Intent { frame: CommandId::fresh(), sequence };
        self.write(Line::Intended { at_utc, row: row.clone(), frame: intent.frame.clone(), sequence })?;
        self.book().rows.entry(row.clone()).or_default().spare = Some(intent.clone());
        Ok(intent)
    }

    /// The intended frame is being sent; the next one needs a new id.
    pub fn sent(&self, row: &RowId) {
        if let Some(record) = self.book().rows.get_mut(row) {
            record.spare = None;
        }
    }

    /// A frame was exposed, whoever says so and however often; counted at once, written before this returns.
    /// Returns false for a frame that is not of this journal or was counted already.
    pub fn taken(&self, frame: &CommandId, at_utc: Utc) -> io::Result<bool> {
        let row = {
            let book = self.book();
            let Some(row) = book.row_of.get(&frame.0) else { return Ok(false) };
            if book.rows.get(row).is_some_and(|record| record.taken.contains(&frame.0)) {
                return Ok(false);
            }
            row.clone()
        };
        self.write(Line::Taken { at_utc, row, frame: frame.clone() })?;
        Ok(true)
    }

    /// A row ended.
    pub fn ended(&self, row: &RowId, status: RowStatus, detail: &str, at_utc: Utc) -> io::Result<()> {
        self.write(Line::Ended { at_utc, row: row.clone(), status, detail: detail.to_owned() })
    }

    /// Somebody turned the robotic switch.
    pub fn robotic(&self, on: bool, at_utc: Utc) -> io::Result<()> {
        self.write(Line::Robotic { at_utc, on })
    }

    /// The robotic switch as it was last turned, and when.
    pub fn last_robotic(&self) -> Option<(Utc, bool)> {
        self.book().robotic
    }

    fn book(&self) -> std::sync::MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Learns a line at once and puts it on disk; what was learnt stays true when the disk fails.
    fn write(&self, line: Line) -> io::Result<()> {
        self.book().learn(&line);
        let mut text = serde_json::to_string(&line)?;
        text.push('\n');
        match &mut *self.file.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(file) => append(file, &text),
            // after a new line: the last one may be half of what a crash left
            None => append(&mut OpenOptions::new().append(true).create(true).open(&self.path)?, &format!("\n{text}")),
        }
    }
}

fn append(file: &mut File, text: &str) -> io::Result<()> {
    file.write_all(text.as_bytes())?;
    file.sync_data()
}

/// All lines that can be read.
fn read(path: &Path) -> io::Result<Vec<Line>> {
    let text = match std::fs::read(path) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error),
    };
    let mut lines: Vec<Line> = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        match serde_json::from_str(line) {
            Ok(line) => lines.push(line),
            Err(error) => tracing::warn!(line = number + 1, %error, "the journal has a line that cannot be read"),
        }
    }
    Ok(lines)
}

impl Book {
    fn of(lines: &[Line]) -> Self {
        let mut book = Self::default();
        lines.iter().for_each(|line| book.learn(line));
        book
    }

    fn learn(&mut self, line: &Line) {
        match line {
            Line::Intended { row, frame, sequence, .. } => {
                self.row_of.insert(frame.0.clone(), row.clone());
                let record = self.rows.entry(row.clone()).or_default();
                record.intended = record.intended.max(sequence + 1);
                record.open.push(frame.clone());
            }
            Line::Taken { row, frame, .. } => {
                let record = self.rows.entry(row.clone()).or_default();
                record.open.retain(|open| open != frame);
                record.taken.insert(frame.0.clone());
            }
            Line::Ended { row, status, detail, .. } => {
                self.rows.entry(row.clone()).or_default().ended = Some((*status, detail.clone()));
            }
            Line::Robotic { at_utc, on } => self.robotic = Some((*at_utc, *on)),
        }
    }
}

/// Writes a whole new file beside the old one and puts it in its place.
fn rewrite(path: &Path, lines: &[Line]) -> io::Result<()> {
    let mut beside: PathBuf = path.to_owned();
    beside.set_extension("jsonl.new");
    let mut file = File::create(&beside)?;
    for line in lines {
        serde_json::to_writer(&mut file, line)?;
        file.write_all(b"\n")?;
    }
    file.sync_all()?;
    drop(file);
    std::fs::rename(&beside, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Utc {
        text.parse().unwrap()
    }

    /// The journal of a node that commands.
    fn own(path: &Path) -> Journal {
        let journal = Journal::open(path).unwrap();
        journal.take_over().unwrap();
        journal
    }

    const NOW: &str = "2026-11-21T03:00:00Z";

    #[test]
    fn a_restart_goes_on_counting_where_the_crash_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data").join("journal-callisto.jsonl");
        let row = RowId("a".to_owned());
        let (first, second) = {
            let journal = own(&path);
            let first = journal.intend(&row, at(NOW)).unwrap();
            journal.sent(&row);
            assert!(journal.taken(&first.frame, at(NOW)).unwrap());
            assert!(!journal.taken(&first.frame, at(NOW)).unwrap(), "told twice, counted once");
            let second = journal.intend(&row, at(NOW)).unwrap();
            journal.sent(&row);
            (first, second)
        };
        assert_eq!((first.sequence, second.sequence), (0, 1));
        // the crash left half a line
        OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{\"is\":\"tak").unwrap();

        let journal = own(&path);
        assert_eq!(journal.progress(&row), Progress { taken: 1, open: vec![second.frame.clone()], ended: None });
        // the announcement of the frame that was under way arrives after the restart
        assert!(journal.taken(&second.frame, at(NOW)).unwrap());
        assert_eq!(journal.progress(&row).taken, 2);
        assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, 2);
        journal.ended(&row, RowStatus::Finished, "", at(NOW)).unwrap();
        drop(journal);

        let journal = own(&path);
        assert_eq!(journal.progress(&row).ended, Some((RowStatus::Finished, String::new())));
    }

    #[test]
    fn an_intent_that_was_not_sent_is_used_again() {
        let folder = tempfile::tempdir().unwrap();
        let journal = own(&folder.path().join("j.jsonl"));
        let row = RowId("a".to_owned());
        let first = journal.intend(&row, at(NOW)).unwrap();
        assert_eq!(journal.intend(&row, at(NOW)).unwrap(), first);
        journal.sent(&row);
        assert_eq!(journal.intend(&row, at(NOW)).unwrap().sequence, 1);
    }

    #[test]
    fn the_id_is_on_disk_before_it_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let journal = own(&path);
        let intent = journal.intend(&RowId("a".to_owned()), at(NOW)).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().contains(&intent.frame.0));
    }

    #[test]
    fn old_nights_are_dropped_and_strangers_are_not_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let (old, new) = (RowId("old".to_owned()), RowId("new".to_owned()));
        let journal = own(&path);
        journal.ended(&old, RowStatus::Finished, "", at("2026-11-01T03:00:00Z")).unwrap();
        journal.ended(&new, RowStatus::Failed, "why", at(NOW)).unwrap();
        journal.robotic(true, at(NOW)).unwrap();
        assert!(!journal.taken(&CommandId("of another program".to_owned()), at(NOW)).unwrap());
        drop(journal);
        let journal = own(&path);
        assert_eq!(journal.progress(&old).ended, None);
        assert_eq!(journal.progress(&new).ended, Some((RowStatus::Failed, "why".to_owned())));
        assert_eq!(journal.last_robotic(), Some((at(NOW), true)));
    }

    #[test]
    fn who_takes_over_knows_what_was_done_and_the_one_before_disturbs_it_no_more() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let row = RowId("a".to_owned());
        let (first, standby) = (own(&path), Journal::open(&path).unwrap());
        let frame = first.intend(&row, at(NOW)).unwrap().frame;
        first.sent(&row);
        first.taken(&frame, at(NOW)).unwrap();
        // an order that a standby heard while nobody commanded
        standby.robotic(false, at(NOW)).unwrap();
        standby.take_over().unwrap();
        assert_eq!((standby.progress(&row).taken, standby.last_robotic()), (1, Some((at(NOW), false))));
        // it was only stopped, and goes on
        first.ended(&row, RowStatus::Finished, "", at(NOW)).unwrap();
        assert_eq!(standby.intend(&row, at(NOW)).unwrap().sequence, 1);
        drop((first, standby));
        let next = own(&path);
        assert_eq!((next.progress(&row).taken, next.progress(&row).ended), (1, None));
    }
}
