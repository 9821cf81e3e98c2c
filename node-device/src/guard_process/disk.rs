//! Writes for the guard process on a thread of its own: a disk that hangs must not hold its loop up.

use std::sync::mpsc::{SyncSender, sync_channel};

use bus::MachineTime;
use interlock::Deadlines;

use super::copy::Copy;
use super::places::Places;

/// What is written.
pub enum Written {
    /// Until when each dome may be open.
    Countdown(MachineTime, Deadlines),
    /// The last-good copy, and its number.
    Copy(u64, Box<Copy>),
    /// The reason why the node did not start holds no longer.
    NoLastWords,
}

/// Starts the thread. A write that finds no room in the queue is left out; the next countdown follows within a second.
pub fn start(places: Places) -> SyncSender<Written> {
    let (disk, writes) = sync_channel(4);
    std::thread::spawn(move || {
        let mut is_reported = false;
        while let Ok(write) = writes.recv() {
            let written = match write {
                Written::Countdown(now, deadlines) => places.keep_countdown(now, &deadlines),
                Written::Copy(number, copy) => places.keep_copy(number, &copy),
                Written::NoLastWords => {
                    places.forget_last_words();
                    continue;
                }
            };
            if !written && !is_reported {
                tracing::error!(
                    "nothing can be written next to the configuration nor in the state folder: a restart of this \
                     process will close the enclosure at once, and not know how if the configuration is broken"
                );
            }
            is_reported = !written;
        }
    });
    disk
}
