//! Frames on disk until the archive has them: written whole or not at all, announced until released.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use alpaca::{AlpacaError, Image};
use bus::MachineTime;
use contract::device::camera::{Frame, Purpose};
use contract::{Chunk, CommandId, Datum, Name, NoData, Reading, Role};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, mpsc};
use units::Utc;

/// A frame is kept at least so long after it was first announced: guiding and measuring fetch it too.
pub const KEEP: Duration = Duration::from_secs(60);
/// Frames that may wait for the disk at once; a camera that is faster waits.
const WAITING_FOR_DISK: usize = 3;

/// Why a frame is not in the spool.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// What the camera answered is no image.
    #[error("what {camera} answered as its image cannot be read: {source}")]
    Image {
        /// Which camera.
        camera: Name,
        /// What is wrong with the answer.
        source: AlpacaError,
    },
    /// The disk refused.
    #[error("cannot write {path}: {source}")]
    Disk {
        /// Which file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The entry's description cannot be written.
    #[error("cannot describe the frame: {0}")]
    Describe(#[from] serde_json::Error),
}

/// What is known of a frame in addition to its pixels.
#[derive(Debug, Clone)]
pub struct About {
    /// Id of the frame and of its `expose` command.
    pub id: CommandId,
    /// Which camera.
    pub camera: Name,
    /// Why it was taken.
    pub purpose: Purpose,
    /// Binning factor.
    pub bin: u32,
    /// First column and row on the sensor, binned pixels.
    pub origin_px: [u32; 2],
    /// Sky time of the shutter's opening.
    pub started_utc: Utc,
    /// Seconds of light.
    pub exposure_s: f64,
    /// The camera's fixed properties.
    pub readings: BTreeMap<String, Reading>,
}

/// The right to bring one frame to the disk.
pub struct Place {
    _permit: Option<OwnedSemaphorePermit>,
}

/// The spool of one device node.
pub struct Spool {
    folder: PathBuf,
    /// `http://host:port`, where the frames are served.
    base: String,
    /// The archive nodes that must have a frame before it is removed, as they sign; any one where empty.
    archives: BTreeSet<String>,
    entries: Mutex<BTreeMap<String, Entry>>,
    free: Mutex<Datum<u64>>,
    places: Arc<Semaphore>,
    change: Notify,
    stored: mpsc::UnboundedSender<Result<CommandId, (CommandId, SpoolError)>>,
}

#[derive(Debug, Clone)]
struct Entry {
    stored: SpooledFrame,
    announced: Option<MachineTime>,
    /// Every archive that must have it has it.
    released: bool,
    /// Those that have it.
    released_by: BTreeSet<String>,
}

impl Entry {
    fn new(stored: SpooledFrame) -> Self {
        Self { stored, announced: None, released: false, released_by: BTreeSet::new() }
    }
}

/// The content of a frame's JSON file.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct SpooledFrame {
    token: String,
    frame: Frame,
}

impl Spool {
    /// Opens a spool folder, removes what a crash left half written, and takes up the frames that still wait.
    ///
    /// A frame stays until all of these archive nodes of `telescope` have it; until any archive has it where there are
    /// none. The receiver gets a message for each frame that is safe, or why it is not.
    #[allow(clippy::type_complexity, reason = "written once")]
    pub fn open(
        folder: &Path,
        base: String,
        (telescope, archives): (&Chunk, &[Name]),
    ) -> Result<(Self, mpsc::UnboundedReceiver<Result<CommandId, (CommandId, SpoolError)>>), SpoolError> {
        let disk = |source| SpoolError::Disk { path: folder.to_owned(), source };
        fs::create_dir_all(folder).map_err(disk)?;
        let mut entries = BTreeMap::new();
        for file in fs::read_dir(folder).map_err(disk)? {
            let path = file.map_err(disk)?.path();
            match path.extension().and_then(|extension| extension.to_str()) {
                Some("json") => match read_entry(&path) {
                    Ok(saved) => {
                        entries.insert(saved.frame.id.0.clone(), Entry::new(saved));
                    }
                    Err(reason) => {
                        tracing::warn!(path = %path.display(), reason, "a spooled frame is not whole; set aside");
                        let _ = fs::rename(&path, path.with_extension("bad"));
                    }
                },
                Some("part") => {
                    let _ = fs::remove_file(&path);
                }
                // Pixels come before their description, so pixels alone were never announced
                // those of a description that was set aside stay with it.
                Some("pixels") if !path.with_extension("json").exists() && !path.with_extension("bad").exists() => {
                    let _ = fs::remove_file(&path);
                }
                _ => {}
            }
        }
        let (stored, receiver) = mpsc::unbounded_channel();
        let free = Mutex::new(Datum::default());
        let places = Arc::new(Semaphore::new(WAITING_FOR_DISK));
        Ok((
            Self {
                folder: folder.to_owned(),
                base,
                archives: archives.iter().map(|id| format!("{}/{telescope}/{id}", Role::Archive)).collect(),
                entries: Mutex::new(entries),
                free,
                places,
                change: Notify::new(),
                stored,
            },
            receiver,
        ))
    }

