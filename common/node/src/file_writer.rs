//! A thread of its own that writes a file: nobody waits for the disk, and a disk that fails is reported once.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use tokio::sync::oneshot;

/// The way to the thread, which ends when this is dropped and all is written.
pub struct FileWriter<T> {
    items: SyncSender<T>,
    /// The thread drops the other end.
    ended: oneshot::Receiver<()>,
}

impl<T> FileWriter<T> {
    /// Has an item written; one that finds no room is lost.
    pub fn write(&self, item: T) {
        let _ = self.items.try_send(item);
    }

    /// Ends the thread and waits until all is written, for so long at most; true if it is.
    pub async fn end(self, most: Duration) -> bool {
        let Self { items, ended } = self;
        drop(items);
        tokio::time::timeout(most, ended).await.is_ok()
    }
}

/// Starts the thread and gives the way to it, on which at most `waiting` items wait.
///
/// `write` writes one item. The first error of each run of them is logged, with `consequence` as its message: what follows
/// from the failure, for people.
pub fn start<T: Send + 'static>(
    path: PathBuf,
    waiting: usize,
    consequence: &'static str,
    mut write: impl FnMut(&Path, T) -> io::Result<()> + Send + 'static,
) -> FileWriter<T> {
    let (items, to_write) = sync_channel::<T>(waiting);
    let (runs, ended) = oneshot::channel();
    std::thread::spawn(move || {
        let mut fails = false;
        for item in to_write {
            let written = write(&path, item);
            if let (Err(error), false) = (&written, fails) {
                tracing::warn!(file = %path.display(), %error, "{consequence}");
            }
            fails = written.is_err();
        }
        drop(runs);
    });
    FileWriter { items, ended }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    use super::*;

    #[test]
    fn what_is_sent_is_written_in_its_order_also_after_a_failure() {
        let (written, seen) = channel();
        let writer = start(PathBuf::from("file"), 4, "nothing follows", move |path, item: u32| {
            written.send((path.to_owned(), item)).map_err(io::Error::other)?;
            if item == 1 { Err(io::Error::other("the disk is full")) } else { Ok(()) }
        });
        for item in 0..4 {
            writer.write(item);
        }
        drop(writer);
        for item in 0..4 {
            assert_eq!(seen.recv_timeout(Duration::from_secs(60)), Ok((PathBuf::from("file"), item)));
        }
        let ended = seen.recv_timeout(Duration::from_secs(60));
        assert_eq!(ended, Err(RecvTimeoutError::Disconnected), "the thread ends with the way to it");
    }

    #[tokio::test]
    async fn an_end_waits_for_what_is_not_written_yet_but_not_for_a_disk_that_hangs() {
        let start_with = |is_written: bool| {
            let (let_go, goes) = channel();
            let (written, seen) = channel();
            let writer = start(PathBuf::from("file"), 4, "nothing follows", move |_, item: u32| {
                goes.recv().map_err(io::Error::other)?;
                written.send(item).map_err(io::Error::other)
            });
            writer.write(7);
            if is_written {
                let_go.send(()).unwrap();
            }
            (writer, let_go, seen)
        };
        let (writer, _let_go, seen) = start_with(true);
        assert!(writer.end(Duration::from_secs(60)).await);
        assert_eq!(seen.try_recv(), Ok(7));
        let (writer, _hangs, seen) = start_with(false);
        assert!(!writer.end(Duration::from_millis(1)).await);
        assert!(seen.try_recv().is_err());
    }
}
