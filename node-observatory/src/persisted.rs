//! A value that survives a restart of the node: in memory, and in one file that is written whole, by one writer at a
//! time.
//!
//! A change that permits more is on disk before it counts ([`Persisted::change_when_written`]). A change that must act
//! at once counts at once, and is written as soon as the disk takes it ([`Persisted::change`],
//! [`Persisted::keep_on_disk`]).

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use contract::observatory::AlertKind;
use contract::{Name, Reason};
use node::NodeAlerts;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::{Mutex, OwnedMutexGuard, watch};

use crate::hold::Hold;

/// A disk that fails is tried again after this.
pub const AGAIN: Duration = Duration::from_secs(2);
/// One that does not answer for so long is an alert.
const HANGS: Duration = Duration::from_secs(10);

/// Waits for a disk, and complains meanwhile where it does not answer within [`HANGS`].
pub async fn answer_of_disk<T>(writing: impl Future<Output = T>, complain: impl FnOnce(&str)) -> T {
    answer_within(HANGS, writing, complain).await
}

/// As [`answer_of_disk`], for another time.
pub async fn answer_within<T>(within: Duration, writing: impl Future<Output = T>, complain: impl FnOnce(&str)) -> T {
    let mut writing = pin!(writing);
    match tokio::time::timeout(within, writing.as_mut()).await {
        Ok(answer) => answer,
        Err(_) => {
            complain(&format!("no answer of the disk within {} s", within.as_secs()));
            writing.await
        }
    }
}

/// A value and its file.
#[derive(Debug)]
pub struct Persisted<T> {
    live: watch::Sender<T>,
    /// Counts the changes of this incarnation; changed only while `live` is locked.
    version: AtomicU64,
    /// The newest of them that is on disk.
    written: watch::Sender<u64>,
    path: PathBuf,
    part: PathBuf,
    pen: Arc<Mutex<()>>,
}

/// Why a change was not made.
#[derive(Debug, thiserror::Error)]
pub enum Unchanged {
    /// It makes no sense now.
    #[error("{0}")]
    Refused(String),
    /// It was made for another state than the present one.
    #[error("{0}")]
    Overtaken(String),
    /// A device does not do it.
    #[error("{detail}")]
    Device {
        /// For programs.
        reason: Reason,
        /// For people.
        detail: String,
    },
    /// The disk does not take it.
    #[error("the disk does not take it ({path}): {source}; nothing was changed")]
    Disk {
        /// The file.
        path: String,
        /// The error of the disk.
        #[source]
        source: io::Error,
    },
}

