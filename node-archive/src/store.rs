//! A frame's way from its announcement to a file, a row, and the release from the spool.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context as _;
use bus::{AskError, Catch, Publisher};
use contract::archive::Stored;
use contract::device::camera::{self, Frame};
use contract::observatory::AlertKind;
use contract::{Command, CommandId, Device, Key, Kind, Reason, Scalar, Topic};
use node::Node;
use tokio::sync::{Notify, Semaphore, watch};
use tokio::task::JoinSet;
use units::Utc;

use crate::database::{Database, StoredImage, Write};
use crate::fits::{FitsFile, Shape, is_restored_whole};
use crate::folder::{self, is_taken, make_way, relative_text, rename_to_free, sync_folder, without_links};
use crate::header;
use crate::name::{Namer, compressed, other_than};
use crate::pairing::pairing;
use crate::reader::Reader;
use crate::rebuild::OnDisk;
use crate::sensor::{Sensor, during};
use crate::stored_header::Header;
use crate::telemetry::Newest;
use crate::turns::Turns;

/// Files that are written at the same time.
const WRITTEN_AT_ONCE: usize = 2;
/// Announcements that wait; the spool holds the frames, so none is lost with them.
const WAITING: usize = 4096;
/// First and longest wait before a failed step is tried again, machine time.
const FIRST_WAIT: Duration = Duration::from_millis(500);
const LONGEST_WAIT: Duration = Duration::from_secs(30);
/// After so many failures in a row an alert is raised.
const FAILURES_BEFORE_ALERT: u32 = 5;
/// A spool that refuses is asked so often; it announces the frame again after its next start.
const RELEASE_TRIES: u32 = 50;
/// Everything that is needed to store a frame.
pub struct Store {
    /// The node.
    pub node: Node,
    /// The database to which rows are written.
    pub database: Database,
    /// The newest states of the devices.
    pub newest: Newest,
    /// How files are named.
    pub namer: Namer,
    /// Publishes which frames are safe.
    pub stored: Arc<Publisher<Stored>>,
    /// Notified when there is a header to complete.
    pub incomplete: Arc<Notify>,
    /// Frames stored, since the database began.
    pub count: AtomicI64,
    /// Held from the choice of a file's name until the file has it: two frames of one moment have the same name.
    pub naming: tokio::sync::Mutex<()>,
    /// The files that lie in the folder of images and are not in the database.
    pub on_disk: OnDisk,
    /// Frames that failed often, with camera and cause: one alert for all of them.
    pub failing: Failing,
}

/// The frames that cannot be stored, by id: one alert reports all of them, whatever their number.
#[derive(Debug, Default)]
pub struct Failing(Mutex<BTreeMap<String, String>>);

impl Failing {
    /// Notes that a frame cannot be stored; returns the alert's cause for all of them.
    fn add(&self, frame: &CommandId, cause: String) -> String {
        let mut failing = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        failing.insert(frame.0.clone(), cause.clone());
        text_of(failing.len(), cause)
    }

    /// Notes that a frame is stored; returns the alert's cause for the others, if there are any.
    fn remove(&self, frame: &CommandId) -> Option<String> {
        let mut failing = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        failing.remove(&frame.0);
        failing.values().next_back().map(|cause| text_of(failing.len(), cause.clone()))
    }
}

fn text_of(count: usize, newest: String) -> String {
    if count < 2 { newest } else { format!("{count} frames cannot be stored; one of them: {newest}") }
}

/// The state of a frame that is announced.
enum FrameState {
    Stored(Box<StoredImage>),
    /// Its file had its name when a kill came, and is not recorded.
    Named {
        file: String,
        bytes: u64,
    },
    Not,
}

