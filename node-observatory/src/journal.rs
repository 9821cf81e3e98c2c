//! The journal: what was begun and what was finished, on disk before it is done, so that a restart goes on from there.

mod lines;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use contract::CommandId;
use contract::observatory::RowStatus;
use schedule::RowId;
use units::Utc;

use self::lines::{JournalLine, append, known, read, rewrite};
use crate::persisted::named;

/// A line that counts already and is not on disk yet.
#[derive(Debug)]
#[must_use = "it is not on disk until it arrives"]
pub struct Sent(JournalLine);

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

/// What is known of a row's flats.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Flats {
    /// Frames that count, by filter; without a name: of the one in the beam.
    pub good: BTreeMap<String, u32>,
    /// Frames that were exposed, and whose level nobody has judged.
    pub unjudged: Vec<CommandId>,
}

#[derive(Debug, Default)]
struct Record {
    intended: u32,
    open: Vec<CommandId>,
    taken: BTreeSet<String>,
    /// Exposed, and not worth counting.
    spoilt: BTreeSet<String>,
    /// Flats that were judged good, with their filter.
    judged: BTreeMap<String, Option<String>>,
    ended: Option<(RowStatus, String)>,
    /// Intended by this incarnation and not sent.
    spare: Option<Intent>,
}

#[derive(Debug, Default)]
struct Records {
    rows: BTreeMap<RowId, Record>,
    row_of: HashMap<String, RowId>,
    robotic: Option<(Utc, bool)>,
    /// Known in memory, and perhaps not on disk yet: code that reads the disk meanwhile must not forget them.
    on_the_way: Vec<JournalLine>,
}

/// The journal of one telescope. Nodes that stand by for one another may share its file: only the one that commands
/// writes it anew, and from then on what its predecessor still writes goes nowhere. A line that supersedes another one
/// stands after it, so that a restart comes to the same end.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// Open for the one that commands. Locked before `records`.
    file: Mutex<Option<File>>,
    /// Held while the switch is being written.
    pen: Arc<tokio::sync::Mutex<()>>,
    /// The disk may have taken half of the newest line, which the next one must not go on.
    is_cut: AtomicBool,
    records: Mutex<Records>,
}

/// The file of a telescope's journal.
pub fn path(config: &config::Observatory) -> PathBuf {
    config.folders.data.join(format!("journal-{}.jsonl", config.place.telescope))
}

/// Lines older than this, against the newest, are dropped when a node takes over, sky s.
const STORED_S: f64 = 3.0 * 86_400.0;

impl Journal {
    /// Reads a journal; half a line at its end is the mark of a crash.
    pub fn open(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let records = Records::of(&read(path)?.0);
        let (file, pen, is_cut) = Default::default();
        Ok(Self { path: path.to_owned(), file, pen, is_cut, records: Mutex::new(records) })
    }

    /// Learns what another node wrote meanwhile, drops what is old, and makes the file this node's own.
    pub fn take_over(&self) -> io::Result<()> {
        self.read_anew(&mut self.file())
    }

    /// While the file is locked, no line reaches the disk; the memory has the waiting lines all the same.
    fn read_anew(&self, file: &mut Option<File>) -> io::Result<()> {
        let (mut lines, damage) = read(&self.path)?;
        if let Some(damage) = damage {
            // It is written anew without them.
            node::aside::keep_copy(
                &self.path,
                &damage,
                "What its other lines say holds; frames of a lost line may be taken again.",
            );
        }
        let newest = lines.iter().map(JournalLine::at).max().unwrap_or(Utc::EPOCH);
        lines.retain(|line| newest.seconds_since(line.at()) <= STORED_S);
        rewrite(&self.path, &lines)?;
        *file = Some(OpenOptions::new().append(true).open(&self.path)?);
        let mut records = self.records();
        let mut on_the_way = std::mem::take(&mut records.on_the_way);
        *records = Records::of(&lines);
        // Somebody turned the switch at the node that commanded since then, and that was the last word.
        let turned = records.robotic.map(|(at, _)| at);
        on_the_way.retain(|line| !line.is_switch() || turned.is_none_or(|turned| line.at() >= turned));
        on_the_way.iter().filter(|line| !lines.contains(line)).for_each(|line| records.learn(line));
        records.on_the_way = on_the_way;
        Ok(())
    }