    /// Waits until the disk is not behind by more than three frames.
    pub async fn place(&self) -> Place {
        Place { _permit: self.places.clone().acquire_owned().await.ok() }
    }

    /// Waits until every frame that was downloaded is on disk, at most `limit`.
    pub async fn settle(&self, limit: Duration) {
        let all = u32::try_from(WAITING_FOR_DISK).unwrap_or(u32::MAX);
        if tokio::time::timeout(limit, self.places.acquire_many(all)).await.is_err() {
            tracing::error!("a frame was not on disk when the node ended");
        }
    }

    /// Decodes a frame and writes it to the disk, off the async threads, then sends a message to the receiver.
    pub async fn keep(
        self: Arc<Self>,
        place: Place,
        decode: impl FnOnce() -> Result<Image, AlpacaError> + Send + 'static,
        about: About,
    ) {
        let (id, camera, spool) = (about.id.clone(), about.camera.clone(), self.clone());
        let work = tokio::task::spawn_blocking(move || {
            let image = decode().map_err(|source| SpoolError::Image { camera, source })?;
            spool.store(&image, about)
        });
        let outcome = match work.await {
            Ok(Ok(())) => Ok(id),
            Ok(Err(error)) => Err((id, error)),
            Err(died) => Err((id, SpoolError::Disk { path: self.folder.clone(), source: io::Error::other(died) })),
        };
        // The receiver is gone only while the node ends; the frame is announced at its next start.
        let _ = self.stored.send(outcome);
        drop(place);
    }

    /// Writes a frame: pixels, then description, each whole or not at all. Blocks.
    pub fn store(&self, image: &Image, about: About) -> Result<(), SpoolError> {
        let sha256 = hex(&Sha256::digest(&image.bytes));
        let name = about.id.0.clone();
        let frame = Frame {
            id: about.id,
            camera: about.camera.to_string(),
            purpose: about.purpose,
            width_px: image.width_px,
            height_px: image.height_px,
            planes: image.planes,
            pixel: image.pixel,
            bin: about.bin,
            origin_px: about.origin_px,
            started_utc: about.started_utc,
            exposure_s: about.exposure_s,
            url: String::new(),
            bytes: image.bytes.len() as u64,
            sha256,
            readings: about.readings,
        };
        let stored = SpooledFrame { token: uuid::Uuid::now_v7().simple().to_string(), frame };
        self.write(&format!("{name}.pixels"), &image.bytes)?;
        self.write(&format!("{name}.json"), &serde_json::to_vec(&stored)?).inspect_err(|_| {
            // Pixels that nobody will ever fetch must not take the last room.
            let _ = fs::remove_file(self.folder.join(format!("{name}.pixels")));
        })?;
        sync_folder(&self.folder);
        self.entries().insert(name, Entry::new(stored));
        self.change.notify_waiters();
        Ok(())
    }

    /// Ends when a frame came or was released; one that falls between two waits shows in the next state.
    pub async fn stirred(&self) {
        self.change.notified().await;
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), SpoolError> {
        let path = self.folder.join(name);
        let part = self.folder.join(format!("{name}.part"));
        let written = write_synced(&part, bytes).and_then(|()| fs::rename(&part, &path));
        written.map_err(|source| {
            let _ = fs::remove_file(&part);
            SpoolError::Disk { path, source }
        })
    }

    /// A frame as it is announced, with the address of its pixels.
    pub fn frame(&self, id: &CommandId) -> Option<Frame> {
        self.entries().get(&id.0).map(|entry| self.with_url(&entry.stored))
    }

    /// Frames of a camera that the archive has not released, oldest id first.
    pub fn unreleased(&self, camera: &Name) -> Vec<Frame> {
        let entries = self.entries();
        let mine = entries.values().filter(|entry| !entry.released && entry.stored.frame.camera == camera.as_str());
        mine.map(|entry| self.with_url(&entry.stored)).collect()
    }

    /// How many those are.
    pub fn waiting(&self, camera: &Name) -> u32 {
        let entries = self.entries();
        let mine = entries.values().filter(|entry| !entry.released && entry.stored.frame.camera == camera.as_str());
        u32::try_from(mine.count()).unwrap_or(u32::MAX)
    }

