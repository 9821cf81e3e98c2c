//! The schedule file: read at start, when it changes, and when ordered; a bad one leaves the old rows standing.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, SystemTime};

use contract::observatory::AlertKind;
use schedule::validate::KnownFacts;
use schedule::{Row, read_text, validate};
use tokio::sync::watch;

use super::{ActiveText, ScheduleFile};
use crate::persisted::Unchanged;
use crate::schedule_file::versions::{Author, sha256};

/// The schedule as it was last read.
#[derive(Debug, Clone, Default)]
pub struct Loaded {
    /// Counts the versions that were taken.
    pub revision: u64,
    /// The rows of the newest version that was good.
    pub rows: Arc<Vec<Row>>,
    /// SHA-256 of its text, as lower-case hex; empty before the first.
    pub sha256: String,
    /// Why the newest version was not taken.
    pub refused: Option<String>,
}

/// What came of the newest reading of the file.
#[derive(Debug, Clone, Default)]
pub struct FileReading {
    /// Orders to read it that were given before.
    asked: u64,
    /// Why it was not taken.
    refused: Option<String>,
}

/// An order to read the file is answered within this: a disk may hang.
const READ_WITHIN: Duration = Duration::from_secs(2);
// Whoever gave it has the reason before it takes the silence for that of a node that is gone.
const _: () = assert!(READ_WITHIN.as_millis() < orders::ANSWER_WITHIN.as_millis());

/// How often the file is looked at, machine time: one question to the file system, and a change is active within 1 s
/// also on a machine that is busy.
const LOOK: Duration = Duration::from_millis(250);
/// A version that the disk does not take is tried again after this.
const AGAIN: Duration = Duration::from_secs(10);

/// The properties that show that a file has changed: any other time or size, also an older one.
type Mark = Option<(SystemTime, u64)>;

/// Reads the file now, at each change of its time or size, and whenever the file's `reload` counts on. While this node
/// commands, each good text is kept as a version.
pub async fn keep_reading(file: Arc<ScheduleFile>, loaded: watch::Sender<Loaded>) -> anyhow::Result<()> {
    let (path, mut ordered) = (file.authority.node.config.schedule.file.clone(), file.reload.subscribe());
    let mut read: Option<(Mark, u64)> = None;
    let mut unkept: Option<(String, usize)> = None;
    let (mut is_missing, mut is_missed) = (false, None);
    let mut keep_after = tokio::time::Instant::now();
    loop {
        let (mark, asked) = (mark(&path).await, *ordered.borrow_and_update());
        if read != Some((mark, asked)) {
            // A file that is being written is read again when it has come to rest.
            let text = read_file(path.clone(), file.clone()).await;
            let taken = take(&file, &loaded, text);
            (is_missing, is_missed) = (matches!(taken, FileOutcome::Nothing), None);
            let refused = match taken {
                FileOutcome::Rows(text, rows) => {
                    unkept = Some((text, rows));
                    None
                }
                FileOutcome::Nothing => Some(missing(&path)),
                FileOutcome::Refused(why) => Some(why),
            };
            if read.is_none_or(|(_, before)| before != asked) {
                keep_after = tokio::time::Instant::now();
            }
            read = Some((mark, asked));
            file.read.send_replace(FileReading { asked, refused });
        }
        if is_missing {
            is_missed = Some(note_missing(&file, &path, is_missed));
        }
        // A standby may share the folder: the commander keeps the versions.
        if unkept.is_some()
            && file.authority.hold.borrow().token().is_some()
            && tokio::time::Instant::now() >= keep_after
        {
            unkept = keep_version(&file, unkept).await;
            if unkept.is_some() {
                keep_after = tokio::time::Instant::now() + AGAIN;
            }
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            changed = ordered.changed() => changed?,
        }
    }
}

/// Has the file read again.
///
/// # Errors
///
/// It is not taken, and why: what was read before it stays in force.
pub async fn reload(file: &ScheduleFile) -> Result<(), Unchanged> {
    let (mut read, mut asked) = (file.read.subscribe(), 0);
    file.reload.send_modify(|count| {
        *count += 1;
        asked = *count;
    });
    let reading = tokio::time::timeout(READ_WITHIN, read.wait_for(|reading| reading.asked >= asked)).await;
    match reading.map(|reading| reading.map(|reading| reading.refused.clone())) {
        Ok(Ok(None)) => Ok(()),
        Ok(Ok(Some(why))) => Err(Unchanged::Refused(why)),
        Ok(Err(_)) | Err(_) => {
            let path = file.authority.node.config.schedule.file.display();
            let within_s = READ_WITHIN.as_secs();
            Err(Unchanged::Refused(format!(
                "{path}: not read within {within_s} s; it is read when its disk answers, which is to be looked at"
            )))
        }
    }
}

/// For people: there is no schedule, and none was read before.
fn missing(path: &Path) -> String {
    format!("{}: there is no such file; write the schedule there, or put one by order", path.display())
}

