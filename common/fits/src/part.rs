//! Files that are being written, under names of their own until they are whole: a kill leaves a part, which a later call
//! for the same name removes after an hour.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

/// A part that was not written to for so long is of a program that was killed.
const LEFT_OVER: Duration = Duration::from_secs(3600);
/// The parts that this process writes are numbered, so that no two have the same name.
static COUNT: AtomicU64 = AtomicU64::new(0);

/// A new name for a part of the file `name` in a folder, from which old parts of it are removed.
pub(crate) fn new_part(folder: &Path, name: &str) -> PathBuf {
    remove_left_over(folder, name);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    // Programs in containers have the same numbers, so the time is in the name as well.
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    folder.join(format!(".{name}.{}-{number}-{}.part", std::process::id(), since.as_nanos()))
}

/// Makes a new name survive a power loss; Windows does so by itself.
///
/// # Errors
/// The error of the system.
pub(crate) fn sync_folder(file: &Path) -> io::Result<()> {
    if cfg!(unix) {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

/// Removes the parts of this name that killed programs left; what cannot be removed harms nobody.
fn remove_left_over(folder: &Path, name: &str) {
    let begins = format!(".{name}.");
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let file = entry.file_name().to_string_lossy().into_owned();
        let is_part = file.starts_with(&begins) && file.ends_with(".part");
        let changed = || entry.metadata().ok()?.modified().ok();
        let is_old =
            || changed().and_then(|at| SystemTime::now().duration_since(at).ok()).is_some_and(|age| age > LEFT_OVER);
        if is_part && is_old() {
            let _ = fs::remove_file(entry.path());
        }
    }
}
