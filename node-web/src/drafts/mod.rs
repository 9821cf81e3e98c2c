//! Drafts of schedules: a file for each, in the data folder of this node, written whole and for its user alone.

pub mod etag;

use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use contract::{Address, Name};
use node::private;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use tokio::sync::Mutex;
use units::Utc;

use self::etag::Demand;
use crate::problem::{Code, Problem};

/// Drafts of one telescope.
const MOST_OF_TELESCOPE: usize = 100;
/// Bytes of all drafts of one telescope: listing them reads them.
const MOST_BYTES_OF_TELESCOPE: u64 = 20_000_000;
/// A text of the largest size, in JSON, where each character has an escape.
const MOST_FILE_BYTES: u64 = 8_000_000;

/// A draft as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredDraft {
    /// The text of the schedule.
    pub text: String,
    /// The author of its last change.
    pub author: String,
    /// Sky time of its last change.
    pub changed_utc: Utc,
    /// SHA-256 of the schedule that was in force when the draft was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub based_on: Option<String>,
}

/// A draft without its text.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize)]
pub struct DraftSummary {
    /// Its name.
    pub id: Name,
    /// Its ETag, without the quotes that the headers have.
    pub etag: String,
    /// The author of its last change.
    pub author: String,
    /// Sky time of its last change.
    pub changed_utc: Utc,
    /// SHA-256 of the schedule that was in force when the draft was made; absent where that was not known.
    pub based_on: Option<String>,
    /// Length of its text.
    pub bytes: u64,
}

impl DraftSummary {
    /// Of a draft.
    pub fn of(id: Name, draft: &StoredDraft) -> Self {
        let (etag, author, bytes) = (draft.etag(), draft.author.clone(), draft.text.len() as u64);
        Self { id, etag, author, changed_utc: draft.changed_utc, based_on: draft.based_on.clone(), bytes }
    }
}

impl StoredDraft {
    /// Another one for each change, by whomever and whenever.
    pub fn etag(&self) -> String {
        let mut hash = Sha256::new();
        for part in [&self.text, &self.author, &self.changed_utc.to_string()] {
            hash.update((part.len() as u64).to_be_bytes());
            hash.update(part);
        }
        hash.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
    }
}

/// All drafts of this node.
pub struct Drafts {
    files: Arc<Files>,
    /// One change after another, so that what a change demands is so when it is made.
    /// Held until the disk has answered, whoever has gone meanwhile.
    turn: Arc<Mutex<()>>,
}

#[derive(Debug)]
struct Files(PathBuf);

impl Drafts {
    /// Those of a node with this configuration; nothing is read or made yet.
    pub fn of(config: &config::Observatory) -> Self {
        let folder = config.folders.data.join(format!("drafts-{}", config.place.telescope));
        Self { files: Arc::new(Files(folder)), turn: Arc::default() }
    }

    /// The drafts of a telescope, by name.
    pub async fn list(&self, address: &Address) -> Result<Vec<DraftSummary>, Problem> {
        let address = address.clone();
        let found = self.blocking(move |files| files.all(&address)).await?;
        Ok(found.into_iter().map(|(id, draft)| DraftSummary::of(id, &draft)).collect())
    }

    /// One draft.
    ///
    /// # Errors
    /// 404 where there is none.
    pub async fn read(&self, address: &Address, id: &Name) -> Result<StoredDraft, Problem> {
        let path = self.files.path(address, id);
        let found = self.blocking(move |_| read(&path)).await?;
        found.ok_or_else(|| none(address, id))
    }

    /// Stores a draft where `demand` holds; true where it is new. The same text again changes nothing.
    ///
    /// # Errors
    /// 412 where it does not hold, 409 where there are too many.
    pub async fn put(
        &self,
        address: &Address,
        id: &Name,
        demand: Demand,
        draft: StoredDraft,
    ) -> Result<(StoredDraft, bool), Problem> {
        let (address, id) = (address.clone(), id.clone());
        self.in_turn(move |files| Ok(files.put(&address, &id, &demand, draft))).await?
    }

    /// Removes a draft where `demand` holds.
    ///
    /// # Errors
    /// 404 where there is none, 412 where the demand does not hold.
    pub async fn remove(&self, address: &Address, id: &Name, demand: Demand) -> Result<(), Problem> {
        let (path, none) = (self.files.path(address, id), none(address, id));
        let removed = self.in_turn(move |_| {
            let Some(now) = read(&path)? else { return Ok(Err(none)) };
            match demand.check(Some(&now.etag())) {
                Ok(()) => fs::remove_file(&path).map(Ok),
                Err(problem) => Ok(Err(problem)),
            }
        });
        removed.await?
    }

    /// Changes what is stored, one after another.
    async fn in_turn<T: Send + 'static>(
        &self,
        act: impl FnOnce(&Files) -> io::Result<T> + Send + 'static,
    ) -> Result<T, Problem> {
        let turn = self.turn.clone().lock_owned().await;
        self.blocking(move |files| {
            let done = act(files);
            drop(turn);
            done
        })
        .await
    }

    async fn blocking<T: Send + 'static>(
        &self,
        act: impl FnOnce(&Files) -> io::Result<T> + Send + 'static,
    ) -> Result<T, Problem> {
        let files = self.files.clone();
        let done = tokio::task::spawn_blocking(move || act(&files)).await;
        done.map_err(io::Error::other).and_then(|done| done).map_err(|error| failed(&error))
    }
}

fn none(address: &Address, id: &Name) -> Problem {
    Problem::not_found(format!("There is no draft {id} of {address} at this server."))
}

impl Files {
    fn folder(&self, address: &Address) -> PathBuf {
        self.0.join(address.site.as_str()).join(address.telescope.as_str())
    }

