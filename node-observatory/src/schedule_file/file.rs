//! The schedule file: read at start, when it changes, and when ordered; a bad one leaves the old rows standing.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use crate::schedule_file::versions::Author;
use contract::observatory::AlertKind;
use schedule::{Row, read_text, validate};
use tokio::sync::watch;

use super::findings::known;
use crate::control_room::ControlRoom;

/// The schedule as it was last read.
#[derive(Debug, Clone, Default)]
pub struct Loaded {
    /// Counts the versions that were taken.
    pub revision: u64,
    /// The rows of the newest version that was good.
    pub rows: Arc<Vec<Row>>,
    /// Why the newest version was not taken.
    pub refused: Option<String>,
}

/// How often the file is looked at, machine time: one question to the file system, and a change is active within 1 s
/// also on a machine that is busy.
const LOOK: Duration = Duration::from_millis(250);
/// A version that the disk does not take is tried again after this.
const AGAIN: Duration = Duration::from_secs(10);

/// The properties that show that a file has changed: any other time or size, also an older one.
type Mark = Option<(SystemTime, u64)>;

/// Reads the file now, at each change of its time or size, and whenever the room's `reload` counts on. While this node
/// commands, each good text is kept as a version.
pub async fn keep_reading(room: Arc<ControlRoom>, loaded: watch::Sender<Loaded>) -> anyhow::Result<()> {
    let (path, mut ordered) = (room.node.config.schedule.file.clone(), room.reload.subscribe());
    let mut read: Option<Mark> = None;
    let mut unkept: Option<(String, usize)> = None;
    let mut keep_after = tokio::time::Instant::now();
    loop {
        let mark = mark(&path).await;
        if read != Some(mark) {
            // A file that is being written is read again when it has come to rest.
            let text = read_file(path.clone(), room.clone()).await;
            unkept = take(&room, &loaded, text).or(unkept);
            read = Some(mark);
        }
        // A standby may share the folder: the commander keeps the versions.
        if unkept.is_some() && room.hold.borrow().token().is_some() && tokio::time::Instant::now() >= keep_after {
            unkept = keep_version(&room, unkept).await;
            if unkept.is_some() {
                keep_after = tokio::time::Instant::now() + AGAIN;
            }
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            changed = ordered.changed() => {
                changed?;
                (read, keep_after) = (None, tokio::time::Instant::now());
            }
        }
    }
}

/// The rows of a text, or all that is wrong with it. Blocks.
pub(super) fn rows_of(text: &str, room: &ControlRoom) -> Result<Vec<Row>, String> {
    validate::accept(text, &known(room)).map_err(|fault| fault.to_string())
}

async fn mark(path: &Path) -> Mark {
    let about = tokio::fs::metadata(path).await.ok()?;
    Some((about.modified().ok()?, about.len()))
}

async fn read_file(path: PathBuf, room: Arc<ControlRoom>) -> Result<(String, Vec<Row>), String> {
    let shown = path.display().to_string();
    let read = tokio::task::spawn_blocking(move || {
        let text = read_text(&path).map_err(|error| format!("cannot be read: {error}"))?;
        let rows = rows_of(&text, &room)?;
        Ok((text, rows))
    });
    let read = read.await.unwrap_or_else(|error| Err(error.to_string()));
    read.map_err(|why| format!("{shown}: {why}"))
}

/// Puts what was read in force, or reports why not; returns the text to store.
fn take(
    room: &ControlRoom,
    loaded: &watch::Sender<Loaded>,
    read: Result<(String, Vec<Row>), String>,
) -> Option<(String, usize)> {
    let alerts = &room.node.alerts;
    match read {
        Ok((text, rows)) => {
            alerts.clear(AlertKind::ScheduleRefused, "");
            let count = rows.len();
            loaded.send_modify(|loaded| {
                loaded.revision += 1;
                tracing::info!(rows = count, revision = loaded.revision, "schedule read");
                loaded.rows = Arc::new(rows);
                loaded.refused = None;
            });
            Some((text, count))
        }
        Err(why) => {
            alerts.raise(AlertKind::ScheduleRefused, "", &why);
            loaded.send_modify(|loaded| loaded.refused = Some(why));
            None
        }
    }
}

/// Keeps a text as a version, unless it is the newest already; returns it again where the disk fails.
async fn keep_version(room: &Arc<ControlRoom>, unkept: Option<(String, usize)>) -> Option<(String, usize)> {
    let (text, rows) = unkept?;
    let (versions, at) = (room.versions.clone(), room.node.bus.clock().utc());
    let keeping = tokio::task::spawn_blocking(move || {
        let author = Author { name: "file".to_owned(), reason: String::new() };
        let kept = versions.keep(&text, rows, &author, at);
        (kept, text)
    });
    let (kept, text) = keeping.await.ok()?;
    match kept {
        Ok(_) => {
            room.node.alerts.clear(AlertKind::ScheduleNotKept, "");
            None
        }
        Err(error) => {
            let cause = format!("the schedule in force cannot be kept as a version: {error}");
            room.node.alerts.raise(AlertKind::ScheduleNotKept, "", &cause);
            Some((text, rows))
        }
    }
}
