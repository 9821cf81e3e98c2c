//! Fencing tokens on disk: the newest one of each telescope, and in a second file the process that it was granted to.
//!
//! Which tokens count is decided in `interlock::KnownTokens`.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::Context as _;
use contract::BootId;
use interlock::KnownTokens;
use serde::{Deserialize, Serialize};

use crate::spool::{sync_folder, write_synced};

/// Extension of the file next to the tokens that holds their holders.
const HOLDERS: &str = "holders";

/// The process that a token was granted to.
#[derive(Serialize, Deserialize)]
struct Holder {
    token: u64,
    life: BootId,
}

/// The newest tokens known, by telescope.
pub struct Tokens {
    file: PathBuf,
    known: Mutex<KnownTokens>,
    writing: Mutex<()>,
}

impl Tokens {
    /// Reads the file; a missing one is empty, an unreadable one is an error, because a token must never go back.
    pub fn open(file: &Path) -> anyhow::Result<Self> {
        let newest: BTreeMap<String, u64> = match fs::read(file) {
            Ok(text) => serde_json::from_slice(&text).with_context(|| {
                let file = file.display();
                format!("{file} is no token file; make sure that no other node commands, then remove it")
            })?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
        };
        let (known, never_granted) = KnownTokens::of(newest);
        for (telescope, token) in &never_granted {
            tracing::error!(telescope, token, "a fencing token in the file was never granted; counting begins anew");
        }
        Ok(Self { file: file.to_owned(), known: Mutex::new(known), writing: Mutex::new(()) })
    }

    /// This node grants the leases of a telescope: what the bus carries of them counts no more.
    pub fn arbitrate(&self, telescope: &str) {
        self.known().arbitrate(telescope);
    }

    /// Does this node grant the leases of a telescope?
    pub fn is_arbiter(&self, telescope: &str) -> bool {
        self.known().is_arbiter(telescope)
    }

