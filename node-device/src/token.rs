//! Fencing tokens on disk: the highest one of each telescope, which never goes back.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::Context as _;

use crate::spool::{sync_folder, write_synced};

/// The highest tokens known, by telescope.
pub struct Tokens {
    file: PathBuf,
    known: Mutex<BTreeMap<String, u64>>,
    writing: Mutex<()>,
}

impl Tokens {
    /// Reads the file; a missing one is empty, an unreadable one is an error, because a token must never go back.
    pub fn open(file: &Path) -> anyhow::Result<Self> {
        let known = match fs::read(file) {
            Ok(text) => serde_json::from_slice(&text).with_context(|| {
                let file = file.display();
                format!("{file} is no token file; make sure that no other node commands, then remove it")
            })?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
        };
        Ok(Self { file: file.to_owned(), known: Mutex::new(known), writing: Mutex::new(()) })
    }

    /// Highest token of a telescope; 0 where none is known.
    pub fn highest(&self, telescope: &str) -> u64 {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).get(telescope).copied().unwrap_or(0)
    }

    /// Grants the next token, on disk before it is returned. Blocks.
    pub fn grant(&self, telescope: &str) -> io::Result<u64> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let token = self.highest(telescope) + 1;
        self.write(telescope, token)?;
        self.learn(telescope, token);
        Ok(token)
    }

    /// Remembers a token that was heard, in memory even where the disk refuses. Blocks.
    pub fn heard(&self, telescope: &str, token: u64) -> io::Result<()> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if token <= self.highest(telescope) {
            return Ok(());
        }
        self.learn(telescope, token);
        self.write(telescope, token)
    }

    fn learn(&self, telescope: &str, token: u64) {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).insert(telescope.to_owned(), token);
    }

    fn write(&self, telescope: &str, token: u64) -> io::Result<()> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner).clone();
        known.insert(telescope.to_owned(), token);
        let part = self.file.with_extension("part");
        write_synced(&part, &serde_json::to_vec_pretty(&known)?)?;
        fs::rename(&part, &self.file)?;
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
        assert_eq!(tokens.grant("alpha").unwrap(), 1);
        tokens.heard("alpha", 7).unwrap();
        tokens.heard("alpha", 3).unwrap();
        assert_eq!(tokens.grant("beta").unwrap(), 1);
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.highest("alpha"), 7);
        assert_eq!(tokens.grant("alpha").unwrap(), 8);
    }

    #[test]
    fn a_token_that_cannot_be_written_is_not_granted() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::open(&folder.path().join("absent").join("tokens.json")).unwrap();
        assert!(tokens.grant("alpha").is_err());
        assert_eq!(tokens.highest("alpha"), 0);
        // what was heard binds even so
        assert!(tokens.heard("alpha", 4).is_err());
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
