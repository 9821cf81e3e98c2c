//! Files of old nights leave the folder of images, once every destination that gets them has them.
//!
//! Each destination is read again just before, every file. A file stays when any destination does not have its bytes, when the
//! archive's own file has changed since, and when no destination on another disk has it. Before a file goes it gets another
//! name, and every destination is asked once more: a destination that only leads back to the folder of images does not
//! have it then, and the file gets its name back. Where the folder of a night is not there, its disk may be away: nothing
//! is removed then, and nothing counts as removed.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use config::{Delivery, Observatory};
use contract::CommandId;
use units::Utc;

use super::destination::Destination;
use super::hash::hash_file;
use super::manifest::ManifestFile;
use super::record::{DeliveryTurn, Record, set_of, take_turn};
use super::selection::Wanted;
use super::verify::verify;
use crate::folder::{all_here, is_taken, without_links};
use crate::night::{Night, NightFrame};
use crate::reader::Reader;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;
/// The record of removals is that of a destination of this name, which no name of a site can be.
const REMOVALS: &str = ".removals";
/// The name of a file that is about to go ends so.
const LEAVING: &str = ".leaving";
/// Files that are about to go at a time.
const BATCH: usize = 64;

/// What was removed.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Removed {
    /// Files.
    pub files: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Files of the night that stay.
    pub staying: usize,
}

/// The nights that are old enough and whose files may still be there.
pub async fn nights(config: &Observatory, database: &Path, now: Utc, days: u32) -> anyhow::Result<Vec<Night>> {
    let (config, database) = (config.clone(), database.to_owned());
    let look = move || -> anyhow::Result<Vec<Night>> {
        let reader = Reader::open(&database, config.place.telescope.as_str())?;
        let Some((oldest, newest)) = reader.span_of_frames()? else { return Ok(Vec::new()) };
        let (mut night, mut found) = (Night::at(oldest, &config.place), Vec::new());
        while night.from <= newest && now.seconds_since(night.to) >= f64::from(days) * DAY_S {
            let frames = reader.frames(night.from, night.to)?;
            let set = set_of(frames.iter().map(|frame| &frame.image.frame.id));
            if !frames.is_empty() && !Record::read(&config, REMOVALS, &night)?.is_removed(&set) {
                found.push(night);
            }
            night = Night::new(night.date.next(), &config.place);
        }
        Ok(found)
    };
    tokio::task::spawn_blocking(look).await?
}

/// A destination that has what it gets of a night.
struct Proven<'a> {
    delivery: &'a Delivery,
    wanted: Wanted<'a>,
    destination: Arc<Destination>,
    is_elsewhere: bool,
    files: HashMap<CommandId, ManifestFile>,
    _turn: DeliveryTurn,
}

/// A file that every destination has.
struct Leaving {
    path: PathBuf,
    /// The hashes that it had when it was delivered.
    archive_sha256: Vec<String>,
    /// What each destination has of it, by its place among them.
    there: Vec<(usize, ManifestFile)>,
}

/// Removes the files of a night that every destination has.
///
/// # Errors
/// The folder of the night is not there, a destination cannot be read, or it does not have what its manifest lists: nothing
/// is removed then.
pub async fn remove(config: &Observatory, night: &Night, database: &Path) -> anyhow::Result<Removed> {
    let (file, of, telescope) = (database.to_owned(), *night, config.place.telescope.clone());
    let frames = move || Reader::open(&file, telescope.as_str())?.frames(of.from, of.to);
    let frames: Vec<NightFrame> = tokio::task::spawn_blocking(frames).await??;
    // Telescopes that share a database each remove what their own cameras took.
    let is_own = |frame: &&NightFrame| {
        let camera = &frame.image.frame.camera;
        config.camera.is_empty() || config.camera.iter().any(|own| own.common.name.as_str() == camera)
    };
    let paths = frames.iter().filter(is_own).map(|frame| frame.image.path(&config.folders.images));
    let folders: BTreeSet<PathBuf> = paths.filter_map(|path| path.parent().map(Path::to_owned)).collect();
    let are_here = || all_here(&config.folders.images, folders.iter().map(PathBuf::as_path));
    are_here()?;
    for frame in &frames {
        // A kill between the two names leaves the other one.
        let path = frame.image.path(&config.folders.images);
        if without_links(&config.folders.images, &path).is_ok() {
            give_back(&path)?;
        }
    }
    let mut reached = Vec::new();
    for delivery in &config.delivery {
        let wanted = Wanted::new(config, delivery)?;
        if frames.iter().any(|frame| wanted.takes(frame)) {
            let destination = Destination::open(config, delivery).await?;
            destination.check().await.with_context(|| format!("{} cannot be read", delivery.name))?;
            let is_elsewhere = !destination.is_on_disk_of(&config.folders.images).await?;
            reached.push((delivery, wanted, destination, is_elsewhere));
        }
    }
    if !reached.iter().any(|(.., is_elsewhere)| *is_elsewhere) {
        return Ok(Removed { staying: frames.len(), ..Removed::default() });
    }
    let mut proven = Vec::new();
    for (delivery, wanted, destination, is_elsewhere) in reached {
        let turn = take_turn(config, delivery.name.as_str())?;
        let verified = verify(config, delivery, night, database).await?;
        if !verified.is_whole() {
            let lacking = verified.faults.iter().chain(&verified.missing).next().cloned().unwrap_or_default();
            let lacking = verified.manifest.map_or_else(|| "it has no manifest".to_owned(), |_| lacking);
            bail!("{} does not have night {} whole: {lacking}", delivery.name, night.date);
        }
        let files = verified.good.into_iter().map(|file| (file.frame_id.clone(), file)).collect();
        proven.push(Proven { delivery, wanted, destination, is_elsewhere, files, _turn: turn });
    }
    let mut removed = Removed::default();
    let leaving: Vec<Leaving> =
        frames.iter().filter(is_own).filter_map(|frame| leaving(config, frame, &proven)).collect();
    removed.staying = frames.len() - leaving.len();
    for batch in leaving.chunks(BATCH) {
        let mut hidden = Hidden::default();
        removed.staying += hidden.hide(&config.folders.images, batch)?;
        still_there(batch, &proven).await?;
        hidden.remove(&mut removed)?;
    }
    // The disk may have gone meanwhile.
    are_here()?;
    // What stays now stays: no destination asks for it, or its header has changed. The night is not read again for it.
    let set = set_of(frames.iter().map(|frame| &frame.image.frame.id));
    Record::read(config, REMOVALS, night)?.removed(&set)?;
    Ok(removed)
}