    fn with_url(&self, stored: &SpooledFrame) -> Frame {
        let mut frame = stored.frame.clone();
        frame.url = format!("{}/frame/{}?token={}", self.base, frame.id, stored.token);
        frame
    }

    /// Notes that a frame was announced.
    pub fn announced(&self, id: &CommandId, now: MachineTime) {
        if let Some(entry) = self.entries().get_mut(&id.0) {
            entry.announced.get_or_insert(now);
        }
    }

    /// Is a frame of this id here?
    pub fn holds(&self, id: &CommandId) -> bool {
        self.entries().contains_key(&id.0)
    }

    /// The archive with this signature has the frame. When all have it, it is removed by a later [`Self::sweep`]. An
    /// unknown frame was released before.
    pub fn release(&self, id: &CommandId, sha256: &str, archive: &str) -> Result<(), String> {
        match self.entries().get_mut(&id.0) {
            None => Ok(()),
            Some(entry) if entry.stored.frame.sha256.eq_ignore_ascii_case(sha256) => {
                if self.archives.contains(archive) {
                    entry.released_by.insert(archive.to_owned());
                }
                entry.released = entry.released_by.len() == self.archives.len();
                self.change.notify_waiters();
                Ok(())
            }
            Some(entry) => Err(format!("frame {id} has the hash {}, not {sha256}", entry.stored.frame.sha256)),
        }
    }

    /// Removes released frames whose time has run out. Blocks.
    pub fn sweep(&self, now: MachineTime) {
        self.remove(|entry| entry.released && entry.announced.is_some_and(|at| now.since(at) >= KEEP));
    }

    /// Removes released frames when the node ends, after which nobody fetches them. Blocks.
    pub fn sweep_at_the_end(&self) {
        self.remove(|entry| entry.released);
    }

    fn remove(&self, over: impl Fn(&Entry) -> bool) {
        let gone: Vec<String> =
            self.entries().iter().filter(|(_, entry)| over(entry)).map(|(name, _)| name.clone()).collect();
        for name in gone {
            // Description first: pixels alone are swept at the next start.
            let removed = fs::remove_file(self.folder.join(format!("{name}.json")));
            let _ = fs::remove_file(self.folder.join(format!("{name}.pixels")));
            match removed {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    tracing::warn!(frame = name, %error, "a released frame cannot be removed");
                }
                _ => {
                    self.entries().remove(&name);
                }
            }
        }
    }

    /// File and length of a frame's pixels, for those who know its token.
    pub fn pixels(&self, id: &str, token: &str) -> Option<(PathBuf, u64)> {
        let entries = self.entries();
        let stored = &entries.get(id)?.stored;
        (stored.token == token).then(|| (self.folder.join(format!("{id}.pixels")), stored.frame.bytes))
    }

    /// Free space where the spool lies, as it was measured last.
    pub fn free_bytes(&self) -> Datum<u64> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Measures the free space. Blocks.
    pub fn measure_free(&self) {
        let folder = fs::canonicalize(&self.folder).unwrap_or_else(|_| self.folder.clone());
        let free = sysinfo::Disks::new_with_refreshed_list().ok().and_then(|disks| {
            let holding = disks.iter().filter(|disk| folder.starts_with(disk.mount_point()));
            // The nearest mount point above the folder.
            let nearest = holding.max_by_key(|disk| disk.mount_point().as_os_str().len());
            nearest.map(sysinfo::Disk::available_space)
        });
        let free = free.ok_or_else(|| NoData::new("missing", "this system does not report it"));
        *self.free.lock().unwrap_or_else(PoisonError::into_inner) = free.into();
    }

    fn entries(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, Entry>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn read_entry(json: &Path) -> Result<SpooledFrame, String> {
    let text = fs::read(json).map_err(|error| error.to_string())?;
    let stored: SpooledFrame = serde_json::from_slice(&text).map_err(|error| error.to_string())?;
    let length = fs::metadata(json.with_extension("pixels")).map_err(|error| error.to_string())?.len();
    if json.file_stem().and_then(|stem| stem.to_str()) != Some(stored.frame.id.0.as_str()) {
        return Err(format!("it describes frame {}", stored.frame.id));
    }
    if length != stored.frame.bytes {
        return Err(format!("{length} of {} bytes", stored.frame.bytes));
    }
    Ok(stored)
}

/// Writes a file and waits until the disk has it.
pub(crate) fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Makes renames in a folder last; where folders cannot be opened (Windows) the rename itself must do.
pub(crate) fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
#[path = "spool_tests.rs"]
mod tests;
