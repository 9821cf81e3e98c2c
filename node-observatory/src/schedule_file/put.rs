//! Another schedule by order: proven first, kept as a version, then put in the file's place in one step.

use std::io;
use std::sync::Arc;

use crate::schedule_file::versions::{Author, write_whole};

use super::file::rows_of;
use crate::control_room::ControlRoom;
use crate::kept::Unchanged;

/// A schedule that comes over the bus has at most so many bytes, some thousand rows: the bus carries nothing large.
pub const MOST_BYTES: usize = 1_000_000;

/// Puts a text in the place of the schedule file and has it read.
///
/// # Errors
///
/// The text is no schedule, with what is wrong with it; or the disk does not take it. Then the old one stays, whole.
pub async fn put(room: &Arc<ControlRoom>, text: &str, author: Author) -> Result<(), Unchanged> {
    if text.len() > MOST_BYTES {
        let bytes = text.len();
        return Err(Unchanged::Refused(format!("{bytes} bytes; a schedule by order has at most {MOST_BYTES}")));
    }
    let (at, text) = (room.clone(), text.to_owned());
    let replacing = tokio::task::spawn_blocking(move || replace(&at, &text, &author));
    replacing.await.map_err(|error| failed(room, io::Error::other(error)))??;
    room.reload.send_modify(|count| *count += 1);
    Ok(())
}

/// Blocks.
fn replace(room: &ControlRoom, text: &str, author: &Author) -> Result<(), Unchanged> {
    let rows = rows_of(text, room).map_err(Unchanged::Refused)?;
    let kept = room.versions.keep(text, rows.len(), author, room.node.bus.clock().utc());
    let (version, is_new) = kept.map_err(|error| failed(room, error))?;
    let replaced = write_whole(&room.node.config.schedule.file, text);
    if replaced.is_err()
        && is_new
        && let Err(error) = room.versions.take_back(version)
    {
        tracing::warn!(version, %error, "a version of the schedule stands in the list and never was in force");
    }
    replaced.map_err(|error| failed(room, error))?;
    tracing::info!(version, rows = rows.len(), author = author.name, reason = author.reason, "schedule put");
    Ok(())
}

fn failed(room: &ControlRoom, source: io::Error) -> Unchanged {
    Unchanged::Disk { path: room.node.config.schedule.file.display().to_string(), source }
}