/// A frame whose file may go; absent where it stays.
fn leaving(config: &Observatory, frame: &NightFrame, proven: &[Proven<'_>]) -> Option<Leaving> {
    let wanting = proven.iter().enumerate().filter(|(_, proven)| proven.wanted.takes(frame));
    let mut is_elsewhere = false;
    let mut there = Vec::new();
    for (place, proven) in wanting {
        there.push((place, proven.files.get(&frame.image.frame.id)?.clone()));
        is_elsewhere |= proven.is_elsewhere;
    }
    let archive_sha256 = there.iter().map(|(_, file)| file.of_archive().to_owned()).collect();
    let path = frame.image.path(&config.folders.images);
    (is_elsewhere && frame.is_complete).then_some(Leaving { path, archive_sha256, there })
}

/// Files with other names, and their sizes; they get their own back when this goes before they are removed.
#[derive(Default)]
struct Hidden(Vec<(PathBuf, u64)>);

impl Hidden {
    /// Gives other names to the files of a batch that have not changed since they were delivered; returns how many have.
    fn hide(&mut self, images: &Path, batch: &[Leaving]) -> anyhow::Result<usize> {
        let mut changed = 0;
        for Leaving { path, archive_sha256, .. } in batch {
            let cannot = || format!("cannot remove {}", path.display());
            if !is_taken(path) {
                continue;
            }
            without_links(images, path).with_context(cannot)?;
            let held = hash_file(path).with_context(cannot)?;
            if archive_sha256.iter().any(|sha256| *sha256 != held.sha256) {
                changed += 1;
                continue;
            }
            std::fs::rename(path, leaving_name(path)).with_context(cannot)?;
            self.0.push((path.clone(), held.bytes));
        }
        Ok(changed)
    }

    fn remove(mut self, removed: &mut Removed) -> anyhow::Result<()> {
        while let Some((path, bytes)) = self.0.pop() {
            let away = leaving_name(&path);
            std::fs::remove_file(&away).with_context(|| format!("cannot remove {}", away.display()))?;
            removed.files += 1;
            removed.bytes += bytes;
        }
        Ok(())
    }
}

impl Drop for Hidden {
    fn drop(&mut self) {
        for (path, _) in &self.0 {
            if let Err(error) = give_back(path) {
                tracing::error!(
                    error = format!("{error:#}"),
                    "a file of the archive has another name; it is renamed again later"
                );
            }
        }
    }
}

/// Asks every destination once more for the files of a batch, which have other names here now.
async fn still_there(batch: &[Leaving], proven: &[Proven<'_>]) -> anyhow::Result<()> {
    for (place, Proven { delivery, destination, .. }) in proven.iter().enumerate() {
        let files = batch.iter().flat_map(|file| &file.there).filter(|(of, _)| *of == place).map(|(_, file)| file);
        let files: Vec<&ManifestFile> = files.collect();
        let names: Vec<String> = files.iter().map(|file| file.name.clone()).collect();
        let holdings = destination.held(&names, files.iter().map(|file| file.bytes).sum()).await?;
        for file in files {
            if holdings.get(&file.name).is_none_or(|held| held.sha256 != file.sha256) {
                bail!(
                    "{} has no copy of its own of {}: its folder leads back to the folder of images. Name another place",
                    delivery.name,
                    file.name
                );
            }
        }
    }
    Ok(())
}

fn leaving_name(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(LEAVING);
    name.into()
}

/// Gives a file its name back, where it has the other one and nothing has its own.
fn give_back(path: &Path) -> anyhow::Result<()> {
    let away = leaving_name(path);
    if is_taken(&away) && !is_taken(path) {
        std::fs::rename(&away, path).with_context(|| format!("cannot rename {} back", away.display()))?;
    }
    Ok(())
}
