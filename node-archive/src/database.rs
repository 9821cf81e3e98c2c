//! The archive's SQLite file: one thread writes, in batches, and reports each row that it loses.

mod damage;
mod guiding;
mod rows;
mod write;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bus::AlertBoard;
use contract::observatory::AlertKind;
use rusqlite::Connection;
use tokio::sync::{Notify, mpsc, oneshot};

pub use rows::stamp;
pub use write::{StoredCorrection, StoredFacts, StoredImage, StoredRecord, StoredRun, Write};

/// Rows of one commit, at most.
const BATCH: usize = 200;
/// The longest that a row waits for others to be committed with it; a kill loses none of them, for the archive asks for
/// the last ten minutes after a restart.
const PATIENCE: Duration = Duration::from_secs(1);
/// Rows that wait for the writer; beyond that, the tasks that bring them wait too.
const WAITING: usize = 10_000;
/// A writer that cannot commit tries again after so long, and when the node ends for so many times.
const RETRY: Duration = Duration::from_secs(1);
const LAST_TRIES: u32 = 5;
/// Version of the tables; older files are brought up to it, newer ones are refused.
const VERSION: i64 = 4;

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
    #[error("the database {} has version {found}; this Starmesh knows up to {VERSION}", file.display())]
    Newer {
        /// Which file.
        file: PathBuf,
        /// Its version.
        found: i64,
    },
    /// The writer ended and takes nothing more.
    #[error("the database's writer has ended")]
    Ended,
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
    /// Opens the file, makes its tables where they are missing, and starts the writer.
    pub fn open(path: &Path, alerts: AlertBoard) -> Result<(Self, Writer), DatabaseError> {
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
        let told = renewal.clone();
        let thread = std::thread::Builder::new()
            .name("database".to_owned())
            .spawn(move || write_all(connection, &file, taken, &runtime, &alerts, (&counted, &told)))
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

fn prepare(path: &Path) -> Result<Connection, DatabaseError> {
    let failed = |what| move |source| DatabaseError::Sqlite { what, file: path.to_owned(), source };
    let mut connection = Connection::open(path).map_err(failed("open"))?;
    let settings = "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA busy_timeout = 5000;
        PRAGMA wal_autocheckpoint = 4000;";
    connection.execute_batch(settings).map_err(failed("set up"))?;
    let found: i64 =
        connection.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(failed("read the version of"))?;
    if found > VERSION {
        return Err(DatabaseError::Newer { file: path.to_owned(), found });
    }
    if found < VERSION {
        let make = |connection: &mut Connection| {
            let transaction = connection.transaction()?;
            if found < 1 {
                transaction.execute_batch(rows::SCHEMA)?;
            }
            if found < 2 {
                transaction.execute_batch(rows::AUDIT)?;
            }
            if found < 3 {
                transaction.execute_batch(rows::FACTS)?;
            }
            transaction.execute_batch(rows::SOLUTIONS)?;
            transaction.pragma_update(None, "user_version", VERSION)?;
            transaction.commit()
        };
        make(&mut connection).map_err(failed("make the tables of"))?;
    }
    // An older Starmesh that opens this file does not know these tables, and does not need them.
    connection.execute_batch(guiding::SCHEMA).map_err(failed("make the tables of"))?;
    connection.execute_batch(rows::FOCUS).map_err(failed("make the tables of"))?;
    Ok(connection)
}

/// The writer's loop: gathers a batch, commits it, wakes the callers that wait; a batch that fails stays until it
/// succeeds.
fn write_all(
    mut connection: Connection,
    path: &Path,
    mut taken: mpsc::Receiver<Job>,
    runtime: &tokio::runtime::Handle,
    alerts: &AlertBoard,
    (rows, renewal): (&AtomicU64, &Notify),
) {
    while let Some(batch) = gather(&mut taken, runtime) {
        let (mut last_tries, mut is_renewed) = (LAST_TRIES, false);
        loop {
            match write_batch(&mut connection, &batch) {
                Ok(count) => {
                    rows.fetch_add(count, Ordering::Relaxed);
                    alerts.clear(AlertKind::ArchiveDatabase, "");
                    break;
                }
                Err(error) => {
                    // Once for a batch: a disk that damages what it just took is no reason for a third file.
                    let may_renew = damage::is_damage(&error) && !std::mem::replace(&mut is_renewed, true);
                    let renewed = may_renew.then(|| damage::renew(&mut connection, path, &error));
                    let cause = match renewed {
                        Some(Ok(told)) => {
                            alerts.raise(AlertKind::ArchiveDatabase, "", &told);
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

/// The next batch: at once when a caller waits for it, else all rows that come within [`PATIENCE`]. `None` at the end.
fn gather(taken: &mut mpsc::Receiver<Job>, runtime: &tokio::runtime::Handle) -> Option<Vec<Job>> {
    let first = taken.blocking_recv()?;
    let mut is_awaited = first.done.is_some();
    let mut batch = vec![first];
    runtime.block_on(async {
        let deadline = tokio::time::Instant::now() + PATIENCE;
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

fn write_batch(connection: &mut Connection, batch: &[Job]) -> rusqlite::Result<u64> {
    let transaction = connection.transaction()?;
    let mut count = 0;
    for job in batch {
        count += rows::write(&transaction, &job.write)? as u64;
    }
    transaction.commit()?;
    Ok(count)
}

#[cfg(test)]
mod tests;
