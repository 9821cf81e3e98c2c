//! The archive's SQLite file: one thread writes, in batches, and reports each row that it loses.

mod backup;
mod damage;
#[cfg(test)]
mod described;
mod guiding;
mod happenings;
mod make;
mod migrations;
mod owner;
mod rows;
mod stamp;
mod streams;
mod telemetry;
mod views;
mod whole_file;
mod write;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use contract::observatory::AlertKind;
use node::NodeAlerts;
use rusqlite::{Connection, OpenFlags};
use tokio::sync::{Notify, mpsc, oneshot};

pub(crate) use backup::restore;
pub use backup::{backup, copy_now};
pub(crate) use guiding::holding;
pub(crate) use make::make;
pub use stamp::stamp;
use streams::Streams;
use telemetry::Telemetry;
pub(crate) use telemetry::{MINUTE_US, scalar};
pub use write::{
    StarFlux, StoredAlerts, StoredCorrection, StoredFacts, StoredFluxes, StoredImage, StoredRecord, StoredRow,
    StoredRun, StoredState, Write,
};

/// Rows of one commit, at most.
const BATCH: usize = 5000;
/// The longest that a row waits for others to be committed with it; a kill loses none of them, for the archive asks for
/// the last ten minutes after a restart.
const TIMEOUT: Duration = Duration::from_millis(250);
/// Rows that wait for the writer; beyond that, the tasks that bring them wait too.
const WAITING: usize = 10_000;
/// A writer that cannot commit tries again after so long, and when the node ends for so many times.
const RETRY: Duration = Duration::from_secs(1);
const LAST_TRIES: u32 = 5;

/// The database could not be opened or asked.
#[derive(Debug, thiserror::Error)]
pub enum DatabaseError {
    /// SQLite.
    #[error("cannot {what} the database {}: {source}", file.display())]
    Sqlite {
        /// The operation that failed.
        what: &'static str,
        /// With which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: rusqlite::Error,
    },
    /// The folder or the thread could not be made.
    #[error("cannot prepare the database {}: {source}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A newer Starmesh wrote it.
    #[error(
        "the database {} has version {found}, of a newer Starmesh; this one knows up to {}. Install that Starmesh again, \
         or name another file in [archive] database", file.display(), migrations::VERSION
    )]
    Newer {
        /// Which file.
        file: PathBuf,
        /// Its version.
        found: i64,
    },
    /// The tables could not be brought up to date.
    #[error("cannot bring the tables of {} up to date: {why}", file.display())]
    Migration {
        /// Which file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// The writer ended and takes nothing more.
    #[error("the database's writer has ended")]
    Ended,
}

/// Opens a database that exists to read from it; it waits while another one changes what is read.
pub(crate) fn read_only(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(Duration::from_secs(5))?;
    Ok(connection)
}

struct Job {
    write: Write,
    done: Option<oneshot::Sender<()>>,
}

/// The database to which rows are written. Cheap to clone; the writer ends when all clones are gone.
#[derive(Clone)]
pub struct Database {
    jobs: mpsc::Sender<Job>,
    path: Arc<PathBuf>,
    rows: Arc<AtomicU64>,
    renewal: Arc<Notify>,
}

/// The writer's thread.
pub struct Writer(std::thread::JoinHandle<()>);

impl Writer {
    /// Waits until all is written, once every [`Database`] is gone.
    pub async fn end(self) {
        let waited = tokio::task::spawn_blocking(move || self.0.join()).await;
        if !matches!(waited, Ok(Ok(()))) {
            tracing::error!("the database's writer ended badly");
        }
    }
}

impl Database {
    /// Opens the file, makes its tables where they are missing, and starts the writer for the rows of a telescope.
    pub fn open(path: &Path, telescope: &str, alerts: NodeAlerts) -> Result<(Self, Writer), DatabaseError> {
        let io = |source| DatabaseError::Io { file: path.to_owned(), source };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        let (connection, damage) = damage::open(path)?;
        if let Some(damage) = &damage {
            alerts.raise(AlertKind::ArchiveDatabase, "", damage);
        }
        let (jobs, taken) = mpsc::channel(WAITING);
        let rows = Arc::new(AtomicU64::new(0));
        let (counted, runtime, file) = (rows.clone(), tokio::runtime::Handle::current(), path.to_owned());
        let renewal = Arc::new(Notify::new());
        let (renewed, telescope) = (renewal.clone(), telescope.to_owned());
        let thread = std::thread::Builder::new()
            .name("database".to_owned())
            .spawn(move || write_all(connection, (&file, &telescope), taken, &runtime, &alerts, (&counted, &renewed)))
            .map_err(io)?;
        Ok((Self { jobs, path: Arc::new(path.to_owned()), rows, renewal }, Writer(thread)))
    }

