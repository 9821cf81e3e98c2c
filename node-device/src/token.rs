//! Fencing tokens on disk: the newest one of each telescope, and in a second file the process that it was granted to.
//!
//! Which tokens count, and who may be granted one, is decided in `interlock::Leases`.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::Context as _;
use contract::{BootId, CommandId};
use interlock::{KnownTokens, Leases, NextToken};
use serde::{Deserialize, Serialize};

use crate::spool::{sync_folder, write_synced};

/// Extension of the file next to the tokens that holds their holders.
const HOLDERS: &str = "holders";

/// The process that a token was granted to.
#[derive(Serialize, Deserialize)]
struct Holder {
    token: u64,
    boot_id: BootId,
    /// The claim that the token answers; none in a file of an earlier version.
    claim: Option<CommandId>,
}

/// The newest tokens known, by telescope, and who commands with them; shared by the devices of a node.
pub struct Tokens {
    file: PathBuf,
    leases: Mutex<Leases>,
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
        Ok(Self { file: file.to_owned(), leases: Mutex::new(Leases::new(known)), writing: Mutex::new(()) })
    }

    /// This node grants the leases of a telescope: what the bus carries of them counts no more.
    pub fn arbitrate(&self, telescope: &str) {
        self.leases().tokens_mut().arbitrate(telescope);
    }

    /// The guard process remembers this token of a lease that this node grants: it counts where this node's file is gone.
    pub fn show(&self, telescope: &str, token: u64) {
        self.leases().tokens_mut().show(telescope, token);
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
                self.raise(&telescope, token).context("cannot write the fencing tokens")?;
            }
        }
        Ok(())
    }

    /// Highest token of a telescope; 0 where none is known.
    pub fn highest(&self, telescope: &str) -> u64 {
        self.leases().tokens().highest(telescope)
    }

    /// Grants the next token to an incarnation, on disk before it is returned. The same claim of the same incarnation
    /// is asked again when its answer was lost, perhaps because this node was ended meanwhile: it has the same token,
    /// since a second one would say that somebody unknown had commanded with the first. `shows`: the token that the
    /// claimant remembers. Blocks.
    pub fn grant(
        &self,
        telescope: &str,
        (boot_id, shows): (Option<&BootId>, Option<u64>),
        claim: &CommandId,
    ) -> io::Result<NextToken> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(holder) = self.newest_holder(telescope)
            && (boot_id, Some(claim)) == (Some(&holder.boot_id), holder.claim.as_ref())
        {
            return Ok(NextToken { token: holder.token, left_behind: None });
        }
        let next = self.leases().tokens().next(telescope, shows);
        let token = next.token;
        // Without this file a token is as good; only a forged permit cannot be distinguished from a true one.
        if let Err(error) = self.note_holder(telescope, token, boot_id, claim) {
            tracing::warn!(telescope, token, %error, "who holds the lease could not be written");
        }
        let newest = self.leases().tokens().with(telescope, token);
        self.write(&newest)?;
        self.leases().tokens_mut().learn(telescope, token);
        Ok(next)
    }

    /// The process that the newest token of a telescope was granted to; `None` if the file has another token, or
    /// nothing.
    pub fn holder(&self, telescope: &str) -> Option<BootId> {
        self.newest_holder(telescope).map(|holder| holder.boot_id)
    }

    fn newest_holder(&self, telescope: &str) -> Option<Holder> {
        let holder = self.holders().remove(telescope)?;
        (holder.token == self.highest(telescope)).then_some(holder)
    }

    fn holders(&self) -> BTreeMap<String, Holder> {
        let read = fs::read(self.file.with_extension(HOLDERS)).ok();
        read.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
    }

    fn note_holder(&self, telescope: &str, token: u64, boot_id: Option<&BootId>, claim: &CommandId) -> io::Result<()> {
        let mut holders = self.holders();
        holders.remove(telescope);
        if let Some(boot_id) = boot_id {
            holders
                .insert(telescope.to_owned(), Holder { token, boot_id: boot_id.clone(), claim: Some(claim.clone()) });
        }
        self.replace(&self.file.with_extension(HOLDERS), &serde_json::to_vec_pretty(&holders)?)
    }

    fn raise(&self, telescope: &str, token: u64) -> io::Result<()> {
        if !self.leases().tokens().is_raised_by(telescope, token) {
            return Ok(());
        }
        self.leases().tokens_mut().learn(telescope, token);
        self.persist()
    }

    /// Writes the tokens that count. Blocks.
    pub fn persist(&self) -> io::Result<()> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let newest = self.leases().tokens().newest().clone();
        self.write(&newest)
    }

    /// What is known of the leases of the site.
    pub fn leases(&self) -> MutexGuard<'_, Leases> {
        self.leases.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, newest: &BTreeMap<String, u64>) -> io::Result<()> {
        let written = self.replace(&self.file, &serde_json::to_vec_pretty(newest)?);
        written.map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", self.file.display())))
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

    /// The token that a claimant is granted that remembers none.
    fn granted(tokens: &Tokens, telescope: &str, boot_id: Option<&BootId>, claim: &CommandId) -> u64 {
        tokens.grant(telescope, (boot_id, None), claim).unwrap().token
    }

    /// Follows the arbiter's count as published, and persists it.
    fn follow(tokens: &Tokens, telescope: &str, token: u64) -> io::Result<()> {
        let followed = tokens.leases().follow(telescope, token);
        followed.map_or(Ok(()), |_| tokens.persist())
    }

    #[test]
    fn a_granted_token_outlives_the_node_and_is_never_granted_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 1);
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 2);
        assert_eq!(granted(&tokens, "beta", None, &CommandId::fresh()), 1);
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.highest("alpha"), 2);
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 3);
    }

    #[test]
    fn a_token_that_the_disk_does_not_take_is_not_granted_and_the_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        let part = file.with_extension("part");
        fs::create_dir(&part).unwrap();
        let refused = tokens.grant("alpha", (None, None), &CommandId::fresh()).unwrap_err().to_string();
        assert!(refused.starts_with(&format!("{}: ", file.display())), "{refused}");
        assert_eq!(tokens.highest("alpha"), 0);
        fs::remove_dir(&part).unwrap();
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 1);
    }

    #[test]
    fn an_arbiter_whose_file_is_gone_goes_on_from_what_its_guard_process_remembers() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        // The commander's folder is gone, too: it remembers nothing.
        let next = |remembered| {
            let tokens = Tokens::open(&file).unwrap();
            tokens.arbitrate("alpha");
            tokens.show("alpha", remembered);
            let next = tokens.grant("alpha", (None, None), &CommandId::fresh()).unwrap();
            (next.token, next.left_behind)
        };
        assert_eq!(next(0), (1, None), "a first night");
        assert_eq!(next(41), (2, None), "the file counts");
        fs::remove_file(&file).unwrap();
        assert_eq!(next(41), (42, Some(0)), "nobody may take it for the first commander of all");
    }

    #[test]
    fn an_arbiter_learns_no_token_from_anybody_and_others_follow_it_up_and_down() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        tokens.arbitrate("alpha");
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 1);
        for invented in [2, 7, u64::MAX] {
            follow(&tokens, "alpha", invented).unwrap();
            assert_eq!(tokens.highest("alpha"), 1);
        }
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 2);
        // Another node's telescope.
        for (reported, known) in [(7, 7), (u64::MAX, 7), (3, 3)] {
            follow(&tokens, "beta", reported).unwrap();
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
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 1);
        assert_eq!(granted(&tokens, "beta", None, &CommandId::fresh()), 10);
    }

    #[test]
    fn an_enclosure_that_got_a_node_of_its_own_goes_on_from_the_tokens_of_the_node_that_served_it() {
        let folder = tempfile::tempdir().unwrap();
        for (file, token) in [("tokens-alpha-main.json", 41), ("tokens-beta-main.json", 99)] {
            follow(&Tokens::open(&folder.path().join(file)).unwrap(), "alpha", token).unwrap();
        }
        fs::write(folder.path().join("tokens-alpha-pc.json"), "{").unwrap();
        let tokens = Tokens::open(&folder.path().join("tokens-alpha-enclosure.json")).unwrap();
        tokens.adopt_from_siblings(folder.path(), "alpha").unwrap();
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 42);
    }

    #[test]
    fn who_holds_a_lease_is_known_after_a_restart_and_only_of_that_lease() {
        let folder = tempfile::tempdir().unwrap();
        let (file, boot_id) = (folder.path().join("tokens.json"), BootId::fresh());
        let tokens = Tokens::open(&file).unwrap();
        granted(&tokens, "alpha", Some(&boot_id), &CommandId::fresh());
        granted(&tokens, "beta", None, &CommandId::fresh());
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!((tokens.holder("alpha"), tokens.holder("beta")), (Some(boot_id), None));
        // Killed between the two files, or the newer one lost.
        fs::write(&file, r#"{"alpha": 5}"#).unwrap();
        assert_eq!(Tokens::open(&file).unwrap().holder("alpha"), None);
        fs::write(file.with_extension(HOLDERS), "{\"al").unwrap();
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!((tokens.holder("alpha"), granted(&tokens, "alpha", None, &CommandId::fresh())), (None, 6));
    }

    #[test]
    fn each_file_of_the_arbiter_may_be_lost_and_the_next_token_follows_the_claimants() {
        let (boot_id, claim) = (BootId::fresh(), CommandId::fresh());
        for (lost, left_behind) in [(&[HOLDERS][..], None), (&["json"], Some(0)), (&["json", HOLDERS], Some(0))] {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("tokens.json");
            fs::write(&file, r#"{"alpha": 1999}"#).unwrap();
            assert_eq!(granted(&Tokens::open(&file).unwrap(), "alpha", Some(&boot_id), &claim), 2000);
            lost.iter().for_each(|extension| fs::remove_file(file.with_extension(extension)).unwrap());
            let tokens = Tokens::open(&file).unwrap();
            tokens.arbitrate("alpha");
            let next = tokens.grant("alpha", (Some(&boot_id), Some(2000)), &CommandId::fresh()).unwrap();
            assert_eq!((next.token, next.left_behind), (2001, left_behind), "{lost:?}");
            assert_eq!(Tokens::open(&file).unwrap().highest("alpha"), 2001, "{lost:?}");
        }
    }

    #[test]
    fn a_claim_whose_answer_was_lost_has_the_same_token_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let (boot_id, claim) = (BootId::fresh(), CommandId::fresh());
        assert_eq!(granted(&Tokens::open(&file).unwrap(), "alpha", Some(&boot_id), &claim), 1);
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(granted(&tokens, "alpha", Some(&boot_id), &claim), 1);
        // Another incarnation, another claim, a later token: each is a lease of its own.
        assert_eq!(granted(&tokens, "alpha", Some(&BootId::fresh()), &claim), 2);
        assert_eq!(granted(&tokens, "alpha", Some(&boot_id), &claim), 3);
        assert_eq!(granted(&tokens, "alpha", Some(&boot_id), &CommandId::fresh()), 4);
        assert_eq!(granted(&tokens, "alpha", Some(&boot_id), &claim), 5);
        // A file of an earlier version names no claim.
        fs::write(file.with_extension(HOLDERS), format!(r#"{{"alpha": {{"token": 5, "boot_id": "{boot_id}"}}}}"#))
            .unwrap();
        let tokens = Tokens::open(&file).unwrap();
        assert_eq!(tokens.holder("alpha"), Some(boot_id.clone()));
        assert_eq!(granted(&tokens, "alpha", Some(&boot_id), &claim), 6);
    }

    #[test]
    fn a_token_that_cannot_be_written_is_not_granted() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::open(&folder.path().join("absent").join("tokens.json")).unwrap();
        assert!(tokens.grant("alpha", (None, None), &CommandId::fresh()).is_err());
        assert_eq!(tokens.highest("alpha"), 0);
        // The arbiter's count binds even so.
        assert!(follow(&tokens, "alpha", 4).is_err());
        assert_eq!(tokens.highest("alpha"), 4);
    }

    #[test]
    fn a_file_that_is_cut_or_holds_no_tokens_is_an_error_that_names_it_and_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        for text in ["", "{\"alpha\": 4", "[4]", "{\"alpha\": \"4\"}", "{\"alpha\": -4}", "{\"alpha\": 4.5}", "null"] {
            fs::write(&file, text).unwrap();
            let error = format!("{:#}", Tokens::open(&file).map(|_| ()).unwrap_err());
            let names_it = error.contains("tokens.json is no token file");
            assert!(names_it && error.contains("make sure that no other node commands"), "{text}: {error}");
            assert_eq!(fs::read_to_string(&file).unwrap(), text, "it stays for people");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_grants_no_token_and_leaves_the_file_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.json");
        let tokens = Tokens::open(&file).unwrap();
        granted(&tokens, "alpha", Some(&BootId::fresh()), &CommandId::fresh());
        let before = [fs::read(&file).unwrap(), fs::read(file.with_extension(HOLDERS)).unwrap()];
        // What is written next finds no room.
        let part = file.with_extension("part");
        std::os::unix::fs::symlink("/dev/full", &part).unwrap();
        let error = tokens.grant("alpha", (None, None), &CommandId::fresh()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert_eq!([fs::read(&file).unwrap(), fs::read(file.with_extension(HOLDERS)).unwrap()], before);
        assert_eq!(tokens.highest("alpha"), 1);
        fs::remove_file(part).unwrap();
        assert_eq!(granted(&tokens, "alpha", None, &CommandId::fresh()), 2, "once there is room");
        assert_eq!(Tokens::open(&file).unwrap().highest("alpha"), 2);
    }
}
