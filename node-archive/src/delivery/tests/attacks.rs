//! What an adversary found: ways to call delivered what is not, to overwrite, and to remove the only copy.

use super::*;
use crate::delivery::directory::Directory;
use crate::delivery::item::Item;

fn item(site: &Site, name: &str) -> Item {
    let file = site.path("to-send");
    fs::write(&file, "content").unwrap();
    let held = hash_file(&file).unwrap();
    Item { file, name: name.to_owned(), bytes: held.bytes, sha256: held.sha256 }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_becomes_another_one_in_the_middle_is_noticed() {
    let site = Site::with_folder();
    let (there, away) = (site.path("there"), site.path("away"));
    let directory = Directory::new(there.clone(), None);
    directory.check().unwrap();
    directory.send(&item(&site, "paranal/callisto/a.fits")).unwrap();
    // As when a share is taken away, and its mount point is left.
    fs::rename(&there, &away).unwrap();
    fs::create_dir(&there).unwrap();
    for error in [
        directory.send(&item(&site, "paranal/callisto/b.fits")).map(drop),
        directory.held("paranal/callisto/a.fits").map(drop),
        directory.has("paranal/callisto/a.fits", 7).map(drop),
    ] {
        let why = format!("{:#}", error.unwrap_err());
        assert!(why.contains("is another folder than when this try began"), "{why}");
    }
    assert!(files(&there).is_empty() && fs::read_dir(&there).unwrap().next().is_none());
    fs::remove_dir(&there).unwrap();
    assert!(directory.send(&item(&site, "paranal/callisto/b.fits")).is_err());
    assert!(!there.exists(), "the folder itself is never made");
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn links_below_a_destination_are_not_followed() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    fs::create_dir_all(site.path("there/paranal")).unwrap();
    // The folder of the destination leads back to the images.
    std::os::unix::fs::symlink(&site.config.folders.images, site.path("there/paranal/callisto")).unwrap();
    let why = format!("{:#}", site.try_to_deliver().await.unwrap_err());
    assert!(why.contains("is a link"), "{why}");
    assert_eq!(files(&site.config.folders.images).len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_manifest_of_another_archive_makes_nothing_ours() {
    let (site, other) = (Site::with_folder(), Site::with_folder());
    other.store(&[(1, "light"), (2, "light")], true).await;
    other.deliver().await;
    // The same site, telescope and names; other frames.
    fs::remove_dir_all(site.path("there")).unwrap();
    fs::rename(other.path("there"), site.path("there")).unwrap();
    let before: Vec<(PathBuf, Vec<u8>)> =
        files(&site.path("there")).into_iter().map(|path| (path.clone(), fs::read(path).unwrap())).collect();
    site.store_with(&[(1, "light"), (2, "light")], true, |frame| frame.id.0.push_str("-other")).await;
    for number in [1, 2] {
        fs::write(site.image(&format!("20261121/f{number}.fits")), format!("other pixels {number}")).unwrap();
    }
    let done = site.deliver().await;
    assert_eq!((done.sent, done.there, done.faults.len(), done.manifest), (0, 0, 2, None));
    assert!(before.iter().all(|(path, content)| fs::read(path).unwrap() == *content));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_manifest_still_lists_what_the_database_has_forgotten() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light")], true).await;
    site.deliver().await;
    // A database that is older than the delivery, or began anew.
    fs::remove_file(&site.config.archive.database).unwrap();
    for ending in ["-wal", "-shm"] {
        let _ = fs::remove_file(format!("{}{ending}", site.config.archive.database.display()));
    }
    site.store(&[(2, "light"), (3, "light")], true).await;
    let done = site.deliver().await;
    assert_eq!((done.frames, done.sent, done.manifest.is_some()), (2, 1, true), "{done:?}");
    let listed: Vec<String> =
        site.manifest("20261121.manifest-2.json").files.into_iter().map(|file| file.name).collect();
    assert_eq!(listed.len(), 3, "{listed:?}");
    assert!(site.verify().await.is_whole());
    assert!(site.deliver().await.manifest.unwrap().ends_with("manifest-2.json"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_taken_by_a_folder_stops_no_other_file() {
    let site = Site::with_folder();
    site.store(&[(1, "light"), (2, "light"), (3, "light")], true).await;
    fs::create_dir_all(site.there("20261121/f2.fits")).unwrap();
    let done = site.deliver().await;
    assert_eq!((done.sent, done.faults.len(), done.manifest), (2, 1, None));
    assert!(done.faults[0].contains("20261121/f2.fits") && done.faults[0].contains("not overwritten"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_delivered_to_one_place_is_not_delivered_to_another() {
    let site = Site::with_folder();
    site.store(&[(1, "light")], true).await;
    site.deliver().await;
    let set = super::super::record::set_of(std::iter::once(&CommandId("frame-1".to_owned())));
    let record = super::super::record::Record::read(&site.config, "share", &site.night()).unwrap();
    let mut delivery = site.config.delivery[0].clone();
    assert!(record.is_delivered(&set, &super::super::record::place_of(&delivery)));
    delivery.directory = Some(site.path("elsewhere"));
    assert!(!record.is_delivered(&set, &super::super::record::place_of(&delivery)));
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_was_about_to_leave_when_the_node_was_killed_comes_back() {
    let elsewhere = on_another_disk();
    let site = Site::new(&format!("[[delivery]]\nname = \"s\"\ndirectory = \"{}\"\n", elsewhere.path().display()));
    site.store(&[(1, "light"), (2, "light")], true).await;
    site.deliver().await;
    let path = site.image("20261121/f1.fits");
    fs::rename(&path, site.image("20261121/f1.fits.leaving")).unwrap();
    // A destination that lacks a file now: nothing goes, and the file has its name again.
    let there = elsewhere.path().join("paranal/callisto/20261121/f2.fits");
    let content = fs::read(&there).unwrap();
    fs::remove_file(&there).unwrap();
    assert!(site.remove().await.is_err());
    assert!(path.exists() && site.image("20261121/f2.fits").exists());
    fs::write(&there, content).unwrap();
    assert_eq!(site.remove().await.unwrap().files, 2);
    assert!(files(&site.config.folders.images).is_empty());
}
