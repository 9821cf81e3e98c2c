//! Lines for people leave this process on a thread of their own. A terminal that is stopped (Ctrl-S), a pipe that
//! nobody reads or a disk that hangs takes no line for hours, and what closes a dome must not wait for that.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// So many lines wait; what comes after them is left out and counted.
const WAITING: usize = 4096;
/// A process that ends waits so long for its last lines.
const LAST: Duration = Duration::from_secs(1);

/// What the thread is asked.
enum Wanted {
    Out(Vec<u8>),
    Error(Vec<u8>),
    /// Everything before it was written, or tried.
    Written(SyncSender<()>),
}

/// The way to the thread; absent where the system gives none.
static QUEUE: OnceLock<Option<SyncSender<Wanted>>> = OnceLock::new();
/// Lines that found no room.
static LEFT_OUT: AtomicU64 = AtomicU64::new(0);

/// Writes a line to standard output.
pub fn print_line(text: impl Display) {
    send(Wanted::Out(format!("{text}\n").into_bytes()));
}

/// Writes a line to standard error.
pub fn complain(text: impl Display) {
    send(Wanted::Error(format!("{text}\n").into_bytes()));
}

/// Waits until the logged lines are written, for a second at most. For a process that ends.
pub fn flush() {
    let Some(Some(queue)) = QUEUE.get() else { return };
    let (written, is_written) = sync_channel(1);
    // A full queue is one that nobody reads.
    if queue.try_send(Wanted::Written(written)).is_ok() {
        let _ = is_written.recv_timeout(LAST);
    }
}

fn send(wanted: Wanted) {
    let queue = QUEUE.get_or_init(|| {
        let (queue, lines) = sync_channel(WAITING);
        let started = std::thread::Builder::new().name("lines".to_owned()).spawn(move || write(&lines));
        started.is_ok().then_some(queue)
    });
    let is_taken = queue.as_ref().is_some_and(|queue| queue.try_send(wanted).is_ok());
    if !is_taken {
        LEFT_OUT.fetch_add(1, Ordering::Relaxed);
    }
}

/// Writes until the process ends. If the reader has gone, the lines are lost.
fn write(lines: &Receiver<Wanted>) {
    // Handles of our own: a write that takes hours must not hold the lock that a panic elsewhere waits for.
    let (Some(mut out), Some(mut error)) = (own(&io::stdout()), own(&io::stderr())) else { return };
    while let Ok(wanted) = lines.recv() {
        let _ = match wanted {
            Wanted::Out(line) => out.write_all(&line),
            Wanted::Error(line) => error.write_all(&line),
            Wanted::Written(done) => done.try_send(()).map_err(io::Error::other),
        };
        let lost = LEFT_OUT.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let _ = writeln!(error, "{lost} lines were left out here, because nobody took them");
        }
    }
}

/// The same place under a handle of its own.
#[cfg(unix)]
fn own(stream: &impl std::os::fd::AsFd) -> Option<File> {
    stream.as_fd().try_clone_to_owned().ok().map(File::from)
}

#[cfg(windows)]
fn own(stream: &impl std::os::windows::io::AsHandle) -> Option<File> {
    stream.as_handle().try_clone_to_owned().ok().map(File::from)
}

/// Panics are lines like others, so that a thread that panics ends even where nobody takes a line.
pub(crate) fn take_panics() {
    std::panic::set_hook(Box::new(|panic| {
        complain(format_args!("{panic}"));
        flush();
    }));
}

/// A writer for the log: one line each.
pub(crate) struct LogLine;

impl Write for LogLine {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        send(Wanted::Error(line.to_vec()));
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
