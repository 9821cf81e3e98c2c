//! Nights of a real database and real files, delivered to real folders.

use std::fs;
use std::path::{Path, PathBuf};

use bus::Clock;
use config::Observatory;
use contract::CommandId;
use contract::device::camera::{Frame, Purpose};
use node::NodeAlerts;
use units::Utc;

use super::hash::hash_file;
use super::manifest::Manifest;
use super::removal;
use super::run::{Delivered, Run};
use super::verify::verify;
use crate::database::{Database, StoredImage, Write};
use crate::folder::PART_FOLDER;
use crate::night::Night;

mod attacks;
mod profiles;
mod stores;

const PLACE: &str = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6\n\
    longitude_deg = -70.4\nelevation_m = 2500\n[archive]\nremove_delivered_after_days = 1\n";

/// A site with an archive in a folder of its own.
struct Site {
    folder: tempfile::TempDir,
    config: Observatory,
}

impl Site {
    /// With these destinations.
    fn new(destinations: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = config::parse(&format!("{PLACE}{destinations}"), folder.path()).unwrap();
        fs::create_dir_all(config.folders.images.join(PART_FOLDER)).unwrap();
        Self { folder, config }
    }

    /// With a folder `there`, which exists.
    fn with_folder() -> Self {
        let site = Self::new("[[delivery]]\nname = \"share\"\ndirectory = \"there\"\n");
        fs::create_dir_all(site.path("there")).unwrap();
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn there(&self, name: &str) -> PathBuf {
        self.path("there").join("paranal/callisto").join(name)
    }

    fn image(&self, name: &str) -> PathBuf {
        self.config.folders.images.join(name)
    }

    fn night(&self) -> Night {
        Night::at(at(0), &self.config.place)
    }

    /// Stores frames with files of a megabyte, complete or not.
    async fn store(&self, frames: &[(u32, &str)], complete: bool) {
        self.store_with(frames, complete, |_| {}).await;
    }

    async fn store_with(&self, frames: &[(u32, &str)], complete: bool, change: impl Fn(&mut Frame)) {
        let mut writes = Vec::new();
        for (number, kind) in frames {
            let (id, file) = (CommandId(format!("frame-{number}")), format!("20261121/f{number}.fits"));
            let path = self.image(&file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, vec![*number as u8; 1_000_000 + *number as usize]).unwrap();
            let mut frame = Frame {
                camera: "main".to_owned(),
                purpose: Purpose { image_type: (*kind).to_owned(), action: "object".to_owned(), ..Purpose::default() },
                started_utc: at(i64::from(*number)),
                exposure_s: 1.0,
                sha256: "ab".to_owned(),
                ..test_support::frame(&id.0)
            };
            change(&mut frame);
            let bytes = fs::metadata(&path).unwrap().len();
            let stored = at(i64::from(*number) + 2);
            writes.push(Write::Stored(Box::new(StoredImage { frame, file, bytes, stored }), path));
            writes.extend(complete.then_some(Write::Complete(id)));
        }
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (database, writer) = Database::open(&self.config.archive.database, "callisto", alerts).unwrap();
        database.commit(writes).await.unwrap();
        drop(database);
        writer.end().await;
    }

    async fn try_to_deliver(&self) -> anyhow::Result<Delivered> {
        let (config, database) = (&self.config, self.config.archive.database.as_path());
        let run = Run { config, delivery: &config.delivery[0], night: self.night(), database, now: at(90_000) };
        run.deliver().await
    }

    async fn deliver(&self) -> Delivered {
        self.try_to_deliver().await.unwrap()
    }

    async fn verify(&self) -> super::verify::Verified {
        let (config, night) = (&self.config, self.night());
        verify(config, &config.delivery[0], &night, &config.archive.database).await.unwrap()
    }

    async fn remove(&self) -> anyhow::Result<removal::Removed> {
        removal::remove(&self.config, &self.night(), &self.config.archive.database).await
    }

    fn manifest(&self, name: &str) -> Manifest {
        serde_json::from_slice(&fs::read(self.there(name)).unwrap()).unwrap()
    }
}

/// A folder on another disk than that of the tests.
fn on_another_disk() -> tempfile::TempDir {
    let disk = |folder: &Path| std::os::unix::fs::MetadataExt::dev(&fs::metadata(folder).unwrap());
    let (memory, program) = (Path::new("/dev/shm"), std::env::current_exe().unwrap());
    let is_other = disk(memory) != disk(&std::env::temp_dir());
    tempfile::tempdir_in(if is_other { memory } else { program.parent().unwrap() }).unwrap()
}

fn at(second: i64) -> Utc {
    // 2026-11-22T03:00:00Z
    Utc::from_micros((1_795_316_400 + second) * 1_000_000)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_is_delivered_once_and_its_manifest_lists_what_was_read_back() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light"), (3, "dark")], true).await;
    let done = site.deliver().await;
    assert_eq!((done.frames, done.sent, done.there, done.faults.len()), (3, 3, 0, 0), "{done:?}");
    let manifest = site.manifest("20261121.manifest.json");
    assert_eq!((manifest.night.as_str(), manifest.telescope.as_str()), ("20261121", "callisto"));
    assert_eq!(manifest.files.len(), 3);
    for (file, number) in manifest.files.iter().zip(1..) {
        let held = hash_file(&site.path("there").join(&file.name)).unwrap();
        assert_eq!((held.bytes, &held.sha256), (file.bytes, &file.sha256));
        assert_eq!(held, hash_file(&site.image(&format!("20261121/f{number}.fits"))).unwrap());
        assert_eq!(file.frame_id, CommandId(format!("frame-{number}")));
    }
    // Again, also without the record of before: everything is there, and nothing new appears.
    let before = files(&site.path("there"));
    for _ in 0..2 {
        let again = site.deliver().await;
        assert_eq!((again.sent, again.there, again.manifest.is_some()), (0, 3, true), "{again:?}");
        fs::remove_dir_all(site.config.folders.data.join("delivery-callisto")).unwrap();
    }
    assert_eq!(files(&site.path("there")), before);
    assert_eq!(before.len(), 4, "{before:?}");
    assert!(site.verify().await.is_whole());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_there_with_other_bytes_is_reported_and_not_overwritten() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light")], true).await;
    fs::create_dir_all(site.there("20261121")).unwrap();
    fs::write(site.there("20261121/f2.fits"), "of somebody else").unwrap();
    let done = site.deliver().await;
    assert_eq!((done.sent, done.manifest), (1, None));
    assert!(
        done.faults[0].contains("20261121/f2.fits") && done.faults[0].contains("not overwritten"),
        "{:?}",
        done.faults
    );
    assert_eq!(fs::read(site.there("20261121/f2.fits")).unwrap(), b"of somebody else");
    assert!(!site.there("20261121.manifest.json").exists());
    // Moved away, as the report asks for, the night is delivered.
    fs::remove_file(site.there("20261121/f2.fits")).unwrap();
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.manifest.is_some()), (1, 1, true));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_earlier_try_left_half_written_is_replaced() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    let part = site.there(".starmesh-part/paranal_callisto_20261121_f1.fits");
    fs::create_dir_all(part.parent().unwrap()).unwrap();
    fs::write(&part, vec![0; 3_000_000]).unwrap();
    assert!(site.deliver().await.manifest.is_some());
    assert_eq!(fs::read(site.there("20261121/f1.fits")).unwrap(), fs::read(site.image("20261121/f1.fits")).unwrap());
    assert!(!part.exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_come_later_make_a_second_manifest_that_lists_all() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    site.deliver().await;
    site.store(&[(7, "flat")], true).await;
    assert_eq!(site.verify().await.missing, ["20261121/f7.fits"]);
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there), (1, 1));
    assert_eq!(done.manifest.as_deref(), Some("paranal/callisto/20261121.manifest-2.json"));
    assert_eq!(site.manifest("20261121.manifest-2.json").files.len(), 2);
    assert_eq!(site.manifest("20261121.manifest.json").files.len(), 1);
    assert!(site.verify().await.is_whole());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_waits_for_its_header_and_the_manifest_for_all_frames() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    site.store(&[(2, "light")], false).await;
    let done = site.deliver().await;
    assert_eq!((done.frames, done.sent, done.incomplete, done.manifest), (2, 1, 1, None));
    assert!(!site.there("20261121/f2.fits").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_header_that_changed_since_is_not_delivered_again_and_is_reported() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light")], true).await;
    site.deliver().await;
    fs::write(site.image("20261121/f1.fits"), "with facts that came late").unwrap();
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.faults.len()), (0, 2, 0), "{done:?}");
    let verified = site.verify().await;
    assert!(verified.is_whole());
    assert_eq!((verified.newer_here.len(), verified.same_here), (1, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_changed_or_removed_at_the_destination_is_found() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light"), (3, "light")], true).await;
    site.deliver().await;
    let mut bytes = fs::read(site.there("20261121/f1.fits")).unwrap();
    bytes[500_000] ^= 1;
    fs::write(site.there("20261121/f1.fits"), bytes).unwrap();
    fs::remove_file(site.there("20261121/f3.fits")).unwrap();
    let verified = site.verify().await;
    assert!(!verified.is_whole());
    assert_eq!((verified.good.len(), verified.faults.len()), (1, 2), "{:?}", verified.faults);
    assert!(verified.faults[0].contains("f1.fits") && verified.faults[0].contains("changed there"));
    assert!(verified.faults[1].contains("f3.fits") && verified.faults[1].contains("not there"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_destination_gets_the_kinds_of_frames_that_it_asks_for() {
    let site = Site::new("[[delivery]]\nname = \"s\"\ndirectory = \"there\"\nimage_types = [\"light\"]\n");
    fs::create_dir_all(site.path("there")).unwrap();
    site.store(&[(1, "light"), (2, "dark")], true).await;
    assert_eq!(site.deliver().await.frames, 1);
    assert!(site.there("20261121/f1.fits").exists() && !site.there("20261121/f2.fits").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_is_not_there_or_not_mounted_is_not_made() {
    let site = Site::new("[[delivery]]\nname = \"s\"\ndirectory = \"there\"\nmust_be_mounted = true\n");
    site.store(&[(1, "light")], true).await;
    let why = format!("{:#}", site.try_to_deliver().await.unwrap_err());
    assert!(why.contains("make it, or mount the share"), "{why}");
    fs::create_dir_all(site.path("there")).unwrap();
    let why = format!("{:#}", site.try_to_deliver().await.unwrap_err());
    assert!(why.contains("is not mounted"), "{why}");
    assert!(files(&site.path("there")).is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_process_does_not_deliver_to_the_same_destination_at_a_time() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    let turn = super::record::take_turn(&site.config, "share").unwrap();
    let why = format!("{:#}", site.try_to_deliver().await.unwrap_err());
    assert!(why.contains("another process delivers to share"), "{why}");
    drop(turn);
    assert!(site.deliver().await.manifest.is_some());
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn files_leave_the_archive_only_for_a_destination_on_another_disk_that_has_them() {
    let elsewhere = on_another_disk();
    let folder = elsewhere.path().display();
    let site = Site::new(&format!("[[delivery]]\nname = \"s\"\ndirectory = \"{folder}\"\n"));
    let there = elsewhere.path().join("paranal/callisto/20261121");
    site.store(&[(1, "light"), (2, "light")], true).await;
    assert!(format!("{:#}", site.remove().await.unwrap_err()).contains("no manifest"));
    site.deliver().await;
    // The night is old enough from a day after its end on.
    let (night, database) = (site.night(), site.config.archive.database.clone());
    let young = removal::nights(&site.config, &database, night.to.plus_seconds(86_000.0), 1).await.unwrap();
    let old = removal::nights(&site.config, &database, night.to.plus_seconds(87_000.0), 1).await.unwrap();
    assert_eq!((young.len(), old.len()), (0, 1));
    // Changed there since: nothing is removed.
    let whole = fs::read(there.join("f1.fits")).unwrap();
    fs::write(there.join("f1.fits"), "changed").unwrap();
    let why = format!("{:#}", site.remove().await.unwrap_err());
    assert!(why.contains("f1.fits"), "{why}");
    assert!(site.image("20261121/f1.fits").exists() && site.image("20261121/f2.fits").exists());
    fs::write(there.join("f1.fits"), &whole).unwrap();
    // Changed here since: this file stays.
    fs::write(site.image("20261121/f2.fits"), "a newer header").unwrap();
    let removed = site.remove().await.unwrap();
    assert_eq!((removed.files, removed.staying), (1, 1));
    let late = night.to.plus_seconds(87_000.0);
    assert!(removal::nights(&site.config, &database, late, 1).await.unwrap().is_empty(), "it is not read again");
    assert!(!site.image("20261121/f1.fits").exists() && site.image("20261121/f2.fits").exists());
    // What has left is still delivered, and nothing is sent again.
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.faults.len()), (0, 2, 0), "{done:?}");
    assert_eq!(site.verify().await.gone_here, 1);
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_night_whose_disk_is_away_is_not_one_whose_files_have_left() {
    let elsewhere = on_another_disk();
    let folder = elsewhere.path().display();
    let site = Site::new(&format!("[[delivery]]\nname = \"s\"\ndirectory = \"{folder}\"\n"));
    site.store(&[(1, "light")], true).await;
    site.deliver().await;
    let (images, away) = (site.config.folders.images.clone(), site.path("away"));
    let (database, late) = (site.config.archive.database.clone(), site.night().to.plus_seconds(87_000.0));
    let left = async || removal::nights(&site.config, &database, late, 1).await.unwrap().len();
    fs::rename(&images, &away).unwrap();
    // Nothing, then a mount point, then what an archive makes that is started meanwhile.
    for (made, missing) in [(None, ".part"), (Some(&images), ".part"), (Some(&images.join(PART_FOLDER)), "20261121")] {
        made.map_or(Ok(()), fs::create_dir).unwrap();
        let why = format!("{:#}", site.remove().await.unwrap_err());
        assert!(why.contains(missing) && why.contains("its disk may be away"), "{why}");
        assert_eq!(left().await, 1, "it is looked at again");
    }
    fs::remove_dir_all(&images).unwrap();
    fs::rename(&away, &images).unwrap();
    let removed = site.remove().await.unwrap();
    assert_eq!((removed.files, removed.staying, left().await), (1, 0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_night_whose_disk_is_away_is_not_exported_as_one_without_files() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light")], true).await;
    let (out, away) = (site.path("out"), site.path("away"));
    let export = || {
        let (config, night, out) = (site.config.clone(), site.night(), out.clone());
        let export = move || crate::export::export(&config, &config.archive.database, &night, &out, at(90_000));
        tokio::task::spawn_blocking(export)
    };
    let images = &site.config.folders.images;
    fs::rename(images, &away).unwrap();
    for (made, missing) in [(None, ".part"), (Some(images.join(PART_FOLDER)), "20261121")] {
        made.map_or(Ok(()), fs::create_dir_all).unwrap();
        let why = format!("{:#}", export().await.unwrap().unwrap_err());
        assert!(why.contains(missing) && why.contains("its disk may be away"), "{why}");
        assert_eq!(fs::read_dir(&out).unwrap().count(), 0, "the same folder takes it later");
    }
    fs::remove_dir_all(images).unwrap();
    fs::rename(&away, images).unwrap();
    fs::remove_file(site.image("20261121/f2.fits")).unwrap();
    let exported = export().await.unwrap().unwrap();
    assert_eq!((exported.frames, exported.gone), (1, vec!["20261121/f2.fits".to_owned()]));
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_folder_of_images_that_has_moved_is_exported_delivered_and_removed_where_it_is() {
    let elsewhere = on_another_disk();
    let folder = elsewhere.path().display();
    let mut site = Site::new(&format!("[[delivery]]\nname = \"s\"\ndirectory = \"{folder}\"\n"));
    site.store(&[(1, "light"), (2, "light")], true).await;
    let old = std::mem::replace(&mut site.config.folders.images, site.folder.path().join("moved"));
    fs::rename(&old, &site.config.folders.images).unwrap();
    // An old copy of which nothing is to be taken.
    fs::create_dir_all(old.join("20261121")).unwrap();
    fs::write(old.join("20261121/f1.fits"), "old").unwrap();
    let (out, night, database) = (site.path("out"), site.night(), site.config.archive.database.clone());
    let config = site.config.clone();
    let export = move || crate::export::export(&config, &database, &night, &out, at(90_000));
    let exported = tokio::task::spawn_blocking(export).await.unwrap().unwrap();
    assert_eq!((exported.frames, exported.gone, exported.bytes), (2, vec![], 2_000_003));
    let delivered = site.deliver().await;
    assert_eq!((delivered.sent, delivered.faults.len()), (2, 0), "{delivered:?}");
    assert_eq!(site.verify().await.same_here, 2);
    let removed = site.remove().await.unwrap();
    assert_eq!((removed.files, removed.staying), (2, 0));
    assert!(!site.image("20261121/f1.fits").exists() && old.join("20261121/f1.fits").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_on_the_disk_of_the_archive_is_no_reason_to_remove_anything() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    site.deliver().await;
    let removed = site.remove().await.unwrap();
    assert_eq!((removed.files, removed.staying), (0, 1));
    assert!(site.image("20261121/f1.fits").exists());
}
