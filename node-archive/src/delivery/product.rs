//! The files that a destination gets: the archive's own ones, or the copies that a profile makes of them.
//!
//! Copies are in a folder of one try, for the few frames that are sent in one go, and leave with it. The same frame gives
//! the same bytes, so that what an earlier try sent is known.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use config::{Delivery, Observatory};
use fits::profile::{CopyPlan, Profile, ProfileName, deliver_copy, plan_copy};

use super::hash::hash_file;
use super::item::Item;
use super::manifest::Held;
use super::record::{SENT_FOLDER, work_folder};
use crate::database::StoredImage;
use crate::folder::without_links;
use crate::night::Night;

/// Keywords of the programme: a destination's own one counts for frames that have none.
const PROGRAMME: [&str; 2] = ["PROPID", "PROGID"];

/// How the files of a destination are made.
#[derive(Debug, Clone)]
pub struct Products {
    /// Absent for the archive's own files.
    profile: Option<Profile>,
    values: Vec<(String, String)>,
    images: PathBuf,
    /// Where copies are made.
    work: PathBuf,
    telescope: String,
    night: String,
}

/// A file that can be sent, and of which content of the archive's file it was made.
#[derive(Debug, Clone)]
pub struct Product {
    /// The file here, and its name there.
    pub item: Item,
    /// SHA-256 of the archive's own file.
    pub archive_sha256: String,
}

impl Products {
    /// Those of a destination.
    ///
    /// # Errors
    /// The profile has a fault.
    pub fn new(config: &Observatory, delivery: &Delivery, night: &Night) -> anyhow::Result<Self> {
        let has_own = delivery.profile == ProfileName::Astra;
        Ok(Self {
            profile: if has_own { None } else { Some(Profile::load(delivery.profile)?) },
            values: delivery.set.clone().into_iter().collect(),
            images: config.folders.images.clone(),
            work: work_folder(config, delivery.name.as_str()),
            telescope: format!("{}/{}", config.place.site, config.place.telescope),
            night: night.date.to_string(),
        })
    }

    /// Are the files copies, which need room here while they are sent?
    pub fn are_copies(&self) -> bool {
        self.profile.is_some()
    }

    /// A folder for copies, which goes with what is returned, or by the next try.
    pub fn staging(&self) -> anyhow::Result<tempfile::TempDir> {
        let made = node::private::make_folder(&self.work)
            .and_then(|()| tempfile::Builder::new().prefix(SENT_FOLDER).tempdir_in(&self.work));
        made.with_context(|| format!("cannot make a folder for copies in {}", self.work.display()))
    }

    /// The name that a frame's file gets, relative to the destination's folder, and what a person should know of it. Blocks.
    ///
    /// # Errors
    /// The file cannot be read, or the profile refuses it.
    pub fn plan(&self, image: &StoredImage) -> anyhow::Result<CopyPlan> {
        let telescope = &self.telescope;
        let Some(profile) = &self.profile else {
            return Ok(CopyPlan { name: format!("{telescope}/{}", image.file), warnings: Vec::new() });
        };
        let CopyPlan { name, warnings } = plan_copy(&self.path_of(image)?, profile, &self.values_of(image))?;
        Ok(CopyPlan { name: format!("{telescope}/{}/{name}", self.night), warnings })
    }

    /// Makes a frame's file for a name that [`Self::plan`] gave. Blocks.
    ///
    /// # Errors
    /// The file cannot be read or copied, or its header was changed meanwhile.
    pub fn make(&self, image: &StoredImage, name: &str, staging: &Path) -> anyhow::Result<Product> {
        let path = self.path_of(image)?;
        let cannot = || format!("cannot read {}", path.display());
        let here = hash_file(&path).with_context(cannot)?;
        let (file, held) = match &self.profile {
            None => (path.clone(), here.clone()),
            Some(profile) => {
                let copy = deliver_copy(&path, staging, profile, &self.values_of(image))?.path;
                let held = hash_file(&copy).with_context(|| format!("cannot read {}", copy.display()))?;
                let again = hash_file(&path).with_context(cannot)?;
                ensure!(here == again, "{}: its header was changed while it was copied; it is tried again", image.file);
                (copy, held)
            }
        };
        let Held { bytes, sha256 } = held;
        Ok(Product { item: Item { file, name: name.to_owned(), bytes, sha256 }, archive_sha256: here.sha256 })
    }

    fn path_of(&self, image: &StoredImage) -> anyhow::Result<PathBuf> {
        let path = image.path(&self.images);
        without_links(&self.images, &path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(path)
    }

    fn values_of(&self, image: &StoredImage) -> Vec<(String, String)> {
        let has_programme = image.frame.purpose.programme.is_some();
        let counts = |keyword: &str| !(has_programme && PROGRAMME.contains(&keyword));
        self.values.iter().filter(|(keyword, _)| counts(keyword)).cloned().collect()
    }
}
