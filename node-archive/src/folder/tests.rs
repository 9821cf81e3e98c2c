use super::*;

fn telescope(name: &str) -> Address {
    Address::new("paranal", name).unwrap()
}

#[tokio::test]
async fn a_second_archive_of_one_telescope_is_refused_and_the_first_one_named() {
    let folder = tempfile::tempdir().unwrap();
    let (images, database) = (folder.path().join("images"), folder.path().join("data/archive.db"));
    let first = claim(&images, &telescope("callisto"), "archive/callisto/main").await.unwrap();
    let of_database = claim_database(&database, &telescope("callisto"), "archive/callisto/main").await.unwrap();
    let refused = claim(&images, &telescope("callisto"), "archive/callisto/two").await.unwrap_err().to_string();
    assert!(refused.contains("archive node archive/callisto/main, process"), "{refused}");
    assert!(refused.contains("store every frame twice") && refused.contains("[folders] images"), "{refused}");
    let refused = claim_database(&database, &telescope("callisto"), "two").await.unwrap_err().to_string();
    assert!(refused.starts_with("the database "), "{refused}");
    // Telescopes of one site may share both.
    claim(&images, &telescope("europa"), "archive/europa/main").await.unwrap();
    claim_database(&database, &telescope("europa"), "archive/europa/main").await.unwrap();
    drop((first, of_database));
    claim(&images, &telescope("callisto"), "archive/callisto/two").await.unwrap();
    claim_database(&database, &telescope("callisto"), "archive/callisto/two").await.unwrap();
}

#[cfg(unix)]
#[tokio::test]
async fn a_link_in_place_of_the_archives_own_folder_is_never_swept() {
    let folder = tempfile::tempdir().unwrap();
    let (images, victim) = (folder.path().join("images"), folder.path().join("home"));
    fs::create_dir_all(&images).unwrap();
    fs::create_dir_all(victim.join("paranal-callisto")).unwrap();
    fs::write(victim.join("paranal-callisto/letter"), "dear").unwrap();
    std::os::unix::fs::symlink(&victim, images.join(PART_FOLDER)).unwrap();
    let _claim = claim(&images, &telescope("callisto"), "main").await.unwrap();
    clear_parts(&images, &telescope("callisto")).unwrap();
    assert!(victim.join("paranal-callisto/letter").exists());
    assert!(fs::symlink_metadata(images.join(PART_FOLDER)).unwrap().is_dir());
}

#[cfg(unix)]
#[test]
fn no_link_below_the_folder_of_images_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let (images, outside) = (folder.path().join("images"), folder.path().join("outside"));
    fs::create_dir_all(images.join("real")).unwrap();
    fs::create_dir_all(&outside).unwrap();
    std::os::unix::fs::symlink(&outside, images.join("20261120")).unwrap();
    fs::write(images.join("file"), "").unwrap();
    let way = |relative: &str| make_way(&images, Path::new(relative)).unwrap();
    assert_eq!(way("real/a.fits"), images.join("real/a.fits"));
    assert_eq!(way("a.fits"), images.join("a.fits"));
    assert_eq!(way("20261120/deep/a.fits"), images.join("20261120-v2/deep/a.fits"));
    assert_eq!(way("file/a.fits"), images.join("file-v2/a.fits"));
    assert!(images.join("20261120-v2/deep").is_dir());
    assert!(make_way(&images, Path::new("../a.fits")).is_err());
    assert_eq!(fs::read_dir(&outside).unwrap().count(), 0);
    assert!(without_links(&images, &images.join("real/a.fits")).is_ok());
    let error = without_links(&images, &images.join("20261120/a.fits")).unwrap_err().to_string();
    assert!(error.contains("20261120 is a link"), "{error}");
    for elsewhere in [outside.join("a.fits"), images.join("../outside/a.fits")] {
        assert!(without_links(&images, &elsewhere).is_err(), "{}", elsewhere.display());
    }
    // One that leads nowhere is there all the same.
    std::os::unix::fs::symlink(folder.path().join("nowhere"), images.join("real/b.fits")).unwrap();
    assert!(is_taken(&images.join("real/b.fits")) && !images.join("real/b.fits").exists());
}

#[test]
fn a_file_that_is_not_there_was_removed_only_where_its_disk_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    let (night, file) = (images.join("20261121"), images.join("20261121/a.fits"));
    let away = |missing: &str| {
        let why = is_stored(&images, &file).unwrap_err().to_string();
        assert!(why.contains(missing) && why.contains("its disk may be away. Mount it"), "{why}");
    };
    // Nothing, then a mount point, then what an archive makes that is started meanwhile.
    away(".part");
    fs::create_dir(&images).unwrap();
    away(".part");
    assert!(put(&images, &images.join("reports/a.html"), b"").is_err() && is_bare(&images), "nothing is written there");
    fs::create_dir(images.join(PART_FOLDER)).unwrap();
    away("20261121");
    fs::create_dir(&night).unwrap();
    assert!(!is_stored(&images, &file).unwrap());
    fs::write(&file, "").unwrap();
    assert!(is_stored(&images, &file).unwrap());
    put(&images, &images.join("reports/a.html"), b"").unwrap();
    // What cannot be looked at is not known to be removed.
    fs::remove_dir_all(&night).unwrap();
    fs::write(&night, "no folder").unwrap();
    assert!(is_stored(&images, &file).is_err());
}
