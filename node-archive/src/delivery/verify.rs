//! Reads a delivered night again, and compares it with its manifest and with the archive.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use config::{Delivery, Observatory};

use super::destination::Destination;
use super::hash::hash_file;
use super::manifest::{Manifest, ManifestFile};
use super::run::newest_manifest;
use super::selection::Selected;
use crate::night::Night;
use crate::reader::Reader;

/// Files that are read in one go, at most, and their bytes: a daemon's are copied here for that.
const BATCH: usize = 64;
const BATCH_BYTES: u64 = 1 << 30;

/// What a reading of a delivered night showed.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Verified {
    /// The manifest's name, where there is one.
    pub manifest: Option<String>,
    /// Files of the manifest that are there with its bytes.
    pub good: Vec<ManifestFile>,
    /// Files of the manifest that are not there, or with other bytes.
    pub faults: Vec<String>,
    /// Frames of the archive that the manifest does not list.
    pub missing: Vec<String>,
    /// Files of the archive that are as they were when they were delivered.
    pub same_here: usize,
    /// Files whose headers have changed in the archive since they were delivered.
    pub newer_here: Vec<String>,
    /// Files that are no longer in the archive's folder.
    pub gone_here: usize,
}

impl Verified {
    /// Is everything that the archive has of the night at the destination, as the manifest says?
    pub fn is_whole(&self) -> bool {
        self.manifest.is_some() && self.faults.is_empty() && self.missing.is_empty()
    }
}

/// Reads everything that the newest manifest of a night lists.
///
/// # Errors
/// The destination or the archive cannot be read.
pub async fn verify(
    config: &Observatory,
    delivery: &Delivery,
    night: &Night,
    database: &Path,
) -> anyhow::Result<Verified> {
    let (file, site, selection, of) = (database.to_owned(), config.clone(), delivery.clone(), *night);
    let select = move || {
        let reader = Reader::open(&file, site.place.telescope.as_str())?;
        Selected::of(&reader, &of, &site, &selection)
    };
    let selected = tokio::task::spawn_blocking(select).await??;
    let destination = Destination::open(config, delivery).await?;
    destination.check().await?;
    let mut verified = Verified::default();
    let Some((number, manifest)) = newest_manifest(&destination, config, night).await? else {
        verified.missing = selected.images.iter().map(|image| image.file.clone()).collect();
        return Ok(verified);
    };
    verified.manifest = Some(Manifest::name(config, night, number));
    if !manifest.is_of(delivery.profile) {
        let of = manifest.profile.as_deref().unwrap_or("astra");
        verified
            .faults
            .push(format!("the manifest is of profile {of}, not {}: deliver the night again", delivery.profile));
    }
    for files in pieces(&manifest.files) {
        read_again(&destination, files, &mut verified).await?;
    }
    let listed: HashSet<_> = manifest.files.iter().map(|file| &file.frame_id).collect();
    let (here, missing): (Vec<_>, Vec<_>) = selected.images.iter().partition(|image| listed.contains(&image.frame.id));
    verified.missing = missing.into_iter().map(|image| image.file.clone()).collect();
    for image in here {
        let (path, known) = (image.path(&config.folders.images), manifest.file_of(&image.frame.id));
        match tokio::task::spawn_blocking(move || hash_file(&path)).await? {
            Ok(held) if known.is_some_and(|file| file.of_archive() == held.sha256) => verified.same_here += 1,
            Ok(_) => verified.newer_here.push(image.file.clone()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => verified.gone_here += 1,
            Err(error) => return Err(error).with_context(|| format!("cannot read {}", image.file)),
        }
    }
    Ok(verified)
}

/// A list of files in pieces that are read in one go.
pub(super) fn pieces(files: &[ManifestFile]) -> impl Iterator<Item = &[ManifestFile]> {
    let (mut count, mut bytes) = (0, 0);
    files.chunk_by(move |_, next| {
        count += 1;
        bytes += next.bytes;
        let fits = count < BATCH && bytes <= BATCH_BYTES;
        if !fits {
            (count, bytes) = (0, next.bytes);
        }
        fits
    })
}

async fn read_again(
    destination: &Arc<Destination>,
    files: &[ManifestFile],
    verified: &mut Verified,
) -> anyhow::Result<()> {
    let names: Vec<String> = files.iter().map(|file| file.name.clone()).collect();
    let holdings = destination.held(&names, files.iter().map(|file| file.bytes).sum()).await?;
    for file in files {
        match holdings.get(&file.name) {
            Some(held) if held.sha256 == file.sha256 && held.bytes == file.bytes => verified.good.push(file.clone()),
            Some(held) => verified.faults.push(format!(
                "{}: {} bytes that are not those that were delivered ({} bytes); it was changed there",
                file.name, held.bytes, file.bytes
            )),
            None => verified.faults.push(format!("{}: it is not there any more", file.name)),
        }
    }
    Ok(())
}