    /// How far a row got.
    pub fn progress(&self, row: &RowId) -> Progress {
        let records = self.records();
        let Some(record) = records.rows.get(row) else { return Progress::default() };
        Progress {
            taken: u32::try_from(record.taken.len()).unwrap_or(u32::MAX),
            open: record.open.clone(),
            ended: record.ended.clone(),
        }
    }

    /// Makes an id for the next frame of a row and returns when it is on disk.
    pub fn intend(&self, row: &RowId, at_utc: Utc) -> io::Result<Intent> {
        let (intent, line) = {
            let mut records = self.records();
            let record = records.rows.entry(row.clone()).or_default();
            if let Some(spare) = &record.spare {
                return Ok(spare.clone());
            }
            let intent = Intent { frame: CommandId::fresh(), sequence: record.intended };
            let line = JournalLine::Intended {
                at_utc,
                row: row.clone(),
                frame: intent.frame.clone(),
                sequence: intent.sequence,
            };
            (intent, records.send(line))
        };
        self.arrive(line)?;
        self.records().rows.entry(row.clone()).or_default().spare = Some(intent.clone());
        Ok(intent)
    }

    /// Makes an id for a frame in addition to the row's own, which never counts, and returns when it is on disk.
    pub fn aside(&self, row: &RowId, at_utc: Utc) -> io::Result<Intent> {
        let sequence = self.records().rows.entry(row.clone()).or_default().intended;
        let intent = Intent { frame: CommandId::fresh(), sequence };
        self.write(JournalLine::Aside { at_utc, row: row.clone(), frame: intent.frame.clone(), sequence })?;
        Ok(intent)
    }

    /// A frame shows another place than the row's target: it does not count, whichever node reports that it was
    /// exposed.
    pub fn astray(&self, row: &RowId, frame: &CommandId, off_target_arcmin: f64, at_utc: Utc) -> io::Result<()> {
        let off_target_arcmin = known(off_target_arcmin);
        self.write(JournalLine::Astray { at_utc, row: row.clone(), frame: frame.clone(), off_target_arcmin })
    }

    /// The intended frame is being sent; the next one needs a new id.
    pub fn sent(&self, row: &RowId) {
        if let Some(record) = self.records().rows.get_mut(row) {
            record.spare = None;
        }
    }

    /// A frame was exposed, whichever node reports this and however often; counted at once, written before this
    /// returns. Returns false for a frame that is not of this journal, was counted already, or does not count.
    pub fn taken(&self, frame: &CommandId, at_utc: Utc) -> io::Result<bool> {
        let line = {
            // Looked up and counted in one step: two may report it at the same time.
            let mut records = self.records();
            let Some(row) = records.row_of.get(&frame.0).cloned() else { return Ok(false) };
            let known = |record: &Record| record.taken.contains(&frame.0) || record.spoilt.contains(&frame.0);
            if records.rows.get(&row).is_some_and(known) {
                return Ok(false);
            }
            records.send(JournalLine::Taken { at_utc, row, frame: frame.clone() })
        };
        self.arrive(line)?;
        Ok(true)
    }

    /// The dome hid so much of a frame's light, percent; one that does not count never will, whoever reports that it
    /// was exposed.
    pub fn hidden(
        &self,
        row: &RowId,
        frame: &CommandId,
        lost_percent: f64,
        counts: bool,
        at_utc: Utc,
    ) -> io::Result<()> {
        let lost_percent = known(lost_percent);
        self.write(JournalLine::Hidden { at_utc, row: row.clone(), frame: frame.clone(), lost_percent, counts })
    }

    /// A flat was judged: it counts of its filter, or never will.
    pub fn judged(
        &self,
        row: &RowId,
        frame: &CommandId,
        filter: Option<String>,
        level_adu: Option<f64>,
        counts: bool,
        at_utc: Utc,
    ) -> io::Result<()> {
        let level_adu = level_adu.map(known);
        self.write(JournalLine::Judged { at_utc, row: row.clone(), frame: frame.clone(), filter, level_adu, counts })
    }

    /// What is known of a row's flats.
    pub fn flats(&self, row: &RowId) -> Flats {
        let (records, mut flats) = (self.records(), Flats::default());
        let Some(record) = records.rows.get(row) else { return flats };
        for filter in record.judged.values() {
            *flats.good.entry(filter.clone().unwrap_or_default()).or_default() += 1;
        }
        let unjudged = record.taken.iter().filter(|frame| !record.judged.contains_key(*frame));
        flats.unjudged = unjudged.map(|frame| CommandId(frame.clone())).collect();
        flats
    }