    /// Takes over the highest tokens that other device nodes of this host have in the same folder. Until an enclosure
    /// had a node of its own its tokens were granted by the node `main`, and the mount's node refuses lower ones than
    /// it knows.
    ///
    /// # Errors
    /// The disk refuses the higher token.
    pub fn adopt_from_siblings(&self, folder: &Path, telescope: &str) -> anyhow::Result<()> {
        let start = format!("tokens-{telescope}-");
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let is_sibling = name.to_str().is_some_and(|name| name.starts_with(&start) && name.ends_with(".json"));
            if !is_sibling || entry.path() == self.file {
                continue;
            }
            // A file of another node that cannot be read is that node's business.
            let read = fs::read(entry.path()).ok();
            let known: BTreeMap<String, u64> =
                read.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
            for (telescope, token) in known {
                self.raise(&telescope, token).with_context(|| format!("cannot write {}", self.file.display()))?;
            }
        }
        Ok(())
    }

    /// Highest token of a telescope; 0 where none is known.
    pub fn highest(&self, telescope: &str) -> u64 {
        self.known().highest(telescope)
    }

    /// Grants the next token to an incarnation, on disk before it is returned. Blocks.
    pub fn grant(&self, telescope: &str, life: Option<&BootId>) -> io::Result<u64> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let token = self.known().next(telescope);
        // Without this file a token is as good; only a forged permit cannot be distinguished from a true one.
        if let Err(error) = self.note_holder(telescope, token, life) {
            tracing::warn!(telescope, token, %error, "who holds the lease could not be written");
        }
        self.write(telescope, token)?;
        self.learn(telescope, token);
        Ok(token)
    }

    /// The process that the newest token of a telescope was granted to; `None` if the file has another token, or
    /// nothing.
    pub fn holder(&self, telescope: &str) -> Option<BootId> {
        let holder = self.holders().remove(telescope)?;
        (holder.token == self.highest(telescope)).then_some(holder.life)
    }

    fn holders(&self) -> BTreeMap<String, Holder> {
        let read = fs::read(self.file.with_extension(HOLDERS)).ok();
        read.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
    }

    fn note_holder(&self, telescope: &str, token: u64, life: Option<&BootId>) -> io::Result<()> {
        let mut holders = self.holders();
        holders.remove(telescope);
        if let Some(life) = life {
            holders.insert(telescope.to_owned(), Holder { token, life: life.clone() });
        }
        self.replace(&self.file.with_extension(HOLDERS), &serde_json::to_vec_pretty(&holders)?)
    }

    fn raise(&self, telescope: &str, token: u64) -> io::Result<()> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.known().is_raised_by(telescope, token) {
            return Ok(());
        }
        self.learn(telescope, token);
        self.write(telescope, token)
    }

    /// Follows the arbiter's count, in memory even where the disk refuses; the arbiter itself follows nobody. Blocks.
    pub fn follow(&self, telescope: &str, token: u64) -> io::Result<()> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.known().follows(telescope, token) {
            return Ok(());
        }
        self.learn(telescope, token);
        self.write(telescope, token)
    }

    fn known(&self) -> MutexGuard<'_, KnownTokens> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn learn(&self, telescope: &str, token: u64) {
        self.known().learn(telescope, token);
    }

    fn write(&self, telescope: &str, token: u64) -> io::Result<()> {
        let newest = self.known().with(telescope, token);
        self.replace(&self.file, &serde_json::to_vec_pretty(&newest)?)
    }

    /// Replaces a file as a whole, so that it is never half-written.
    fn replace(&self, file: &Path, text: &[u8]) -> io::Result<()> {
        let part = self.file.with_extension("part");
        write_synced(&part, text)?;
        fs::rename(&part, file)?;
        if let Some(folder) = self.file.parent() {
            sync_folder(folder);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_granted_token_outlives_the_node_and_is_never_granted_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.grant("alpha", None).unwrap(), 1);
        assert_eq!(tokens.grant("alpha", None).unwrap(), 2);
        assert_eq!(tokens.grant("beta", None).unwrap(), 1);
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.highest("alpha"), 2);
        assert_eq!(tokens.grant("alpha", None).unwrap(), 3);
    }

    #[test]
    fn an_arbiter_learns_no_token_from_anybody_and_others_follow_it_up_and_down() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        tokens.arbitrate("alpha");
        assert_eq!(tokens.grant("alpha", None).unwrap(), 1);
        for invented in [2, 7, u64::MAX] {
            tokens.follow("alpha", invented).unwrap();
            assert_eq!(tokens.highest("alpha"), 1);
        }
        assert_eq!(tokens.grant("alpha", None).unwrap(), 2);
        // Another node's telescope.
        for (told, known) in [(7, 7), (u64::MAX, 7), (3, 3)] {
            tokens.follow("beta", told).unwrap();
            assert_eq!(tokens.highest("beta"), known);
        }
        assert_eq!(Tokens::open(&file).unwrap().highest("beta"), 3);
    }

    #[test]
    fn a_file_that_was_poisoned_with_the_largest_number_ends_no_night() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        fs::write(&file, r#"{"alpha": 18446744073709551615, "beta": 9}"#).unwrap();
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.grant("alpha", None).unwrap(), 1);
        assert_eq!(tokens.grant("beta", None).unwrap(), 10);
    }

    #[test]
    fn an_enclosure_that_got_a_node_of_its_own_goes_on_from_the_tokens_of_the_node_that_served_it() {
        let folder = tempfile::tempdir().unwrap();
        Tokens::open(&folder.path().join("tokens-alpha-main.json")).unwrap().follow("alpha", 41).unwrap();
        Tokens::open(&folder.path().join("tokens-beta-main.json")).unwrap().follow("alpha", 99).unwrap();
        fs::write(folder.path().join("tokens-alpha-pc.json"), "{").unwrap();
        let tokens = Tokens::open(&folder.path().join("tokens-alpha-enclosure.json")).unwrap();
        tokens.adopt_from_siblings(folder.path(), "alpha").unwrap();
        assert_eq!(tokens.grant("alpha", None).unwrap(), 42);
    }

    #[test]
    fn who_holds_a_lease_is_known_after_a_restart_and_only_of_that_lease() {
        let folder = tempfile::tempdir().unwrap();
        let (file, life) = (folder.path().join("tokens.json"), BootId::fresh());
        let tokens = Tokens::open(&file).unwrap();
        tokens.grant("alpha", Some(&life)).unwrap();
        tokens.grant("beta", None).unwrap();
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!((tokens.holder("alpha"), tokens.holder("beta")), (Some(life), None));
        // Killed between the two files, or the newer one lost.
        fs::write(&file, r#"{"alpha": 5}"#).unwrap();
        assert_eq!(Tokens::open(&file).unwrap().holder("alpha"), None);
        fs::write(file.with_extension(HOLDERS), "{\"al").unwrap();
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!((tokens.holder("alpha"), tokens.grant("alpha", None).unwrap()), (None, 6));
    }

    #[test]
    fn a_token_that_cannot_be_written_is_not_granted() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::open(&folder.path().join("absent").join("tokens.json")).unwrap();
        assert!(tokens.grant("alpha", None).is_err());
        assert_eq!(tokens.highest("alpha"), 0);
        // The arbiter's count binds even so.
        assert!(tokens.follow("alpha", 4).is_err());
        assert_eq!(tokens.highest("alpha"), 4);
    }

    #[test]
    fn a_broken_file_is_an_error_and_not_an_empty_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        fs::write(&file, "{").unwrap();
        assert!(Tokens::open(&file).is_err());
    }
}
