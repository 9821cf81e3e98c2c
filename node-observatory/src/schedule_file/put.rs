//! Another schedule by order: proven first, kept as a version, then put in the file's place in one step.

use std::io;
use std::sync::{Arc, PoisonError};

use node::private::write_whole;
use schedule::read_text;

use super::file::{keep_as_written, rows_of};
use super::{ActiveText, ScheduleFile};
use crate::persisted::Unchanged;
use crate::schedule_file::versions::{Author, sha256};

/// A schedule that comes over the bus has at most so many bytes, some thousand rows: the bus carries nothing large.
pub const MOST_BYTES: usize = 1_000_000;

/// Puts a text in the place of the schedule file and has it read; where `instead_of` names a text by its SHA-256, only in
/// the place of this one.
///
/// # Errors
///
/// The text is no schedule, with what is wrong with it; or the disk does not take it. Then the old one stays, whole.
pub async fn put(
    file: &Arc<ScheduleFile>,
    text: &str,
    instead_of: Option<&str>,
    author: Author,
) -> Result<(), Unchanged> {
    if text.len() > MOST_BYTES {
        let bytes = text.len();
        return Err(Unchanged::Refused(format!("{bytes} bytes; a schedule by order has at most {MOST_BYTES}")));
    }
    let (at, text, instead_of) = (file.clone(), text.to_owned(), instead_of.map(str::to_owned));
    let replacing = tokio::task::spawn_blocking(move || replace(&at, &text, instead_of.as_deref(), &author));
    replacing.await.map_err(|error| failed(file, io::Error::other(error)))??;
    file.reload.send_modify(|count| *count += 1);
    Ok(())
}

/// Blocks.
fn replace(file: &ScheduleFile, text: &str, instead_of: Option<&str>, author: &Author) -> Result<(), Unchanged> {
    let mut active = file.active.lock().unwrap_or_else(PoisonError::into_inner);
    // A person may have written what stands there a moment ago. A file that would be refused does not count.
    let on_disk = read_text(&file.authority.node.config.schedule.file).ok();
    let on_disk = on_disk.and_then(|text| rows_of(&text, file).ok().map(|rows| (text, rows.len())));
    let newest = match &on_disk {
        Some((text, _)) => Some(sha256(text)),
        None => active.as_ref().map(|active| active.sha256.clone()),
    };
    if let Some(wanted) = instead_of
        && newest.as_deref() != Some(wanted)
    {
        let now = newest.as_deref().unwrap_or("none");
        return Err(Unchanged::Overtaken(format!(
            "another schedule is in force than the one that it was made for: {now} and not {wanted} (SHA-256); compare it with \
             yours, and order again"
        )));
    }
    let rows = rows_of(text, file).map_err(Unchanged::Refused)?;
    // Nothing is replaced that is no version.
    if let Some((written, count)) = on_disk {
        keep_as_written(file, &written, count).map_err(|error| failed(file, error))?;
    }
    let stored = file.versions.keep(text, rows.len(), author, file.authority.node.bus.clock().utc());
    let (version, is_new) = stored.map_err(|error| failed(file, error))?;
    let replaced = write_whole(&file.authority.node.config.schedule.file, text.as_bytes());
    if replaced.is_err()
        && is_new
        && let Err(error) = file.versions.take_back(version)
    {
        tracing::warn!(version, %error, "a version of the schedule stands in the list and never was in force");
    }
    replaced.map_err(|error| failed(file, error))?;
    *active = Some(ActiveText { sha256: sha256(text), text: text.into() });
    tracing::info!(version, rows = rows.len(), author = author.name, reason = author.reason, "schedule put");
    Ok(())
}

fn failed(file: &ScheduleFile, source: io::Error) -> Unchanged {
    Unchanged::Disk { path: file.authority.node.config.schedule.file.display().to_string(), source }
}