    fn path(&self, address: &Address, id: &Name) -> PathBuf {
        self.folder(address).join(format!("{id}.json"))
    }

    fn all(&self, address: &Address) -> io::Result<Vec<(Name, StoredDraft)>> {
        let entries = match fs::read_dir(self.folder(address)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let mut found = Vec::new();
        for entry in entries.take(4 * MOST_OF_TELESCOPE) {
            let path = entry?.path();
            let id = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".json")?.parse::<Name>().ok());
            let Some(id) = id else { continue };
            found.extend(read(&path)?.map(|draft| (id, draft)));
        }
        found.sort_by(|(one, _), (other, _)| one.cmp(other));
        Ok(found)
    }

    fn put(
        &self,
        address: &Address,
        id: &Name,
        demand: &Demand,
        draft: StoredDraft,
    ) -> Result<(StoredDraft, bool), Problem> {
        let path = self.path(address, id);
        let before = read(&path).map_err(|error| failed(&error))?;
        demand.check(before.as_ref().map(StoredDraft::etag).as_deref())?;
        let others = self.all(address).map_err(|error| failed(&error))?;
        let others: Vec<_> = others.iter().filter(|(other, _)| other != id).collect();
        let bytes: u64 = others.iter().map(|(_, other)| other.text.len() as u64).sum();
        if others.len() >= MOST_OF_TELESCOPE || bytes + draft.text.len() as u64 > MOST_BYTES_OF_TELESCOPE {
            let detail = format!(
                "{address} has {} other drafts with {bytes} bytes; at most {MOST_OF_TELESCOPE} with {MOST_BYTES_OF_TELESCOPE} bytes \
                 are stored: remove some first.",
                others.len()
            );
            return Err(Problem::new(Code::Conflict, "Too many drafts", detail));
        }
        let draft = match before {
            Some(before) if before.text == draft.text => return Ok((before, false)),
            Some(before) => (StoredDraft { based_on: before.based_on, ..draft }, false),
            None => (draft, true),
        };
        private::make_folder(&self.folder(address)).map_err(|error| failed(&error))?;
        let text = serde_json::to_vec(&draft.0).map_err(io::Error::other);
        let written = text.and_then(|text| private::write_whole(&path, &text));
        written.map_err(|error| failed(&error))?;
        Ok(draft)
    }
}

/// A draft, if it is there. One that is damaged is set aside for people, and is there no longer.
fn read(path: &Path) -> io::Result<Option<StoredDraft>> {
    let open = match fs::File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        open => open?,
    };
    let mut bytes = Vec::new();
    open.take(MOST_FILE_BYTES).read_to_end(&mut bytes)?;
    match serde_json::from_slice(&bytes) {
        Ok(draft) => Ok(Some(draft)),
        Err(error) => {
            node::aside::keep_copy(path, &error.to_string(), "The draft is no longer offered.");
            fs::remove_file(path)?;
            Ok(None)
        }
    }
}

fn failed(error: &io::Error) -> Problem {
    tracing::error!(%error, "a draft of a schedule could not be read or written");
    let detail = format!("The disk of this server does not take or give the draft: {error}. Nothing was changed.");
    Problem::new(Code::Internal, "The disk failed", detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drafts(folder: &Path) -> Drafts {
        Drafts { files: Arc::new(Files(folder.join("drafts"))), turn: Arc::default() }
    }

    fn draft(text: &str) -> StoredDraft {
        let changed_utc = "2026-11-21T03:00:00Z".parse().unwrap();
        StoredDraft { text: text.to_owned(), author: "ana".to_owned(), changed_utc, based_on: None }
    }

    #[tokio::test]
    async fn a_draft_that_is_damaged_is_set_aside_and_its_name_is_free_again() {
        let folder = tempfile::tempdir().unwrap();
        let (drafts, address) = (drafts(folder.path()), Address::new("p", "t").unwrap());
        let id: Name = "a".parse().unwrap();
        drafts.put(&address, &id, Demand::IsNew, draft("one")).await.unwrap();
        fs::write(drafts.files.path(&address, &id), "{\"text\": \"o").unwrap();
        assert!(drafts.list(&address).await.unwrap().is_empty());
        drafts.put(&address, &id, Demand::IsNew, draft("two")).await.unwrap();
        assert_eq!(drafts.read(&address, &id).await.unwrap().text, "two");
        let names: Vec<String> = fs::read_dir(folder.path().join("drafts/p/t"))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        assert!(names.len() == 2 && names.iter().any(|name| name.starts_with("a.json.bad-")), "{names:?}");
    }

    #[tokio::test]
    async fn drafts_are_bounded_in_number_and_bytes_and_one_that_is_there_can_still_be_changed() {
        let folder = tempfile::tempdir().unwrap();
        let (drafts, address) = (drafts(folder.path()), Address::new("p", "t").unwrap());
        let put = async |id: &str, demand: Demand, text: &str| {
            drafts.put(&address, &id.parse().unwrap(), demand, draft(text)).await
        };
        for number in 0..MOST_OF_TELESCOPE {
            put(&format!("d{number}"), Demand::IsNew, "x").await.unwrap();
        }
        assert!(put("more", Demand::IsNew, "x").await.is_err());
        put("d0", Demand::Exists, "y").await.unwrap();
        assert_eq!(drafts.list(&address).await.unwrap().len(), MOST_OF_TELESCOPE);
        for number in 0..19 {
            put(&format!("d{number}"), Demand::Exists, &"x".repeat(1_000_000)).await.unwrap();
        }
        assert!(put("d50", Demand::Exists, &"x".repeat(1_000_000)).await.is_err());
        assert_eq!(drafts.read(&address, &"d50".parse().unwrap()).await.unwrap().text, "x", "it is as it was");
    }
}