impl<T: Clone + Serialize + Send + Sync + 'static> Persisted<T> {
    /// A value that is on disk, or need not be. Nodes that share the folder write different temporary files, under the
    /// names that they have as `writer`.
    pub fn new(path: PathBuf, writer: &Name, value: T) -> Self {
        let mut part = path.clone().into_os_string();
        part.push(format!(".{writer}.part"));
        Self {
            live: watch::channel(value).0,
            version: AtomicU64::new(0),
            written: watch::channel(0).0,
            path,
            part: part.into(),
            pen: Arc::default(),
        }
    }

    /// Reads the value from its file, on a thread that may wait for the disk.
    pub async fn load(
        path: PathBuf,
        writer: &Name,
        read: impl FnOnce(&Path) -> T + Send + 'static,
    ) -> anyhow::Result<Arc<Self>> {
        let file = path.clone();
        let value = tokio::task::spawn_blocking(move || read(&file)).await?;
        Ok(Arc::new(Self::new(path, writer, value)))
    }

    /// The value now.
    pub fn get(&self) -> T {
        self.live.borrow().clone()
    }

    /// Follows the value.
    pub fn subscribe(&self) -> watch::Receiver<T> {
        self.live.subscribe()
    }

    /// Changes it at once, to be written later; `change` returns whether it changed anything.
    pub fn change(&self, change: impl FnOnce(&mut T) -> bool) {
        self.live.send_if_modified(|value| {
            let changed = change(value);
            if changed {
                self.version.fetch_add(1, Ordering::SeqCst);
            }
            changed
        });
    }

    /// Takes over what another node has persisted: no change of this incarnation is left to be written.
    pub fn adopt(&self, change: impl FnOnce(&mut T) -> bool) {
        self.live.send_if_modified(|value| {
            self.note_written(self.version.load(Ordering::SeqCst));
            change(value)
        });
    }

    /// Changes it once the change is on disk. `change` is called twice, for the disk and for the memory: the second
    /// result, when something else may have changed, decides.
    pub async fn change_when_written(&self, change: impl Fn(&mut T) -> Result<(), String>) -> Result<(), Unchanged> {
        let pen = self.pen.clone().lock_owned().await;
        let (version, mut next) = self.snapshot();
        change(&mut next).map_err(Unchanged::Refused)?;
        // The lock `pen` is held until the memory has it too.
        let (_pen, put) = self.put(pen, next).await;
        put.map_err(|source| Unchanged::Disk { path: self.path.display().to_string(), source })?;
        let mut done = Ok(());
        self.live.send_if_modified(|value| {
            done = change(value);
            if done.is_err() {
                // The disk knows of what did not come to be.
                self.version.fetch_add(1, Ordering::SeqCst);
            } else {
                self.note_written(version);
            }
            done.is_ok()
        });
        done.map_err(Unchanged::Refused)
    }

    /// Is every change of this incarnation on disk?
    pub fn is_on_disk(&self) -> bool {
        *self.written.borrow() >= self.version.load(Ordering::SeqCst)
    }

    /// Writes it, if it is not on disk yet.
    ///
    /// # Errors
    ///
    /// The disk does not take it; the error names the file.
    pub async fn write(&self) -> io::Result<()> {
        let pen = self.pen.clone().lock_owned().await;
        let (version, value) = self.snapshot();
        if *self.written.borrow() >= version {
            return Ok(());
        }
        let (_pen, put) = self.put(pen, value).await;
        put.map_err(|error| named(&self.path, &error))?;
        self.note_written(version);
        Ok(())
    }

    /// Writes each change that was made at once, again and again until the disk takes it; a standby writes nothing. `what`
    /// says in the alert what is not written.
    pub async fn keep_on_disk(
        self: Arc<Self>,
        alerts: NodeAlerts,
        mut hold: watch::Receiver<Hold>,
        alert: AlertKind,
        what: fn(&T) -> String,
    ) -> anyhow::Result<()> {
        let mut live = self.subscribe();
        let complain = |why: &str| {
            alerts.raise(alert, "", &format!("{} cannot be written down: {why}", what(&self.get())));
        };
        loop {
            if self.is_on_disk() {
                alerts.clear(alert, "");
            } else if hold.borrow().may_publish() {
                let hangs = |why: &str| complain(&format!("{}: {why}", self.path.display()));
                if let Err(error) = answer_of_disk(self.write(), hangs).await {
                    complain(&error.to_string());
                    tokio::time::sleep(AGAIN).await;
                    continue;
                }
                alerts.clear(alert, "");
            }
            tokio::select! {
                changed = live.changed() => changed?,
                changed = hold.changed() => changed?,
                () = tokio::time::sleep(AGAIN) => {}
            }
        }
    }

    /// Is a write under way until it is dropped.
    #[cfg(test)]
    pub async fn hold_pen(&self) -> OwnedMutexGuard<()> {
        self.pen.clone().lock_owned().await
    }

    fn snapshot(&self) -> (u64, T) {
        let value = self.live.borrow();
        (self.version.load(Ordering::SeqCst), value.clone())
    }

    fn note_written(&self, version: u64) {
        self.written.send_if_modified(|written| {
            let is_newer = version > *written;
            *written = version.max(*written);
            is_newer
        });
    }

    /// If the caller gives up waiting, the write keeps `pen`, so that no other write disturbs it.
    async fn put(&self, pen: OwnedMutexGuard<()>, value: T) -> (Option<OwnedMutexGuard<()>>, io::Result<()>) {
        let (path, part) = (self.path.clone(), self.part.clone());
        let put = tokio::task::spawn_blocking(move || (Some(pen), write_whole(&path, &part, &value))).await;
        put.unwrap_or_else(|error| (None, Err(io::Error::other(error))))
    }
}

