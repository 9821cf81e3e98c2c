//! The note that a node writes to disk before it asks for the lease, so that its next incarnation knows a token under
//! which no node ever commanded.
//!
//! ```text
//!   note the claim's id ---> ask the arbiter ---> token and operator orders on disk ---> note taken back ---> command
//!                                        ^ killed here, the next incarnation would follow a token with unknown orders
//! ```
//! The next incarnation asks again under the id of the note. The arbiter repeats its answer, or grants the claim if it
//! had never arrived. Either way the holder of that token commanded nothing, and the orders of the token before it are
//! valid ([`crate::inherit`]).
//!
//! A note that cannot be taken back must not be believed later: the holder of such a token claims another one without a
//! note.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use contract::{CommandId, Name};
use serde::{Deserialize, Serialize};

/// A disk that hangs keeps nobody from commanding.
const DISK: Duration = Duration::from_secs(2);

/// The content of the file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Noted {
    /// The claim that is asked.
    claim: Option<CommandId>,
    /// Tokens whose holders were ended before they commanded.
    #[serde(default)]
    unused: BTreeSet<u64>,
}

/// Where a node keeps it: nodes that share a folder have one each.
pub fn path(config: &config::Observatory, node: &Name) -> PathBuf {
    config.folders.data.join(format!("claim-{}-{node}.json", config.place.telescope))
}

/// The note of one node.
#[derive(Debug)]
pub struct ClaimNote {
    path: PathBuf,
    noted: Noted,
    /// The disk failed: this incarnation notes nothing any more.
    is_silent: bool,
}

impl ClaimNote {
    /// The note that the incarnation before left, if it did.
    pub async fn read(path: PathBuf) -> Self {
        let noted = on_disk(&path, |path| std::fs::read(path)).await;
        // Half a note is none: the claim was not asked yet.
        let noted = noted.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default();
        Self { path, noted, is_silent: false }
    }

    /// The claim that the incarnation before was about to ask, or had asked.
    pub fn left(&self) -> Option<CommandId> {
        self.noted.claim.clone()
    }

    /// Tokens whose holders were ended before they commanded.
    pub fn unused(&self) -> &BTreeSet<u64> {
        &self.noted.unused
    }

    /// The claim that was left was granted this token.
    pub fn was_granted(&mut self, token: u64) {
        self.noted.unused.insert(token);
    }

    /// Notes a claim that is about to be asked. It only has to survive an end of this process, so nothing waits for the
    /// platter.
    pub async fn asks(&mut self, claim: &CommandId) {
        if self.is_silent || self.noted.claim.as_ref() == Some(claim) {
            return;
        }
        let next = Noted { claim: Some(claim.clone()), ..self.noted.clone() };
        let Ok(text) = serde_json::to_vec(&next) else { return };
        match on_disk(&self.path, move |path| std::fs::write(path, &text)).await {
            Ok(()) => self.noted = next,
            Err(error) => {
                // Once: a disk that hangs would hold up each claim, and a thread each time.
                tracing::warn!(path = %self.path.display(), %error, "claims are not noted");
                self.is_silent = true;
            }
        }
    }

    /// Takes the note back, because the granted token is on disk elsewhere. False if it cannot.
    pub async fn is_taken_back(&mut self) -> bool {
        let removed = on_disk(&self.path, |path| std::fs::remove_file(path)).await;
        self.noted = Noted::default();
        match removed {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(path = %self.path.display(), %error, "the note of a claim cannot be taken back");
                std::mem::replace(&mut self.is_silent, true)
            }
            Ok(()) | Err(_) => true,
        }
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
    use super::*;

    fn claim(id: &str) -> CommandId {
        CommandId(id.to_owned())
    }

    #[tokio::test]
    async fn the_next_life_finds_the_claim_and_what_was_never_used_until_it_is_taken_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim.json");
        let mut first = ClaimNote::read(path.clone()).await;
        assert_eq!((first.left(), first.unused().len()), (None, 0));
        first.asks(&claim("one")).await;

        let mut second = ClaimNote::read(path.clone()).await;
        assert_eq!(second.left(), Some(claim("one")));
        second.was_granted(7);
        second.asks(&claim("two")).await;

        let mut third = ClaimNote::read(path.clone()).await;
        assert_eq!((third.left(), third.unused().iter().copied().collect::<Vec<_>>()), (Some(claim("two")), vec![7]));
        assert!(third.is_taken_back().await && !path.exists() && third.unused().is_empty());
        assert!(third.is_taken_back().await, "there is none");

        std::fs::write(&path, "{\"claim\": \"hal").unwrap();
        assert_eq!(ClaimNote::read(path).await.left(), None, "half a note is none");
    }

    #[tokio::test]
    async fn a_note_that_cannot_be_taken_back_is_told_once_and_no_other_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim.json");
        let mut note = ClaimNote::read(path.clone()).await;
        note.asks(&claim("one")).await;
        // A folder in its place can neither be written nor removed as a file.
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(!note.is_taken_back().await, "who holds its token claims another");
        note.asks(&claim("two")).await;
        assert!(path.is_dir() && note.is_taken_back().await);
    }
}
