//! One try to deliver a night: everything that is there already is read and proven, the rest is sent, and the manifest
//! comes last. It may be killed at any point and is then begun again.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, bail, ensure};
use config::{Delivery, Observatory};
use contract::CommandId;
use units::Utc;

use super::destination::Destination;
use super::hash::hash_file;
use super::item::{Item, taken};
use super::manifest::{Held, Manifest, ManifestFile};
use super::product::{Product, Products};
use super::record::{Record, SENT_FOLDER, clear_work, place_of, set_of, take_turn, work_folder};
use super::selection::Selected;
use crate::database::StoredImage;
use crate::night::Night;
use crate::reader::Reader;

/// Files that are sent and proven in one go, at most, and their bytes.
const BATCH: usize = 64;
const BATCH_BYTES: u64 = 1 << 30;
/// The same where they are copies, for which this disk needs room.
const COPIES: usize = 16;
const COPIES_BYTES: u64 = 256 << 20;
/// Faults that a report quotes; the others are counted.
const QUOTED: usize = 5;
/// Manifests of one night.
const MOST_MANIFESTS: u32 = 10_000;

/// What came of a try.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Delivered {
    /// Frames that the destination gets.
    pub frames: usize,
    /// Files that were sent now.
    pub sent: usize,
    /// Their bytes.
    pub sent_bytes: u64,
    /// Files that were there already, and were read.
    pub there: usize,
    /// Frames whose headers are not complete: they are not sent yet.
    pub incomplete: usize,
    /// The manifest's name; absent while frames lack.
    pub manifest: Option<String>,
    /// What was wrong, frame by frame; the others were delivered.
    pub faults: Vec<String>,
    /// What a person should know of frames that were delivered all the same: how many, and one of them.
    pub warnings: BTreeMap<String, (usize, String)>,
}

impl Delivered {
    fn warn(&mut self, file: &str, warnings: Vec<String>) {
        for warning in warnings {
            self.warnings.entry(warning).or_insert_with(|| (0, file.to_owned())).0 += 1;
        }
    }

    /// The warnings as lines.
    pub fn warning_lines(&self) -> Vec<String> {
        let line = |(warning, (count, file)): (&String, &(usize, String))| match count {
            1 => format!("warning: {file}: {warning}"),
            more => format!("warning: {file} and {} more: {warning}", more - 1),
        };
        self.warnings.iter().map(line).collect()
    }

    /// The faults in one text; nothing where there are none.
    pub fn fault(&self) -> Option<String> {
        let quoted = self.faults.iter().take(QUOTED).cloned().collect::<Vec<_>>().join("; ");
        match self.faults.len() {
            0 => None,
            few if few <= QUOTED => Some(quoted),
            many => Some(format!("{quoted}; and {} more", many - QUOTED)),
        }
    }
}

/// A frame with the name of its file at the destination, and what a manifest of before lists of it.
struct Planned<'a> {
    image: &'a StoredImage,
    name: String,
    listed: Option<&'a ManifestFile>,
}

/// Is what the destination has under a name known as ours? Then the content of the archive's file of which it was made.
fn known(listed: Option<&ManifestFile>, record: &Record, name: &str, sha256: &str) -> Option<Option<String>> {
    match listed.filter(|file| file.sha256 == sha256) {
        Some(file) => Some(Some(file.of_archive().to_owned())),
        None => record.sent(name, sha256).map(|of| of.map(str::to_owned)),
    }
}

/// A night on its way to a destination.
pub struct Run<'a> {
    /// The configuration of the telescope.
    pub config: &'a Observatory,
    /// The destination's section of it.
    pub delivery: &'a Delivery,
    /// The night.
    pub night: Night,
    /// The archive's database.
    pub database: &'a Path,
    /// Sky time, for the manifest.
    pub now: Utc,
}

/// The newest manifest of a night at a destination, with its number.
pub async fn newest_manifest(
    destination: &Arc<Destination>,
    config: &Observatory,
    night: &Night,
) -> anyhow::Result<Option<(u32, Manifest)>> {
    let mut newest = None;
    for number in 1..=MOST_MANIFESTS {
        let name = Manifest::name(config, night, number);
        let Some(bytes) = destination.read(&name).await? else { break };
        let manifest = serde_json::from_slice(&bytes)
            .with_context(|| format!("{name} at the destination is no manifest: move it away, and deliver again"))?;
        newest = Some((number, manifest));
    }
    Ok(newest)
}