    /// A row ended: that counts at once, and is on disk when [`Journal::arrive`] returns.
    pub fn end(&self, row: &RowId, status: RowStatus, detail: &str, at_utc: Utc) -> Sent {
        self.send(JournalLine::Ended { at_utc, row: row.clone(), status, detail: detail.to_owned() })
    }

    /// Somebody ends a row: that counts only once it is on disk.
    pub fn end_by_order(&self, row: &RowId, status: RowStatus, detail: &str, at_utc: Utc) -> io::Result<()> {
        self.learn_when_written(JournalLine::Ended { at_utc, row: row.clone(), status, detail: detail.to_owned() })
    }

    /// Somebody has a row run again, `anew` or from where it stopped: that counts only once it is on disk.
    pub fn again(&self, row: &RowId, anew: bool, at_utc: Utc) -> io::Result<()> {
        self.learn_when_written(JournalLine::Again { at_utc, row: row.clone(), anew })
    }

    /// The robotic switch was turned off: that counts at once whatever the disk does, and is on disk when
    /// [`Journal::write_switch`] has succeeded.
    pub fn robotic_off(&self, at_utc: Utc) {
        let Sent(_) = self.send(JournalLine::Robotic { at_utc, on: false });
    }

    /// Puts on disk that the robotic switch was turned off, unless it is there or was turned on since. Blocks.
    ///
    /// # Errors
    ///
    /// The disk does not take it; the error names the file.
    pub fn write_switch(&self) -> io::Result<()> {
        if !self.records().on_the_way.iter().any(JournalLine::is_switch) {
            return Ok(());
        }
        // Looked for again once the file is locked: it may have been turned on while another line was written.
        let mut file = self.file();
        self.write_waiting(&mut file, JournalLine::is_switch).map_err(|error| named(&self.path, &error))
    }

    /// Writes those of the waiting lines.
    fn write_waiting(&self, file: &mut Option<File>, of: impl Fn(&JournalLine) -> bool) -> io::Result<()> {
        let first = || self.records().on_the_way.iter().find(|line| of(line)).cloned();
        while let Some(line) = first() {
            self.put_down(file, &line)?;
            self.records().arrived(&line);
        }
        Ok(())
    }

    /// As [`Journal::write_switch`], on a thread that may wait for the disk. While it does, whoever comes waits without
    /// one.
    ///
    /// # Errors
    ///
    /// The disk does not take it; the error names the file.
    pub async fn write_switch_in_turn(self: &Arc<Self>) -> io::Result<()> {
        let (pen, journal) = (self.pen.clone().lock_owned().await, self.clone());
        let writing = tokio::task::spawn_blocking(move || {
            let _pen = pen;
            journal.write_switch()
        });
        writing.await.map_err(io::Error::other)?
    }

    /// The robotic switch is turned on: that counts only once it is on disk.
    pub fn robotic_on(&self, at_utc: Utc) -> io::Result<()> {
        self.learn_when_written(JournalLine::Robotic { at_utc, on: true })
    }

    /// Writes what counts already and waits for the disk, and then this line: the other way round, the next start would
    /// take this one for undone.
    fn learn_when_written(&self, line: JournalLine) -> io::Result<()> {
        let mut file = self.file();
        self.write_waiting(&mut file, |_| true)?;
        self.put_down(&mut file, &line)?;
        let mut records = self.records();
        records.learn(&line);
        if line.is_switch() {
            records.on_the_way.retain(|sent| !sent.is_switch());
        }
        Ok(())
    }

    /// The robotic switch as it was last turned, and when.
    pub fn last_robotic(&self) -> Option<(Utc, bool)> {
        self.records().robotic
    }

    /// The same by a file, which may be another process's.
    pub fn last_robotic_in(path: &Path) -> io::Result<Option<(Utc, bool)>> {
        Ok(Records::of(&read(path)?.0).robotic)
    }

    /// Is a write of the switch under way until it is dropped.
    #[cfg(test)]
    pub async fn hold_pen(&self) -> tokio::sync::OwnedMutexGuard<()> {
        self.pen.clone().lock_owned().await
    }