    /// Hands something over to be written soon; waits while the writer is far behind.
    pub async fn put(&self, write: Write) -> Result<(), DatabaseError> {
        self.jobs.send(Job { write, done: None }).await.map_err(|_| DatabaseError::Ended)
    }

    /// Writes these and waits until they are committed.
    pub async fn commit(&self, writes: Vec<Write>) -> Result<(), DatabaseError> {
        let mut waiting = Vec::new();
        for write in writes {
            let (done, committed) = oneshot::channel();
            self.jobs.send(Job { write, done: Some(done) }).await.map_err(|_| DatabaseError::Ended)?;
            waiting.push(committed);
        }
        for committed in waiting {
            committed.await.map_err(|_| DatabaseError::Ended)?;
        }
        Ok(())
    }

    /// Rows that were new, since the start.
    pub fn rows(&self) -> u64 {
        self.rows.load(Ordering::Relaxed)
    }

    /// Returns when a damaged file was put aside and a new one has begun; one call waits for that.
    pub async fn renewed(&self) {
        self.renewal.notified().await;
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The writer's loop: gathers a batch, commits it, wakes the callers that wait; a batch that fails stays until it
/// succeeds.
fn write_all(
    mut connection: Connection,
    (path, telescope): (&Path, &str),
    mut taken: mpsc::Receiver<Job>,
    runtime: &tokio::runtime::Handle,
    alerts: &NodeAlerts,
    (rows, renewal): (&AtomicU64, &Notify),
) {
    let mut memory = Memory { telemetry: Telemetry::default(), streams: Streams::of(telescope) };
    while let Some(batch) = gather(&mut taken, runtime) {
        let (mut last_tries, mut is_renewed) = (LAST_TRIES, false);
        loop {
            match write_batch(&mut connection, telescope, &mut memory, &batch) {
                Ok(count) => {
                    memory.streams.end(true);
                    rows.fetch_add(count, Ordering::Relaxed);
                    alerts.clear(AlertKind::ArchiveDatabase, "");
                    break;
                }
                Err(error) => {
                    // Nothing of the batch was written: numbers of series that were made in it do not exist.
                    memory.telemetry = Telemetry::default();
                    memory.streams.end(false);
                    // Once for a batch: a disk that damages what it just took is no reason for a third file.
                    let may_renew = damage::is_damage(&error) && !std::mem::replace(&mut is_renewed, true);
                    let renewed = may_renew.then(|| damage::renew(&mut connection, path, &error));
                    let cause = match renewed {
                        Some(Ok(text)) => {
                            alerts.raise(AlertKind::ArchiveDatabase, "", &text);
                            renewal.notify_one();
                            continue;
                        }
                        Some(Err(again)) => format!("the archive's database is damaged ({error}), and {again}"),
                        None => format!("the archive's database does not take rows: {error}"),
                    };
                    alerts.raise(AlertKind::ArchiveDatabase, "", &cause);
                    if taken.is_closed() {
                        last_tries -= 1;
                    }
                    if last_tries == 0 {
                        tracing::error!(rows = batch.len(), %error, "rows are lost");
                        return;
                    }
                    std::thread::sleep(RETRY);
                }
            }
        }
        for done in batch.into_iter().filter_map(|job| job.done) {
            // Nobody waits any more when the caller was stopped.
            let _ = done.send(());
        }
    }
}

/// The next batch: at once when a caller waits for it, else all rows that come within [`TIMEOUT`]. `None` at the end.
fn gather(taken: &mut mpsc::Receiver<Job>, runtime: &tokio::runtime::Handle) -> Option<Vec<Job>> {
    let first = taken.blocking_recv()?;
    let mut is_awaited = first.done.is_some();
    let mut batch = vec![first];
    runtime.block_on(async {
        let deadline = tokio::time::Instant::now() + TIMEOUT;
        while batch.len() < BATCH {
            let next = match taken.try_recv() {
                Ok(job) => Some(job),
                Err(_) if is_awaited => None,
                Err(_) => tokio::time::timeout_at(deadline, taken.recv()).await.ok().flatten(),
            };
            let Some(job) = next else { break };
            is_awaited |= job.done.is_some();
            batch.push(job);
        }
    });
    Some(batch)
}

/// What the writer knows of the file.
struct Memory {
    telemetry: Telemetry,
    streams: Streams,
}

fn write_batch(
    connection: &mut Connection,
    telescope: &str,
    memory: &mut Memory,
    batch: &[Job],
) -> rusqlite::Result<u64> {
    let transaction = connection.transaction()?;
    let mut count = 0;
    for job in batch {
        count += rows::write(&transaction, telescope, memory, &job.write)? as u64;
    }
    memory.telemetry.write_minutes(&transaction)?;
    memory.streams.write(&transaction)?;
    transaction.commit()?;
    Ok(count)
}

#[cfg(test)]
mod tests;
