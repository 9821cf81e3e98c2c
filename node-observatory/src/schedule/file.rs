//! The schedule file: read at start, when it changes, and when ordered; a bad one leaves the old rows standing.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bus::Node;
use contract::Name;
use contract::observatory::AlertKind;
use tokio::sync::watch;

use super::parse::parse;
use super::row::Row;

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

/// How often the file is looked at, machine time.
const LOOK: Duration = Duration::from_secs(2);

/// What tells that a file has changed.
type Mark = Option<(SystemTime, u64)>;

/// Reads the file now, at each change of its time or size, and whenever `ordered` counts on.
pub async fn keep_reading(
    node: Node,
    loaded: watch::Sender<Loaded>,
    mut ordered: watch::Receiver<u64>,
) -> anyhow::Result<()> {
    let path = node.config.schedule.file.clone();
    let cameras: Arc<Vec<Name>> =
        Arc::new(node.config.camera.iter().map(|camera| camera.common.name.clone()).collect());
    let mut read: Option<Mark> = None;
    loop {
        let mark = mark(&path).await;
        if read != Some(mark) {
            // a file that is being written is read again when it has come to rest
            take(&node, &loaded, read_rows(path.clone(), cameras.clone()).await);
            read = Some(mark);
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            changed = ordered.changed() => {
                changed?;
                read = None;
            }
        }
    }
}

async fn mark(path: &Path) -> Mark {
    let about = tokio::fs::metadata(path).await.ok()?;
    Some((about.modified().ok()?, about.len()))
}

async fn read_rows(path: PathBuf, cameras: Arc<Vec<Name>>) -> Result<Vec<Row>, String> {
    let shown = path.display().to_string();
    let read = tokio::task::spawn_blocking(move || {
        let text = std::fs::read_to_string(&path).map_err(|error| format!("cannot be read: {error}"))?;
        parse(&text, &cameras).map_err(|fault| fault.to_string())
    });
    let read = read.await.unwrap_or_else(|error| Err(error.to_string()));
    read.map_err(|why| format!("{shown}: {why}"))
}

fn take(node: &Node, loaded: &watch::Sender<Loaded>, read: Result<Vec<Row>, String>) {
    match read {
        Ok(rows) => {
            node.alerts.clear(AlertKind::ScheduleRefused, "");
            loaded.send_modify(|loaded| {
                loaded.revision += 1;
                tracing::info!(rows = rows.len(), revision = loaded.revision, "schedule read");
                loaded.rows = Arc::new(rows);
                loaded.refused = None;
            });
        }
        Err(why) => {
            node.alerts.raise(AlertKind::ScheduleRefused, "", &why);
            loaded.send_modify(|loaded| loaded.refused = Some(why));
        }
    }
}
