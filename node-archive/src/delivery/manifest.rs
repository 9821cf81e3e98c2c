//! The manifest of a delivered night: what was handed over, with the hash of each file. It is written last, so a night
//! with a manifest is whole.

use config::Observatory;
use contract::CommandId;
use fits::profile::ProfileName;
use serde::{Deserialize, Serialize};
use units::Utc;

use crate::database::StoredImage;
use crate::night::Night;

/// What every manifest calls its format.
pub const FORMAT: &str = "starmesh-night-manifest-1";

/// The manifest of a night.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// The site.
    pub site: String,
    /// The telescope.
    pub telescope: String,
    /// The date of the night's evening, `YYYYMMDD`.
    pub night: String,
    /// Local mean noon at which the night begins.
    pub from_utc: Utc,
    /// Local mean noon at which it ends.
    pub to_utc: Utc,
    /// The program that delivered it.
    pub software: String,
    /// The destination, as the configuration calls it.
    pub destination: String,
    /// The profile by which the files were made; absent for the archive's own files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<String>,
    /// Sky time at which it was written.
    pub written_utc: Utc,
    /// The frames, in the order of their exposures.
    pub files: Vec<ManifestFile>,
}

/// A file of a manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ManifestFile {
    /// Where it is, relative to the folder of the destination, with `/`.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 of what was read back from the destination.
    pub sha256: String,
    /// The archive's own file, relative to its folder of images.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub archive_file: String,
    /// SHA-256 of that file when the copy was made of it; absent where it is the file itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archive_sha256: Option<String>,
    /// The id of the frame, `FRAMEID` in its header.
    pub frame_id: CommandId,
    /// The camera.
    pub camera: String,
    /// `light`, `bias`, `dark` or `flat`.
    pub image_type: String,
    /// The type of the action that took it.
    pub action: String,
    /// The target, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// The filter, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// When the exposure began.
    pub started_utc: Utc,
    /// The exposure time.
    pub exposure_s: f64,
    /// When the archive stored it.
    pub stored_utc: Utc,
}

impl ManifestFile {
    /// The entry of a frame that the destination has under this name, made of this content of the archive's file.
    pub fn new(image: &StoredImage, name: &str, held: &Held, archive_sha256: Option<&str>) -> Self {
        let (frame, purpose) = (&image.frame, &image.frame.purpose);
        Self {
            name: name.to_owned(),
            bytes: held.bytes,
            sha256: held.sha256.clone(),
            archive_file: image.file.clone(),
            archive_sha256: archive_sha256.filter(|sha256| *sha256 != held.sha256).map(str::to_owned),
            frame_id: frame.id.clone(),
            camera: frame.camera.clone(),
            image_type: purpose.image_type.clone(),
            action: purpose.action.clone(),
            object: purpose.object.clone(),
            filter: purpose.filter.clone(),
            started_utc: frame.started_utc,
            exposure_s: frame.exposure_s,
            stored_utc: image.stored,
        }
    }
}

impl ManifestFile {
    /// SHA-256 of the archive's file when it was delivered.
    pub fn of_archive(&self) -> &str {
        self.archive_sha256.as_deref().unwrap_or(&self.sha256)
    }
}

/// How a manifest names a profile.
fn profile_text(profile: ProfileName) -> Option<String> {
    (profile != ProfileName::Astra).then(|| profile.to_string())
}

impl Manifest {
    /// The manifest of a night.
    pub fn new(
        config: &Observatory,
        night: &Night,
        (destination, profile): (&str, ProfileName),
        written_utc: Utc,
        files: Vec<ManifestFile>,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            site: config.place.site.to_string(),
            telescope: config.place.telescope.to_string(),
            night: night.date.to_string(),
            from_utc: night.from,
            to_utc: night.to,
            software: concat!("starmesh ", env!("CARGO_PKG_VERSION")).to_owned(),
            destination: destination.to_owned(),
            profile: profile_text(profile),
            written_utc,
            files,
        }
    }

    /// Where the manifest of a night is: the first one, the second one, and so on. Frames that came after a manifest was
    /// written make another one, which lists all of them.
    pub fn name(config: &Observatory, night: &Night, number: u32) -> String {
        let (site, telescope) = (&config.place.site, &config.place.telescope);
        let number = if number == 1 { String::new() } else { format!("-{number}") };
        format!("{site}/{telescope}/{}.manifest{number}.json", night.date)
    }

    /// Are its files made by this profile?
    pub fn is_of(&self, profile: ProfileName) -> bool {
        self.profile == profile_text(profile)
    }

    /// The entry of a frame.
    pub fn file_of(&self, frame: &CommandId) -> Option<&ManifestFile> {
        self.files.iter().find(|file| file.frame_id == *frame)
    }
}

impl Held {
    /// What has a name and is no file: it has no content that a file could have.
    pub const fn foreign() -> Self {
        Self { bytes: 0, sha256: String::new() }
    }
}

/// A file as it was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Held {
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256, hexadecimal.
    pub sha256: String,
}