impl Run<'_> {
    /// Delivers what can be delivered.
    ///
    /// # Errors
    /// The destination cannot be reached or used, or this archive cannot be read; faults of single files are in the report.
    pub async fn deliver(&self) -> anyhow::Result<Delivered> {
        let _turn = take_turn(self.config, self.delivery.name.as_str())?;
        clear_work(self.config, self.delivery.name.as_str());
        let (database, night, delivery) = (self.database.to_owned(), self.night, self.delivery.clone());
        let config = self.config.clone();
        let select = move || {
            let reader = Reader::open(&database, config.place.telescope.as_str())?;
            Selected::of(&reader, &night, &config, &delivery)
        };
        let selected = tokio::task::spawn_blocking(select).await??;
        let mut report =
            Delivered { frames: selected.images.len(), incomplete: selected.incomplete, ..Delivered::default() };
        if selected.images.is_empty() {
            return Ok(report);
        }
        let destination = Destination::open(self.config, self.delivery).await?;
        destination.check().await?;
        let mut record = Record::read(self.config, self.delivery.name.as_str(), &night)?;
        let before = newest_manifest(&destination, self.config, &night).await?;
        let products = Products::new(self.config, self.delivery, &night)?;
        let of_profile =
            before.as_ref().map(|(_, manifest)| manifest).filter(|found| found.is_of(self.delivery.profile));
        let planned = self.plan(&selected.images, &products, of_profile, &mut report).await?;
        let mut files = Vec::new();
        for batch in batches(&planned, products.are_copies()) {
            files.extend(self.batch(&destination, &mut record, batch, &products, &mut report).await?);
        }
        let is_whole = report.incomplete == 0 && report.faults.is_empty() && files.len() == report.frames;
        if is_whole {
            if let Some(manifest) = of_profile {
                files.extend(self.not_known_here(&destination, manifest, &selected, &mut report).await?);
            }
            destination.still_has(&files).await?;
            let name = self.write_manifest(&destination, before, files).await?;
            record.delivered(&name, report.frames, &set_of(selected.ids()), &place_of(self.delivery))?;
            report.manifest = Some(name);
        }
        Ok(report)
    }

    /// Sends and proves some files; returns the entries of those that are at the destination.
    async fn batch(
        &self,
        destination: &Arc<Destination>,
        record: &mut Record,
        planned: &[Planned<'_>],
        products: &Products,
        report: &mut Delivered,
    ) -> anyhow::Result<Vec<ManifestFile>> {
        let names: Vec<String> = planned.iter().map(|plan| plan.name.clone()).collect();
        let bytes = planned.iter().map(|plan| plan.image.bytes).sum();
        let mut holdings = destination.held(&names, bytes).await?;
        // Goes at the end of this batch, with the copies in it.
        let staging = if products.are_copies() { Some(products.staging()?) } else { None };
        let folder = staging.as_ref().map_or(Path::new(""), tempfile::TempDir::path);
        // A frame whose header is completed in a moment would be delivered with half of it.
        let incomplete = self.incomplete_ids().await?;
        let (mut to_send, mut of_archive) = (Vec::new(), HashMap::new());
        for Planned { image, name, listed } in planned {
            let held = holdings.get(name);
            if let Some(known) = held.and_then(|held| known(*listed, record, name, &held.sha256)) {
                // Also where the archive's file has left, or its header has changed since.
                report.there += 1;
                of_archive.extend(known.map(|sha256| (name.clone(), sha256)));
                continue;
            }
            if held.is_none() && incomplete.contains(&image.frame.id) {
                continue;
            }
            match (self.made(products, image, name, folder).await, held) {
                (Err(error), _) => report.faults.push(format!("{}: {error:#}", image.file)),
                (Ok(product), Some(held)) if held.sha256 != product.item.sha256 => report.faults.push(taken(name)),
                (Ok(product), held) => {
                    of_archive.insert(name.clone(), product.archive_sha256.clone());
                    match held {
                        Some(_) => report.there += 1,
                        None => to_send.push(product),
                    }
                    continue;
                }
            }
            holdings.remove(name);
        }
        if !to_send.is_empty() {
            self.send(destination, record, &to_send, &mut holdings, report).await?;
        }
        let entry = |Planned { image, name, .. }: &Planned<'_>| {
            let held = holdings.get(name)?;
            Some(ManifestFile::new(image, name, held, of_archive.get(name).map(String::as_str)))
        };
        Ok(planned.iter().filter_map(entry).collect())
    }

    /// What the manifest of before lists of frames that the archive does not select any more, and the destination still has:
    /// a database may be an older copy, and nothing leaves the list while it is there.
    async fn not_known_here(
        &self,
        destination: &Arc<Destination>,
        manifest: &Manifest,
        selected: &Selected,
        report: &mut Delivered,
    ) -> anyhow::Result<Vec<ManifestFile>> {
        let here: HashSet<&CommandId> = selected.ids().collect();
        let listed: Vec<&ManifestFile> = manifest.files.iter().filter(|file| !here.contains(&file.frame_id)).collect();
        let mut still_there = Vec::new();
        for batch in listed.chunks(BATCH) {
            let names: Vec<String> = batch.iter().map(|file| file.name.clone()).collect();
            let holdings = destination.held(&names, batch.iter().map(|file| file.bytes).sum()).await?;
            for file in batch {
                if holdings.get(&file.name).is_some_and(|held| held.sha256 == file.sha256) {
                    still_there.push((*file).clone());
                } else {
                    let lost =
                        "the manifest of before lists it, and neither the archive nor the destination has it now";
                    report.warn(&file.name, vec![lost.to_owned()]);
                }
            }
        }
        Ok(still_there)
    }

    /// The names of the frames' files. A frame that its profile refuses is a fault of the report, unless its header is
    /// still to be completed.
    async fn plan<'b>(
        &self,
        images: &'b [StoredImage],
        products: &Products,
        before: Option<&'b Manifest>,
        report: &mut Delivered,
    ) -> anyhow::Result<Vec<Planned<'b>>> {
        let (mut planned, mut names): (Vec<Planned<'b>>, HashMap<String, &str>) = (Vec::new(), HashMap::new());
        let listed = |image: &StoredImage| before.and_then(|manifest| manifest.file_of(&image.frame.id));
        let to_plan: Vec<StoredImage> = images.iter().filter(|image| listed(image).is_none()).cloned().collect();
        let plans = products.clone();
        let work = move || to_plan.iter().map(|image| plans.plan(image)).collect::<Vec<_>>();
        let mut plans = tokio::task::spawn_blocking(work).await?.into_iter();
        let incomplete = self.incomplete_ids().await?;
        for image in images {
            let listed = listed(image);
            let name = if let Some(file) = listed {
                file.name.clone()
            } else {
                // There is a plan for each frame that is not listed.
                match plans.next() {
                    Some(Ok(plan)) => {
                        report.warn(&image.file, plan.warnings);
                        plan.name
                    }
                    Some(Err(error)) if !incomplete.contains(&image.frame.id) => {
                        report.faults.push(format!("{}: {error:#}", image.file));
                        continue;
                    }
                    _ => continue,
                }
            };
            match names.insert(name.clone(), &image.file) {
                None => planned.push(Planned { image, name, listed }),
                Some(other) => report.faults.push(format!("{}: it would have the name of {other}, {name}", image.file)),
            }
        }
        Ok(planned)
    }

    async fn made(
        &self,
        products: &Products,
        image: &StoredImage,
        name: &str,
        folder: &Path,
    ) -> anyhow::Result<Product> {
        let (products, image, name, folder) = (products.clone(), image.clone(), name.to_owned(), folder.to_owned());
        tokio::task::spawn_blocking(move || products.make(&image, &name, &folder)).await?
    }

    async fn incomplete_ids(&self) -> anyhow::Result<HashSet<CommandId>> {
        let database = self.database.to_owned();
        let telescope = self.config.place.telescope.clone();
        let look = move || Reader::open(&database, telescope.as_str())?.incomplete(u32::MAX);
        let incomplete = tokio::task::spawn_blocking(look).await??;
        Ok(incomplete.into_iter().map(|image| image.frame.id).collect())
    }

    /// Sends files to names that are free, and proves them.
    async fn send(
        &self,
        destination: &Arc<Destination>,
        record: &mut Record,
        products: &[Product],
        holdings: &mut HashMap<String, Held>,
        report: &mut Delivered,
    ) -> anyhow::Result<()> {
        let lines = products.iter().map(|Product { item, archive_sha256 }| {
            [item.name.as_str(), item.sha256.as_str(), archive_sha256.as_str()]
        });
        record.sending(lines)?;
        let items: Vec<Item> = products.iter().map(|product| product.item.clone()).collect();
        let arrived = destination.send(&items).await?;
        for item in &items {
            match arrived.get(&item.name) {
                Some(held) if held.sha256 == item.sha256 => {
                    holdings.insert(item.name.clone(), held.clone());
                    report.sent += 1;
                    report.sent_bytes += item.bytes;
                }
                found => {
                    let fault = self.differs(destination, item, found).await;
                    report.faults.push(format!("{}: {fault}", item.name));
                }
            }
        }
        Ok(())
    }

    /// What is wrong with a file that was sent and is not there as it was sent. It is taken away again, since nothing had
    /// its name before.
    async fn differs(&self, destination: &Arc<Destination>, item: &Item, found: Option<&Held>) -> String {
        let Some(found) = found else {
            return "the destination took it without an error, and does not have it: look at the destination"
                .to_owned();
        };
        let (file, sent) = (item.file.clone(), item.sha256.clone());
        let again = tokio::task::spawn_blocking(move || hash_file(&file)).await;
        let is_changed = matches!(again, Ok(Ok(held)) if held.sha256 != sent);
        let removed = match destination.discard(&item.name).await {
            Ok(()) => String::new(),
            Err(error) => format!("; {error:#}"),
        };
        if is_changed {
            return format!("its header was changed while it was sent; it is sent again{removed}");
        }
        format!(
            "the destination took it without an error, and gives back other bytes ({} of {}, sha256 {} in place of {}): \
             look at the destination, its disk and its network{removed}",
            found.bytes,
            item.bytes,
            short(&found.sha256),
            short(&item.sha256)
        )
    }

    /// Writes the manifest, unless the newest one lists just these files; returns its name.
    async fn write_manifest(
        &self,
        destination: &Arc<Destination>,
        before: Option<(u32, Manifest)>,
        files: Vec<ManifestFile>,
    ) -> anyhow::Result<String> {
        let number = match &before {
            Some((number, manifest))
                if manifest.is_of(self.delivery.profile) && lists_the_same(&manifest.files, &files) =>
            {
                return Ok(Manifest::name(self.config, &self.night, *number));
            }
            Some((number, _)) => number + 1,
            None => 1,
        };
        ensure!(number <= MOST_MANIFESTS, "the night has {MOST_MANIFESTS} manifests: move some away");
        let name = Manifest::name(self.config, &self.night, number);
        let about = (self.delivery.name.as_str(), self.delivery.profile);
        let manifest = Manifest::new(self.config, &self.night, about, self.now, files);
        let mut text = serde_json::to_vec_pretty(&manifest)?;
        text.push(b'\n');
        let work = work_folder(self.config, self.delivery.name.as_str());
        let write = move || -> std::io::Result<(tempfile::TempDir, Held)> {
            let folder = tempfile::Builder::new().prefix(SENT_FOLDER).tempdir_in(work)?;
            let path = folder.path().join("manifest.json");
            std::fs::write(&path, text)?;
            node::private::make_public_file(&path)?;
            let held = hash_file(&path)?;
            Ok((folder, held))
        };
        let (folder, Held { bytes, sha256 }) = tokio::task::spawn_blocking(write).await??;
        let item = Item { file: folder.path().join("manifest.json"), name: name.clone(), bytes, sha256 };
        let arrived = destination.send(std::slice::from_ref(&item)).await?;
        if arrived.get(&name).is_none_or(|held| held.sha256 != item.sha256) {
            let fault = self.differs(destination, &item, arrived.get(&name)).await;
            bail!("{name}: {fault}");
        }
        Ok(name)
    }
}

fn lists_the_same(one: &[ManifestFile], other: &[ManifestFile]) -> bool {
    let contents = |files: &[ManifestFile]| -> std::collections::BTreeSet<(String, String)> {
        files.iter().map(|file| (file.name.clone(), file.sha256.clone())).collect()
    };
    contents(one) == contents(other)
}

fn short(sha256: &str) -> &str {
    sha256.get(..12).unwrap_or(sha256)
}

/// Pieces of a night that are sent and proven together.
fn batches<'a, 'b>(planned: &'a [Planned<'b>], are_copies: bool) -> Vec<&'a [Planned<'b>]> {
    let (most, most_bytes) = if are_copies { (COPIES, COPIES_BYTES) } else { (BATCH, BATCH_BYTES) };
    let (mut found, mut from, mut bytes) = (Vec::new(), 0, 0);
    for (index, plan) in planned.iter().enumerate() {
        if index > from && (index - from >= most || bytes + plan.image.bytes > most_bytes) {
            found.push(&planned[from..index]);
            (from, bytes) = (index, 0);
        }
        bytes += plan.image.bytes;
    }
    if from < planned.len() {
        found.push(&planned[from..]);
    }
    found
}