/// Stores every frame that the telescope's cameras announce.
pub async fn keep(store: Store) -> anyhow::Result<()> {
    let images = &store.node.config.folders.images;
    let telescope = store.node.config.address();
    folder::clear_parts(images, &telescope)
        .with_context(|| format!("cannot use the folder of images {}", images.display()))?;
    let frames = store.node.bus.subscribe::<Frame>(Topic::Frame.at(&telescope), Catch::All, WAITING).await?;
    let client = local_http::client_builder().connect_timeout(Duration::from_secs(5)).build()?;
    let (store, turns) = (Arc::new(store), Arc::new(Turns::default()));
    let disk = Arc::new(Semaphore::new(WRITTEN_AT_ONCE));
    let mut under_way: HashMap<CommandId, watch::Sender<Frame>> = HashMap::new();
    let mut tasks = JoinSet::new();
    loop {
        tokio::select! {
            received = frames.recv() => {
                let Key::Frame(camera) = received.key else { continue };
                let frame = received.sample.body;
                match under_way.get(&frame.id) {
                    // Announced again, perhaps with a new address.
                    Some(known) => { known.send_replace(frame); }
                    None => {
                        let (sender, newest) = watch::channel(frame.clone());
                        under_way.insert(frame.id, sender);
                        let ways = Ways { client: client.clone(), turns: turns.clone(), disk: disk.clone() };
                        tasks.spawn(store.clone().see_through(ways, camera, newest));
                    }
                }
            }
            Some(done) = tasks.join_next() => { under_way.remove(&done?); }
        }
    }
}

/// The parts that all frames share on their way.
struct Ways {
    client: reqwest::Client,
    turns: Arc<Turns>,
    /// Turns at the disk.
    disk: Arc<Semaphore>,
}

impl Store {
    /// Stores one frame, however long it takes, and asks the spool to release it.
    async fn see_through(self: Arc<Self>, ways: Ways, camera: Device, newest: watch::Receiver<Frame>) -> CommandId {
        let id = newest.borrow().id.clone();
        let mut failures = 0;
        loop {
            let frame = newest.borrow().clone();
            let Err(error) = self.store(&ways, &camera, frame).await else { break };
            failures += 1;
            tracing::debug!(frame = %id, error = format!("{error:#}"), failures, "a frame is not stored yet");
            if failures >= FAILURES_BEFORE_ALERT {
                let cause = format!("frame {id} of camera {} cannot be stored: {error:#}", camera.name);
                self.node.alerts.raise(AlertKind::ArchiveFrame, "", &self.failing.add(&id, cause));
            }
            tokio::time::sleep(wait(failures)).await;
        }
        match self.failing.remove(&id) {
            Some(cause) => self.node.alerts.raise(AlertKind::ArchiveFrame, "", &cause),
            None => self.node.alerts.clear(AlertKind::ArchiveFrame, ""),
        }
        let frame = newest.borrow().clone();
        self.release(&camera, &frame).await;
        id
    }

