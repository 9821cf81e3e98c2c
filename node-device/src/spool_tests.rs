use contract::device::camera::Pixel;

use super::*;

fn about(id: &str) -> About {
    About {
        id: CommandId(id.to_owned()),
        camera: "cam".parse().unwrap(),
        purpose: Purpose::default(),
        bin: 1,
        origin_px: [0, 0],
        started_utc: Utc::EPOCH,
        exposure_s: 1.0,
        readings: BTreeMap::new(),
    }
}

fn image() -> Image {
    Image { width_px: 2, height_px: 1, planes: 1, pixel: Pixel::U16, bytes: vec![1, 2, 3, 4] }
}

fn open(folder: &Path) -> Spool {
    open_for(folder, &[])
}

fn open_for(folder: &Path, archives: &[Name]) -> Spool {
    Spool::open(folder, "http://127.0.0.1:1".to_owned(), (&"alpha".parse().unwrap(), archives)).unwrap().0
}

fn at(second: u64) -> MachineTime {
    MachineTime::from_boot(Duration::from_secs(second))
}

#[test]
fn a_frame_survives_a_restart_and_goes_only_when_it_is_released_and_old() {
    let folder = tempfile::tempdir().unwrap();
    let (id, camera) = (CommandId("f1".to_owned()), "cam".parse().unwrap());
    open(folder.path()).store(&image(), about("f1")).unwrap();

    let spool = open(folder.path());
    let frames = spool.unreleased(&camera);
    let frame = &frames[0];
    assert_eq!((frame.bytes, frame.width_px, frames.len()), (4, 2, 1));
    // Echo -n -e '\x01\x02\x03\x04' | sha256sum.
    assert_eq!(frame.sha256, "9f64a747e1b97f131fabb6b447296c9b6f0201e79fb3c5356e6c77e89b6a806a");
    spool.announced(&id, at(100));
    assert!(spool.release(&id, "00", "archive/alpha/main").is_err());
    assert_eq!(spool.waiting(&camera), 1);
    spool.release(&id, &frame.sha256.to_uppercase(), "archive/alpha/main").unwrap();
    assert_eq!(spool.waiting(&camera), 0);
    spool.sweep(at(159));
    assert!(spool.holds(&id) && folder.path().join("f1.pixels").exists());
    spool.sweep(at(160));
    assert!(!spool.holds(&id));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    assert!(spool.release(&id, "00", "archive/alpha/main").is_ok(), "a frame that is gone was released before");
}

#[test]
fn a_node_that_ends_leaves_no_frame_that_the_archive_has_and_each_that_it_has_not() {
    let folder = tempfile::tempdir().unwrap();
    let spool = open(folder.path());
    for id in ["f1", "f2"] {
        spool.store(&image(), about(id)).unwrap();
    }
    let [first, second] = ["f1", "f2"].map(|id| CommandId(id.to_owned()));
    spool.announced(&first, at(100));
    let sha256 = spool.frame(&first).unwrap().sha256;
    spool.release(&first, &sha256, "archive/alpha/main").unwrap();
    spool.clear();
    assert!(!spool.holds(&first) && spool.holds(&second));
    assert!(!folder.path().join("f1.pixels").exists() && folder.path().join("f2.pixels").exists());
}

#[test]
fn what_a_crash_leaves_half_written_is_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    let spool = open(folder.path());
    for id in ["whole", "cut", "broken"] {
        spool.store(&image(), about(id)).unwrap();
    }
    let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
    write("new.pixels.part", b"12");
    write("new2.pixels", b"1234");
    write("new2.json.part", b"{");
    write("cut.pixels", b"123");
    write("broken.json", b"{\"token\"");

    let spool = open(folder.path());
    let ids: Vec<String> = spool.unreleased(&"cam".parse().unwrap()).into_iter().map(|frame| frame.id.0).collect();
    assert_eq!(ids, ["whole"]);
    for gone in ["new.pixels.part", "new2.pixels", "new2.json.part"] {
        assert!(!folder.path().join(gone).exists(), "{gone}");
    }
    for aside in ["cut.bad", "cut.pixels", "broken.bad", "broken.pixels"] {
        assert!(folder.path().join(aside).exists(), "{aside}: what was announced once is set aside, not removed");
    }
    drop(spool);
    open(folder.path());
    assert!(folder.path().join("broken.pixels").exists(), "nor at the start after that");
}

#[test]
fn pixels_are_for_those_who_know_the_token() {
    let folder = tempfile::tempdir().unwrap();
    let spool = open(folder.path());
    spool.store(&image(), about("f1")).unwrap();
    let url = spool.frame(&CommandId("f1".to_owned())).unwrap().url;
    let token = url.split("token=").nth(1).unwrap();
    assert!(spool.pixels("f1", token).is_some());
    assert!(spool.pixels("f1", "").is_none());
    assert!(spool.pixels("../f1", token).is_none());
}

#[test]
fn a_disk_that_refuses_leaves_no_entry() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("spool");
    let spool = open(&inner);
    fs::remove_dir_all(&inner).unwrap();
    assert!(matches!(spool.store(&image(), about("f1")), Err(SpoolError::Disk { .. })));
    assert!(!spool.holds(&CommandId("f1".to_owned())));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_refuses_the_frame_leaves_nothing_behind_and_takes_it_once_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let spool = open(folder.path());
    // There is no room for the pixels, or after them none for their description.
    for part in ["f1.pixels.part", "f1.json.part"] {
        std::os::unix::fs::symlink("/dev/full", folder.path().join(part)).unwrap();
        let error = spool.store(&image(), about("f1")).unwrap_err().to_string();
        let file = part.trim_end_matches(".part");
        assert!(error.contains(file) && error.contains("No space left on device"), "{error}");
        assert!(!spool.holds(&CommandId("f1".to_owned())));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{part}");
    }
    spool.store(&image(), about("f1")).unwrap();
    assert_eq!(open(folder.path()).waiting(&"cam".parse().unwrap()), 1);
}

#[test]
fn a_description_of_another_frame_is_set_aside() {
    let folder = tempfile::tempdir().unwrap();
    open(folder.path()).store(&image(), about("f1")).unwrap();
    for ending in ["json", "pixels"] {
        fs::copy(folder.path().join(format!("f1.{ending}")), folder.path().join(format!("f2.{ending}"))).unwrap();
    }
    let spool = open(folder.path());
    assert!(spool.holds(&CommandId("f1".to_owned())) && !spool.holds(&CommandId("f2".to_owned())));
    assert!(folder.path().join("f2.bad").exists());
}

#[test]
fn a_frame_stays_until_each_archive_of_the_file_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let (id, camera) = (CommandId("f1".to_owned()), "cam".parse().unwrap());
    let archives = ["main", "second"].map(|id| id.parse().unwrap());
    let spool = open_for(folder.path(), &archives);
    spool.store(&image(), about("f1")).unwrap();
    spool.announced(&id, at(100));
    let sha256 = spool.unreleased(&camera)[0].sha256.clone();
    for (archive, waiting) in [
        ("archive/alpha/main", 1),
        ("archive/alpha/main", 1),
        ("archive/beta/second", 1),
        ("web/alpha/second", 1),
        ("archive/alpha/second", 0),
    ] {
        spool.release(&id, &sha256, archive).unwrap();
        assert_eq!(spool.waiting(&camera), waiting, "{archive}");
        spool.sweep(at(1000));
        assert_eq!(spool.holds(&id), waiting == 1, "{archive}");
    }
}
