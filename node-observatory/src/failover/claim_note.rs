//! The file of the note that a node writes before it asks for the lease; what it means is `interlock::ClaimNote`'s.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use contract::Name;
use interlock::Noted;

/// A disk that hangs keeps nobody from commanding.
const DISK: Duration = Duration::from_secs(2);

/// Where a node keeps it: nodes that share a folder have one each.
pub fn path(config: &config::Observatory, node: &Name) -> PathBuf {
    config.folders.data.join(format!("claim-{}-{node}.json", config.place.telescope))
}

/// The note that the incarnation before left, if it did. Half a note is none: the claim was not asked yet.
pub async fn read(path: &Path) -> Noted {
    let noted = on_disk(path, |path| std::fs::read(path)).await;
    noted.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
}

/// Writes it; none where it cannot. It only has to survive an end of this process, so nothing waits for the platter.
pub async fn write(path: &Path, noted: Noted) -> Option<Noted> {
    let text = serde_json::to_vec(&noted).ok()?;
    match on_disk(path, move |path| std::fs::write(path, &text)).await {
        Ok(()) => Some(noted),
        Err(error) => {
            tracing::warn!(path = %path.display(), %error, "claims are not noted");
            None
        }
    }
}

/// Removes it; false where it cannot.
pub async fn remove(path: &Path) -> bool {
    match on_disk(path, |path| std::fs::remove_file(path)).await {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(path = %path.display(), %error, "the note of a claim cannot be taken back");
            false
        }
        Ok(()) | Err(_) => true,
    }
}

async fn on_disk<T: Send + 'static>(
    path: &Path,
    work: impl FnOnce(&Path) -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    let path = path.to_owned();
    let working = tokio::task::spawn_blocking(move || work(&path));
    match tokio::time::timeout(DISK, working).await {
        Ok(done) => done.map_err(io::Error::other)?,
        Err(_) => Err(io::ErrorKind::TimedOut.into()),
    }
}

#[cfg(test)]
mod tests {
    use contract::CommandId;
    use interlock::ClaimNote;

    use super::*;

    fn claim(id: &str) -> CommandId {
        CommandId(id.to_owned())
    }

    async fn asks(path: &Path, note: &mut ClaimNote, id: &str) {
        if let Some(noted) = note.asks(&claim(id)) {
            note.written(write(path, noted).await);
        }
    }

    #[tokio::test]
    async fn the_next_incarnation_finds_the_claim_and_what_was_never_used_until_it_is_taken_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim.json");
        let mut first = ClaimNote::new(read(&path).await);
        assert_eq!((first.left(), first.unused().len()), (None, 0));
        asks(&path, &mut first, "one").await;

        let mut second = ClaimNote::new(read(&path).await);
        assert_eq!(second.left(), Some(&claim("one")));
        second.was_granted(7);
        asks(&path, &mut second, "two").await;

        let mut third = ClaimNote::new(read(&path).await);
        assert_eq!((third.left(), third.unused().iter().copied().collect::<Vec<_>>()), (Some(&claim("two")), vec![7]));
        assert!(third.taken_back(remove(&path).await) && !path.exists() && third.unused().is_empty());
        assert!(third.taken_back(remove(&path).await), "there is none");

        std::fs::write(&path, "{\"claim\": \"hal").unwrap();
        assert_eq!(read(&path).await, Noted::default(), "half a note is none");
    }

    #[tokio::test]
    async fn a_note_that_cannot_be_taken_back_is_reported_once_and_no_other_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim.json");
        let mut note = ClaimNote::new(read(&path).await);
        asks(&path, &mut note, "one").await;
        // A folder in its place can neither be written nor removed as a file.
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(!note.taken_back(remove(&path).await), "who holds its token claims another");
        asks(&path, &mut note, "two").await;
        assert!(path.is_dir() && note.taken_back(remove(&path).await));
    }
}