    async fn store(&self, ways: &Ways, camera: &Device, frame: Frame) -> anyhow::Result<()> {
        if let Some(known) = self.known(&frame).await? {
            let same = known.frame.sha256.eq_ignore_ascii_case(&frame.sha256);
            anyhow::ensure!(same, "frame {} is stored with other pixels than those announced now", frame.id);
            if known.frame.purpose != frame.purpose {
                // A frame that was found as a file alone, after a kill or in an older database, lacks what no header
                // has.
                self.database.commit(vec![Write::Announced(Box::new(frame))]).await?;
            }
            return Ok(());
        }
        let _turn = ways.turns.wait(&frame.url).await;
        let pixels = download::fetch(&ways.client, &frame).await?;
        ways.turns.proven(&frame.url);
        let _at_disk = ways.disk.acquire().await;
        let written = self.node.bus.clock().utc();
        let devices = pairing(&self.node.config, camera, &frame);
        let newest = |kind: Kind, property: &str| {
            let newest = || self.newest.value(devices.get(&kind)?, property);
            if kind == Kind::Camera { during(&frame, property, newest) } else { newest() }
        };
        let place = &self.node.config.place;
        let sensor = Sensor::of(&self.node.config, &frame);
        let cards = header::base(
            &self.node.header,
            &header::HeaderFacts { frame: &frame, place, written, sensor, newest: &newest },
        );
        let room = header::room(&self.node.header);
        let images = self.node.config.folders.images.clone();
        let parts = folder::parts(&images, &self.node.config.address());
        let part = parts.join(format!("{}.fits", part_name(&frame.id)));

        let (shape, part_path) = (Shape::of(&frame), part.clone());
        let compress = self.node.config.archive.compress && is_restored_whole(&shape, &pixels);
        let write = move || -> anyhow::Result<u64> {
            if is_taken(&part_path) {
                std::fs::remove_file(&part_path)?;
            }
            let mut fits =
                if compress { FitsFile::in_memory(&part_path, &shape) } else { FitsFile::create(&part_path, &shape) }?;
            for card in &cards {
                fits.set(card)?;
            }
            fits.reserve(room)?;
            fits.write_pixels(&shape, &pixels)?;
            fits.write_checksums()?;
            if compress {
                fits.compress_to(&part_path, shape.pixel)?
            } else {
                fits.close()?
            }
            let file = std::fs::OpenOptions::new().write(true).open(&part_path)?;
            file.sync_all()?;
            node::private::make_public_file(&part_path)?;
            Ok(file.metadata()?.len())
        };
        let bytes = tokio::task::spawn_blocking(write).await?.context("cannot write the file")?;

        let naming = self.naming.lock().await;
        let relative = self.namer.path(&frame, written);
        let relative = if compress { compressed(relative) } else { relative };
        let path = free_path(&images, &relative, written)?;
        let file = relative_text(&images, &path);
        self.database.commit(vec![Write::Writing { frame: frame.id.clone(), file: file.clone() }]).await?;
        let target = path.clone();
        // Another telescope's archive may have taken the name meanwhile: the next try takes another one.
        let rename = move || rename_to_free(&part, &target).and_then(|()| sync_folder(&target));
        tokio::task::spawn_blocking(rename).await?.with_context(|| format!("cannot name {}", path.display()))?;
        drop(naming);
        self.record(StoredImage { frame, file, bytes, stored: written }).await
    }

    /// The row of a frame that is stored already, also of one that was named just before a kill.
    async fn known(&self, frame: &Frame) -> anyhow::Result<Option<StoredImage>> {
        let (database, images) = (self.database.path().to_owned(), self.node.config.folders.images.clone());
        let (id, telescope) = (frame.id.clone(), self.node.config.place.telescope.clone());
        let look = move || -> anyhow::Result<FrameState> {
            let reader = Reader::open(&database, telescope.as_str())?;
            if let Some(image) = reader.image(&id)? {
                return Ok(FrameState::Stored(Box::new(image)));
            }
            let file = reader.writing(&id)?;
            let whole = file.and_then(|file| Some((length_if_whole(&images, &file, &id)?, file)));
            Ok(whole.map_or(FrameState::Not, |(bytes, file)| FrameState::Named { file, bytes }))
        };
        let found = match tokio::task::spawn_blocking(look).await?? {
            // A database that is older than the files does not know all of them.
            FrameState::Not => self
                .on_disk
                .find(frame, &self.node.config.folders.images)
                .await
                .map_or(FrameState::Not, |(file, bytes)| FrameState::Named { file, bytes }),
            found => found,
        };
        match found {
            FrameState::Stored(image) => Ok(Some(*image)),
            FrameState::Not => Ok(None),
            FrameState::Named { file, bytes } => {
                let stored = self.node.bus.clock().utc();
                let image = StoredImage { frame: frame.clone(), file, bytes, stored };
                self.record(image.clone()).await?;
                Ok(Some(image))
            }
        }
    }

