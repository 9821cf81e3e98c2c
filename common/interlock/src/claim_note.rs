//! The note that a node writes to disk before it asks for the lease, so that its next incarnation knows a token under
//! which no node ever commanded.
//!
//! ```text
//!   note the claim's id ---> ask the arbiter ---> token and operator orders on disk ---> note taken back ---> command
//!                                        ^ killed here, the next incarnation would follow a token with unknown orders
//! ```
//! The next incarnation asks again under the id of the note. The arbiter repeats its answer, or grants the claim if it
//! had never arrived. Either way the holder of that token commanded nothing, and the orders of the token before it are
//! valid (`safety::take_over`).
//!
//! A note that cannot be taken back must not be believed later: the holder of such a token claims another one without a
//! note.

use std::collections::BTreeSet;

use contract::CommandId;
use serde::{Deserialize, Serialize};

/// The content of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Noted {
    /// The claim that is asked.
    pub claim: Option<CommandId>,
    /// Tokens whose holders were ended before they commanded.
    #[serde(default)]
    pub unused: BTreeSet<u64>,
}

/// The note of one node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct ClaimNote {
    noted: Noted,
    /// The disk failed: this incarnation notes nothing any more.
    is_silent: bool,
}

impl ClaimNote {
    /// The note that the incarnation before left, or an empty one.
    pub fn new(noted: Noted) -> Self {
        Self { noted, is_silent: false }
    }

    /// The claim that the incarnation before was about to ask, or had asked.
    pub fn left(&self) -> Option<&CommandId> {
        self.noted.claim.as_ref()
    }

    /// Tokens whose holders were ended before they commanded.
    pub fn unused(&self) -> &BTreeSet<u64> {
        &self.noted.unused
    }

    /// The claim that was left was granted this token.
    pub fn was_granted(&mut self, token: u64) {
        self.noted.unused.insert(token);
    }

    /// What must be on disk before this claim is asked; none where it is, or where the disk has failed.
    pub fn asks(&self, claim: &CommandId) -> Option<Noted> {
        let is_due = !self.is_silent && self.noted.claim.as_ref() != Some(claim);
        is_due.then(|| Noted { claim: Some(claim.clone()), ..self.noted.clone() })
    }

    /// It was written, or could not be. After a failure nothing is written any more: a disk that hangs would hold up
    /// each claim.
    pub fn written(&mut self, noted: Option<Noted>) {
        match noted {
            Some(noted) => self.noted = noted,
            None => self.is_silent = true,
        }
    }

    /// The file was removed, because the granted token is on disk elsewhere, or could not be. False where the claim must
    /// be asked once more, without a note.
    pub fn taken_back(&mut self, is_removed: bool) -> bool {
        self.noted = Noted::default();
        is_removed || std::mem::replace(&mut self.is_silent, true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(id: &str) -> CommandId {
        CommandId(id.to_owned())
    }

    #[test]
    fn a_note_that_cannot_be_taken_back_costs_one_more_claim_and_no_other_is_written() {
        let mut note = ClaimNote::default();
        note.written(note.asks(&claim("one")));
        assert_eq!((note.left(), note.asks(&claim("one"))), (Some(&claim("one")), None));
        assert!(!note.taken_back(false), "its holder claims another one");
        assert_eq!((note.left(), note.asks(&claim("two"))), (None, None));
        assert!(note.taken_back(false), "that one has no note");
    }

    #[test]
    fn a_disk_that_fails_is_asked_once() {
        let mut note = ClaimNote::default();
        assert!(note.asks(&claim("one")).is_some());
        note.written(None);
        assert_eq!(note.asks(&claim("two")), None);
        assert!(note.taken_back(true));
    }
}