/// The error of a disk, with the file.
pub fn named(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Reads what an earlier incarnation wrote; the default if there is no file. If the file cannot be read, a copy of it
/// is stored and the default is returned: nothing unsafe depends on it.
pub fn read_or_anew<T: Default + DeserializeOwned>(path: &Path, what: &str) -> T {
    let why = match std::fs::read(path) {
        Ok(bytes) => match serde_json::from_slice(&bytes) {
            Ok(value) => return value,
            Err(error) => error.to_string(),
        },
        Err(error) if error.kind() == io::ErrorKind::NotFound => return T::default(),
        Err(error) => error.to_string(),
    };
    node::aside::keep_copy(path, &why, &format!("Without it, {what} is learned anew."));
    T::default()
}

/// Puts a value in the place of another one; false if they are equal.
pub fn replaced<T: Clone + PartialEq>(known: &mut T, new: &T) -> bool {
    let is_new = known != new;
    if is_new {
        known.clone_from(new);
    }
    is_new
}

/// The old file or the new one, whatever happens.
pub fn write_whole<T: Serialize>(path: &Path, part: &Path, value: &T) -> io::Result<()> {
    let mut file = std::fs::File::create(part)?;
    file.write_all(&serde_json::to_vec_pretty(value)?)?;
    file.sync_all()?;
    std::fs::rename(part, path)?;
    // The new name is on disk with its folder; Windows opens no folders.
    #[cfg(unix)]
    if let Some(folder) = path.parent() {
        std::fs::File::open(folder)?.sync_all()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn persisted(folder: &Path) -> Persisted<Vec<u32>> {
        Persisted::new(folder.join("list.json"), &"main".parse().unwrap(), Vec::new())
    }

    fn on_disk(folder: &Path) -> Vec<u32> {
        let text = std::fs::read(folder.join("list.json")).unwrap_or_else(|_| b"[]".to_vec());
        serde_json::from_slice(&text).unwrap()
    }

    fn add(number: u32) -> impl Fn(&mut Vec<u32>) -> Result<(), String> {
        move |list| {
            list.push(number);
            Ok(())
        }
    }

    #[tokio::test]
    async fn what_is_changed_when_written_is_on_disk_and_nothing_changes_where_the_disk_fails() {
        let folder = tempfile::tempdir().unwrap();
        let list = persisted(folder.path());
        list.change_when_written(add(1)).await.unwrap();
        assert_eq!((list.get(), on_disk(folder.path())), (vec![1], vec![1]));
        assert!(list.is_on_disk());
        // A folder where the file is to be written: no disk takes that, whichever user asks.
        std::fs::create_dir(folder.path().join("list.json.main.part")).unwrap();
        let refused = list.change_when_written(add(2)).await.unwrap_err();
        assert!(matches!(refused, Unchanged::Disk { .. }), "{refused}");
        assert!(refused.to_string().contains("list.json") && refused.to_string().contains("nothing was changed"));
        assert_eq!((list.get(), on_disk(folder.path())), (vec![1], vec![1]));
        let senseless = list.change_when_written(|_| Err("no".to_owned())).await.unwrap_err();
        assert!(matches!(senseless, Unchanged::Refused(why) if why == "no"));
    }

    #[tokio::test]
    async fn what_is_changed_at_once_counts_at_once_and_is_written_when_the_disk_is_back() {
        let folder = tempfile::tempdir().unwrap();
        let list = persisted(folder.path());
        let part = folder.path().join("list.json.main.part");
        std::fs::create_dir(&part).unwrap();
        list.change(|list| {
            list.push(7);
            true
        });
        assert_eq!(list.get(), [7]);
        let refused = list.write().await.unwrap_err().to_string();
        assert!(refused.contains("list.json: ") && !list.is_on_disk(), "{refused}");
        std::fs::remove_dir(&part).unwrap();
        list.write().await.unwrap();
        assert!(list.is_on_disk());
        assert_eq!(on_disk(folder.path()), [7]);
        // This node must not write a value that is another node's to write.
        list.adopt(|list| {
            list.clear();
            true
        });
        list.write().await.unwrap();
        assert_eq!((list.get(), on_disk(folder.path())), (vec![], vec![7]));
    }

    #[tokio::test]
    async fn what_was_changed_at_once_while_another_change_was_written_is_applied() {
        let folder = tempfile::tempdir().unwrap();
        let list = persisted(folder.path());
        let times = AtomicU64::new(0);
        // Between the disk and the memory, another change says 9: the change that permits more does not happen.
        let refused = list
            .change_when_written(|list| {
                if times.fetch_add(1, Ordering::SeqCst) == 1 {
                    return Err("somebody wrote 9 meanwhile".to_owned());
                }
                list.push(1);
                Ok(())
            })
            .await;
        assert!(matches!(refused, Err(Unchanged::Refused(_))));
        assert_eq!((list.get(), on_disk(folder.path())), (vec![], vec![1]));
        assert!(!list.is_on_disk(), "the disk knows too much");
        list.write().await.unwrap();
        assert_eq!(on_disk(folder.path()), Vec::<u32>::new());
    }

    #[tokio::test]
    async fn changes_made_side_by_side_are_all_on_disk() {
        let folder = tempfile::tempdir().unwrap();
        let list = Arc::new(persisted(folder.path()));
        let mut tasks = tokio::task::JoinSet::new();
        for number in 0..20 {
            let list = list.clone();
            tasks.spawn(async move {
                if number % 2 == 0 {
                    list.change_when_written(add(number)).await.unwrap();
                } else {
                    list.change(|list| {
                        list.push(number);
                        true
                    });
                    list.write().await.unwrap();
                }
            });
        }
        while tasks.join_next().await.transpose().unwrap().is_some() {}
        list.write().await.unwrap();
        let (mut known, mut written) = (list.get(), on_disk(folder.path()));
        known.sort();
        written.sort();
        assert_eq!((known, written), ((0..20).collect(), (0..20).collect()));
    }
}
