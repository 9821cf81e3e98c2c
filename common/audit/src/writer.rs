//! The thread that writes: it gathers a batch, adds it to the chain, appends and syncs it, and hands it to the bus.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use contract::audit::{AuditOutcome, AuditRecord};
use contract::observatory::AlertKind;
use tokio::sync::mpsc;

use crate::Proven;
use crate::audit_file::{AuditFile, BROKEN};
use crate::chain;
use crate::entry::Signs;

/// A record waits so long for others to be synced with it.
const TIMEOUT: Duration = Duration::from_millis(200);
/// Records of one sync, at most.
const BATCH: usize = 500;
/// A disk that failed is tried again after so long, and when the node ends for so many times.
const RETRY: Duration = Duration::from_secs(1);
const LAST_TRIES: u32 = 2;

/// The items of the queue.
pub(crate) enum Item {
    /// A record without its place, after so many that found no room.
    Note { record: Box<AuditRecord>, lost_before: u64 },
    /// Asks the writer to check whether it has to end.
    Wake,
}

pub(crate) struct Writer {
    signs: Arc<Signs>,
    file: AuditFile,
    lines: mpsc::Sender<Proven>,
    /// Records that were taken from the queue and are not certainly on disk.
    waiting: VecDeque<AuditRecord>,
    /// Entries that found no room, since the start of this process.
    missing: u64,
}

impl Writer {
    pub fn new(signs: Arc<Signs>, file: AuditFile, lines: mpsc::Sender<Proven>) -> Self {
        // The rest that a kill left is repaired and recorded at once, not when the first command comes.
        let starts = signs.about_itself("node_starts", note(env!("CARGO_PKG_VERSION")));
        Self { signs, file, lines, waiting: VecDeque::from([starts]), missing: 0 }
    }

    /// Writes until the node ends.
    pub fn run(mut self, taken: &Receiver<Item>) {
        let mut last_tries = LAST_TRIES;
        let mut at_end = false;
        while !at_end || !self.waiting.is_empty() {
            if self.waiting.is_empty() {
                at_end |= self.gather(taken);
                if self.waiting.is_empty() {
                    continue;
                }
            }
            match self.write() {
                Ok(()) => self.signs.alerts.clear(AlertKind::Audit, ""),
                Err(error) => {
                    self.signs.complain(&format!("the audit cannot be written: {error}"));
                    if at_end || self.signs.ending.load(Ordering::Acquire) {
                        at_end = true;
                        last_tries -= 1;
                    }
                    if last_tries == 0 {
                        tracing::error!(records = self.waiting.len(), %error, "records of the audit are lost");
                        return;
                    }
                    std::thread::sleep(RETRY);
                }
            }
        }
    }

    /// The next batch; true when nothing more will come.
    fn gather(&mut self, taken: &Receiver<Item>) -> bool {
        let ending = self.signs.ending.load(Ordering::Acquire);
        let mut deadline = Instant::now() + TIMEOUT;
        if !ending {
            match taken.recv() {
                Ok(item) => self.take(item),
                Err(_) => return true,
            }
            deadline = Instant::now() + TIMEOUT;
        }
        while self.waiting.len() < BATCH {
            let left = if self.signs.ending.load(Ordering::Acquire) {
                Duration::ZERO
            } else {
                deadline.saturating_duration_since(Instant::now())
            };
            match taken.recv_timeout(left) {
                Ok(item) => self.take(item),
                Err(RecvTimeoutError::Disconnected) => return true,
                Err(RecvTimeoutError::Timeout) => {
                    // The queue is empty, so every entry that found no room came before this.
                    self.lose(self.signs.lost.swap(0, Ordering::AcqRel));
                    return self.signs.ending.load(Ordering::Acquire);
                }
            }
        }
        false
    }

    fn take(&mut self, item: Item) {
        if let Item::Note { record, lost_before } = item {
            self.lose(lost_before);
            self.waiting.push_back(*record);
        }
    }

    fn lose(&mut self, missing: u64) {
        if missing > 0 {
            self.missing += missing;
            self.signs.report_lost(self.missing);
            self.waiting.push_back(self.signs.about_itself("records_lost", AuditOutcome::Lost { missing }));
        }
    }

    fn write(&mut self) -> io::Result<()> {
        if !self.file.is_open() {
            let notes = self.file.open()?;
            for (verb, detail) in notes.into_iter().rev() {
                if verb == "chain_begins" {
                    // At the first start of every node.
                    tracing::info!(detail, "the audit of this node begins");
                } else {
                    tracing::warn!(verb, detail, "audit");
                }
                if verb == BROKEN {
                    self.signs.report_broken(&detail);
                }
                self.waiting.push_front(self.signs.about_itself(verb, note(&detail)));
            }
        }
        let Some(mut last) = self.file.last().cloned() else {
            return Err(io::Error::other("the audit file is not open"));
        };
        let mut lines = Vec::new();
        for record in &self.waiting {
            let sealed = chain::seal(record.clone(), &last)?;
            last = sealed.link();
            lines.push(sealed);
        }
        self.file.append(&lines)?;
        self.waiting.clear();
        for line in lines {
            // A line that finds no room, or no receiver, is asked for later.
            let _ = self.lines.try_send(line);
        }
        Ok(())
    }
}

fn note(detail: &str) -> AuditOutcome {
    AuditOutcome::Noted { detail: detail.to_owned() }
}

#[cfg(test)]
#[path = "writer_tests.rs"]
mod tests;
