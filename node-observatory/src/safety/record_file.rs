//! The file of what this node received of the safety inputs (`safety::stored_history`), for its next incarnation.
//!
//! It is written in place each second and never waited for: it has to survive an end of the process, not one of the
//! machine. Half a file is none.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use bus::MachineTime;
use contract::Name;
use node::file_writer::{self, FileWriter};
use safety::stored_history::StoredHistory;

/// It is written so often.
const EVERY: Duration = Duration::from_millis(900);

/// The file, written by a thread of its own: a disk that hangs delays no verdict.
pub struct RecordFile {
    writer: FileWriter<StoredHistory>,
    written: Option<MachineTime>,
}

/// Where a node keeps it: nodes that share a folder have one each.
pub fn path(config: &config::Observatory, node: &Name) -> PathBuf {
    config.folders.data.join(format!("safety-record-{}-{node}.json", config.place.telescope))
}

/// What the incarnation before wrote, or why it cannot be read; nothing where there is no file.
pub fn read(path: &Path) -> Result<Option<StoredHistory>, String> {
    match std::fs::read(path) {
        Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| format!("it cannot be read: {error}")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(format!("it cannot be read: {error}")),
    }
}

impl RecordFile {
    /// Starts the thread that writes it.
    pub fn open(path: PathBuf) -> Self {
        let consequence = "after a restart of this node and of device nodes the dwell would run";
        let writer = file_writer::start(path, 1, consequence, |path, history| write(path, &history));
        Self { writer, written: None }
    }

    /// Has it written, if it is time.
    pub fn keep(&mut self, now: MachineTime, history: impl FnOnce() -> StoredHistory) {
        if self.written.is_none_or(|written| now.since(written) >= EVERY) {
            self.written = Some(now);
            // While the disk is slow, the next one is.
            self.writer.write(history());
        }
    }
}

fn write(path: &Path, history: &StoredHistory) -> io::Result<()> {
    let text = serde_json::to_vec(history)?;
    let mut file = std::fs::OpenOptions::new().create(true).write(true).truncate(false).open(path)?;
    file.write_all(&text)?;
    file.set_len(text.len() as u64)
}

#[cfg(test)]
mod tests {
    use safety::history::Now;
    use safety::received::History;
    use safety::rules::Rules;
    use safety::stored_history::Moment;
    use units::{SkyTime, Utc};

    use super::*;

    #[test]
    fn what_was_written_is_read_and_half_a_file_is_none() {
        let since = Duration::from_secs(1000);
        let now = Now { sky: SkyTime::from_start(since), machine: MachineTime::from_boot(since) };
        let moment = |boot: &str| Moment { boot: boot.to_owned(), now, utc: Utc::EPOCH, speed: 1.0 };
        let history = |boot: &str| History::new(&Rules::default(), now.sky).store(&Rules::default(), &moment(boot));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.json");
        assert_eq!(read(&path), Ok(None));
        for boot in ["a-long-one", "b"] {
            write(&path, &history(boot)).unwrap();
            assert_eq!(read(&path), Ok(Some(history(boot))));
        }
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(read(&path).is_err(), "{length} bytes of {}", whole.len());
        }
    }
}
