//! A lock on a file, for as long as this is held.

use std::fs::{File, TryLockError};

/// A locked file. To close it is not enough to end that: a child process that is just being started has it open, too.
#[derive(Debug)]
pub struct FileLock(File);

impl FileLock {
    /// Locks a file, if nobody else has.
    ///
    /// # Errors
    /// Somebody holds it, or the file system has no locks.
    pub fn of(file: File) -> Result<Self, TryLockError> {
        file.try_lock()?;
        Ok(Self(file))
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_ends_when_it_is_dropped_also_where_a_child_has_the_file_open_for_a_moment() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let (file, again) = (File::create(&path).unwrap(), File::create(&path).unwrap());
        // As in a child between its fork and its exec.
        let inherited = file.try_clone().unwrap();
        let held = FileLock::of(file).unwrap();
        assert!(matches!(again.try_lock(), Err(TryLockError::WouldBlock)));
        drop(held);
        assert!(again.try_lock().is_ok());
        drop(inherited);
    }
}