    /// While it is held, the disk takes no line.
    #[cfg(test)]
    pub fn hang(&self) -> MutexGuard<'_, Option<File>> {
        self.file()
    }

    fn file(&self) -> MutexGuard<'_, Option<File>> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn records(&self) -> MutexGuard<'_, Records> {
        self.records.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Applies a line in memory at once and writes it to disk; the memory stays true when the disk fails.
    fn write(&self, line: JournalLine) -> io::Result<()> {
        self.arrive(self.send(line))
    }

    fn send(&self, line: JournalLine) -> Sent {
        self.records().send(line)
    }

    /// Puts a line on disk that was sent there.
    pub fn arrive(&self, Sent(line): Sent) -> io::Result<()> {
        let mut file = self.file();
        if !self.records().on_the_way.contains(&line) {
            // It went before a line that was written meanwhile.
            return Ok(());
        }
        let there = self.put_down(&mut file, &line);
        self.records().arrived(&line);
        there
    }

    fn put_down(&self, file: &mut Option<File>, line: &JournalLine) -> io::Result<()> {
        // After a new line where the last one may be half of what a crash or a full disk left.
        let begin = if file.is_none() || self.is_cut.load(Ordering::SeqCst) { "\n" } else { "" };
        let text = format!("{begin}{}\n", serde_json::to_string(line)?);
        let there = match file {
            Some(file) => append(file, &text),
            None => append(&mut OpenOptions::new().append(true).create(true).open(&self.path)?, &text),
        };
        self.is_cut.store(there.is_err(), Ordering::SeqCst);
        there
    }
}

impl Records {
    fn of(lines: &[JournalLine]) -> Self {
        let mut records = Self::default();
        lines.iter().for_each(|line| records.learn(line));
        records
    }

    /// Learns a line that is going to disk.
    fn send(&mut self, line: JournalLine) -> Sent {
        self.learn(&line);
        self.on_the_way.push(line.clone());
        Sent(line)
    }

    /// A line waits for the disk no more.
    fn arrived(&mut self, line: &JournalLine) {
        if let Some(place) = self.on_the_way.iter().position(|sent| sent == line) {
            self.on_the_way.remove(place);
        }
    }

    fn learn(&mut self, line: &JournalLine) {
        match line {
            JournalLine::Intended { row, frame, sequence, .. } => {
                self.row_of.insert(frame.0.clone(), row.clone());
                let record = self.rows.entry(row.clone()).or_default();
                record.intended = record.intended.max(sequence + 1);
                record.open.push(frame.clone());
            }
            JournalLine::Aside { row, frame, sequence, .. } => {
                self.row_of.insert(frame.0.clone(), row.clone());
                let record = self.rows.entry(row.clone()).or_default();
                record.intended = record.intended.max(sequence + 1);
                record.spoilt.insert(frame.0.clone());
            }
            JournalLine::Taken { row, frame, .. } => {
                let record = self.rows.entry(row.clone()).or_default();
                record.open.retain(|open| open != frame);
                if !record.spoilt.contains(&frame.0) {
                    record.taken.insert(frame.0.clone());
                }
            }
            JournalLine::Hidden { counts: true, .. } => {}
            JournalLine::Hidden { row, frame, counts: false, .. }
            | JournalLine::Judged { row, frame, counts: false, .. }
            | JournalLine::Astray { row, frame, .. } => {
                let record = self.rows.entry(row.clone()).or_default();
                record.open.retain(|open| open != frame);
                record.taken.remove(&frame.0);
                record.spoilt.insert(frame.0.clone());
            }
            JournalLine::Judged { row, frame, filter, counts: true, .. } => {
                let record = self.rows.entry(row.clone()).or_default();
                record.open.retain(|open| open != frame);
                record.taken.insert(frame.0.clone());
                record.judged.insert(frame.0.clone(), filter.clone());
            }
            JournalLine::Ended { row, status, detail, .. } => {
                self.rows.entry(row.clone()).or_default().ended = Some((*status, detail.clone()));
            }
            JournalLine::Again { row, anew, .. } => {
                let record = self.rows.entry(row.clone()).or_default();
                record.ended = None;
                if *anew {
                    record.spoilt.append(&mut record.taken);
                    record.spoilt.extend(record.open.drain(..).map(|frame| frame.0));
                    record.judged.clear();
                }
            }
            JournalLine::Robotic { at_utc, on } => self.robotic = Some((*at_utc, *on)),
        }
    }
}

#[cfg(test)]
#[path = "journal_tests.rs"]
mod tests;