    async fn record(&self, image: StoredImage) -> anyhow::Result<()> {
        let (frame, camera) = (image.frame.id.clone(), image.frame.camera.clone());
        let (file, bytes) = (image.file.clone(), image.bytes);
        // A row that was made from the file alone lacks fields of the announcement.
        let announced = Write::Announced(Box::new(image.frame.clone()));
        let path = image.path(&self.node.config.folders.images);
        self.database.commit(vec![Write::Stored(Box::new(image), path), announced]).await?;
        let count = self.count.fetch_add(1, Ordering::Relaxed) + 1;
        self.node.figure("frames_stored", Scalar::Int(count));
        tracing::info!(file, camera, "stored");
        self.incomplete.notify_one();
        self.stored.put(Stored { frame, camera, file, bytes, header_complete: false }).await?;
        Ok(())
    }

    /// Asks the spool to forget the frame, until it confirms.
    async fn release(&self, camera: &Device, frame: &Frame) {
        let release = camera::Command::Release { frame: frame.id.clone(), sha256: frame.sha256.clone() };
        let command = Command {
            id: CommandId::fresh(),
            from: self.node.signature(),
            token: None,
            boot_id: None,
            action: release,
        };
        for tries in 1..=RELEASE_TRIES {
            match self.node.bus.command(camera, &command, Duration::from_secs(3)).await {
                Ok(_) => return,
                Err(AskError::Refused { refusal, .. })
                    if matches!(refusal.reason, Reason::Malformed | Reason::NotImplemented | Reason::WrongState) =>
                {
                    tracing::warn!(frame = %frame.id, %refusal, "the spool does not release a frame that is stored");
                    return;
                }
                Err(error) => tracing::debug!(frame = %frame.id, %error, tries, "the spool is asked again"),
            }
            tokio::time::sleep(wait(tries)).await;
        }
        tracing::warn!(frame = %frame.id, "the spool never answered; it will announce the frame again");
    }
}

fn wait(failures: u32) -> Duration {
    FIRST_WAIT.saturating_mul(1 << failures.min(10).saturating_sub(1)).min(LONGEST_WAIT)
}

/// The id of a frame as a file name; ids come from the bus.
fn part_name(id: &CommandId) -> String {
    id.0.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).take(100).collect()
}

/// Length of a file, if it is the whole file of this frame.
fn length_if_whole(images: &Path, file: &str, id: &CommandId) -> Option<u64> {
    let path = images.join(file);
    without_links(images, &path).ok()?;
    let header = Header::read(&path).ok()??;
    (header.value("FRAMEID").as_deref() == Some(id.0.as_str())).then(|| std::fs::metadata(path).ok())?.map(|m| m.len())
}

/// The path of a file: its folders are made, and a name that is taken is changed.
fn free_path(images: &Path, relative: &Path, written: Utc) -> anyhow::Result<PathBuf> {
    let path = make_way(images, relative)
        .with_context(|| format!("cannot make the folder of {} in {}", relative.display(), images.display()))?;
    if !is_taken(&path) {
        return Ok(path);
    }
    let other = other_than(&path, written);
    tracing::warn!(taken = %path.display(), instead = %other.display(), "a file of this name exists");
    Ok(other)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two telescopes that share a folder of images may choose one name at the same moment.
    #[test]
    fn a_name_that_is_taken_between_looking_and_naming_keeps_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let (images, relative) = (folder.path(), Path::new("n/a.fits"));
        let part = images.join("part");
        std::fs::write(&part, "ours").unwrap();
        let first = free_path(images, relative, Utc::EPOCH).unwrap();
        std::fs::write(&first, "another's").unwrap();
        let refused = rename_to_free(&part, &first).unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::AlreadyExists);
        let second = free_path(images, relative, Utc::EPOCH).unwrap();
        assert_ne!(relative_text(images, &second), relative_text(images, &first));
        rename_to_free(&part, &second).unwrap();
        let content = |path: &Path| std::fs::read_to_string(path).unwrap();
        assert_eq!((content(&first).as_str(), content(&second).as_str()), ("another's", "ours"));
        assert!(!is_taken(&part));
    }
}