/// While there is no schedule and the robotic switch is on, that is an alert: nothing is observed. `before` is what this
/// returned last.
fn note_missing(file: &ScheduleFile, path: &Path, before: Option<bool>) -> bool {
    let is_missed = *file.authority.robotic.borrow() && file.authority.is_publishing();
    let alerts = &file.authority.node.alerts;
    match is_missed {
        _ if before == Some(is_missed) => {}
        true => {
            let cause = format!("{}. The robotic switch is on, and nothing is observed", missing(path));
            alerts.raise(AlertKind::ScheduleRefused, "", &cause);
        }
        false => alerts.clear(AlertKind::ScheduleRefused, ""),
    }
    is_missed
}

/// The rows of a text, or all that is wrong with it. Blocks.
pub(super) fn rows_of(text: &str, file: &ScheduleFile) -> Result<Vec<Row>, String> {
    validate::accept(text, &known(file)).map_err(|fault| fault.to_string())
}

async fn mark(path: &Path) -> Mark {
    let about = tokio::fs::metadata(path).await.ok()?;
    Some((about.modified().ok()?, about.len()))
}

/// A text with its rows; nothing where there is no file.
type ReadFile = Option<(String, Vec<Row>)>;

async fn read_file(path: PathBuf, file: Arc<ScheduleFile>) -> Result<ReadFile, String> {
    let name = path.display().to_string();
    let read = tokio::task::spawn_blocking(move || {
        // An order that replaces the file waits, so that what is remembered is what was read last.
        let mut active = file.active.lock().unwrap_or_else(PoisonError::into_inner);
        let text = match read_text(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            read => read.map_err(|error| format!("cannot be read: {error}"))?,
        };
        let rows = rows_of(&text, &file)?;
        *active = Some(ActiveText { text: text.as_str().into(), sha256: sha256(&text) });
        Ok(Some((text, rows)))
    });
    let read = read.await.unwrap_or_else(|error| Err(error.to_string()));
    read.map_err(|why| format!("{name}: {why}"))
}

/// What came of what was read.
enum FileOutcome {
    /// It is in force: the text, and its number of rows.
    Rows(String, usize),
    /// There is no file, and no rows of an earlier one.
    Nothing,
    /// It is not in force, and why.
    Refused(String),
}

/// Puts what was read in force, or reports why not.
fn take(file: &ScheduleFile, loaded: &watch::Sender<Loaded>, read: Result<ReadFile, String>) -> FileOutcome {
    let alerts = &file.authority.node.alerts;
    let path = file.authority.node.config.schedule.file.display();
    let why = match read {
        Ok(Some((text, rows))) => {
            alerts.clear(AlertKind::ScheduleRefused, "");
            let (count, sha256) = (rows.len(), sha256(&text));
            loaded.send_modify(|loaded| {
                loaded.revision += 1;
                tracing::info!(rows = count, revision = loaded.revision, "schedule read");
                loaded.rows = Arc::new(rows);
                loaded.sha256 = sha256;
                loaded.refused = None;
            });
            return FileOutcome::Rows(text, count);
        }
        // It is written later, or put by an order.
        Ok(None) if loaded.borrow().rows.is_empty() => {
            tracing::info!(file = %path, "there is no schedule yet");
            loaded.send_modify(|loaded| loaded.refused = None);
            return FileOutcome::Nothing;
        }
        Ok(None) => format!("{path}: cannot be read: the file is gone; the rows that were read last stay in force"),
        Err(why) => why,
    };
    alerts.raise(AlertKind::ScheduleRefused, "", &why);
    loaded.send_modify(|loaded| loaded.refused = Some(why.clone()));
    FileOutcome::Refused(why)
}

/// Keeps a text as a version, unless it is the newest already or another is active by now; returns it again where the disk
/// fails.
async fn keep_version(file: &Arc<ScheduleFile>, unkept: Option<(String, usize)>) -> Option<(String, usize)> {
    let (text, rows) = unkept?;
    let at = file.clone();
    let keeping = tokio::task::spawn_blocking(move || {
        // An order that replaced it meanwhile has kept it.
        let active = at.active.lock().unwrap_or_else(PoisonError::into_inner);
        let is_active = active.as_ref().is_some_and(|active| *active.text == *text);
        let stored = if is_active { keep_as_written(&at, &text, rows) } else { Ok(()) };
        (stored, text)
    });
    let (stored, text) = keeping.await.ok()?;
    match stored {
        Ok(()) => {
            file.authority.node.alerts.clear(AlertKind::ScheduleNotSaved, "");
            None
        }
        Err(error) => {
            let cause = format!("the schedule in force cannot be kept as a version: {error}");
            file.authority.node.alerts.raise(AlertKind::ScheduleNotSaved, "", &cause);
            Some((text, rows))
        }
    }
}

/// Keeps a text that somebody wrote into the file. Blocks.
pub(super) fn keep_as_written(file: &ScheduleFile, text: &str, rows: usize) -> io::Result<()> {
    let author = Author { name: "file".to_owned(), reason: String::new() };
    file.versions.keep(text, rows, &author, file.authority.node.bus.clock().utc()).map(drop)
}

/// What is known now: the configuration with its horizon files, and the filters that the wheels report. Reads files.
pub fn known(file: &ScheduleFile) -> KnownFacts {
    let mut known = KnownFacts::with_names(file.authority.node.config.clone(), file.names.borrow().clone());
    for wheel in &file.devices.wheels {
        if let Some(can) = wheel.instrument.can() {
            known = known.with_filters(&wheel.instrument.device.name, can.names);
        }
    }
    known
}
