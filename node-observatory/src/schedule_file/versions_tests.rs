use std::io::Write as _;

use super::*;

fn at(text: &str) -> Utc {
    text.parse().unwrap()
}

fn ana(reason: &str) -> Author {
    Author { name: "web/ana".to_owned(), reason: reason.to_owned() }
}

const NOW: &str = "2026-11-21T03:00:00Z";

fn versions(folder: &Path) -> Versions {
    Versions { folder: folder.join("schedules"), pen: Arc::default() }
}

#[test]
fn each_text_is_stored_with_author_time_and_reason_and_the_same_one_only_once() {
    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    assert_eq!(versions.list().unwrap(), []);
    let by_file = Author { name: "file".to_owned(), reason: String::new() };
    assert_eq!(versions.keep("one\n", 3, &by_file, at(NOW)).unwrap(), (1, true));
    assert_eq!(versions.keep("two\n", 4, &ana("a supernova"), at(NOW)).unwrap(), (2, true));
    assert_eq!(
        versions.keep("two\n", 4, &by_file, at(NOW)).unwrap(),
        (2, false),
        "the file says what the order brought"
    );
    assert_eq!(versions.keep("one\n", 3, &ana("it was a plane"), at(NOW)).unwrap(), (3, true));
    let listed: Vec<_> =
        versions.list().unwrap().into_iter().map(|v| (v.version, v.author, v.reason, v.rows, v.bytes)).collect();
    let line = |version, author: &str, reason: &str, rows| (version, author.to_owned(), reason.to_owned(), rows, 4);
    assert_eq!(
        listed,
        [line(1, "file", "", 3), line(2, "web/ana", "a supernova", 4), line(3, "web/ana", "it was a plane", 3)]
    );
    assert_eq!((versions.text(1).unwrap(), versions.text(2).unwrap()), ("one\n".to_owned(), "two\n".to_owned()));
    assert!(versions.text(4).unwrap_err().to_string().contains("no version 4"));
}

#[test]
fn a_crash_that_left_half_a_line_or_a_text_without_its_line_costs_no_version() {
    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    versions.keep("one\n", 1, &ana(""), at(NOW)).unwrap();
    fs::write(versions.path(2), "a text whose line was never written").unwrap();
    assert_eq!(versions.keep("two\n", 1, &ana(""), at(NOW)).unwrap(), (2, true));
    assert_eq!(versions.text(2).unwrap(), "two\n");
    // A line that is lost leaves its text, its number and the whole index as it was found.
    let mut index = fs::OpenOptions::new().append(true).open(versions.index()).unwrap();
    index.write_all(b"{\"version\": 3, \"at").unwrap();
    fs::write(versions.path(3), "three\n").unwrap();
    assert_eq!(versions.list().unwrap().len(), 2);
    assert_eq!(versions.keep("four\n", 1, &ana(""), at(NOW)).unwrap(), (4, true));
    assert_eq!(versions.keep("five\n", 1, &ana(""), at(NOW)).unwrap(), (5, true));
    assert_eq!(fs::read_to_string(versions.path(3)).unwrap(), "three\n");
    assert_eq!(versions.list().unwrap().len(), 4);
    let mut files = fs::read_dir(&versions.folder).unwrap().map(|file| file.unwrap().file_name());
    assert!(files.any(|file| file.to_string_lossy().starts_with("index.jsonl.bad-")));
}

#[test]
fn a_text_that_was_changed_afterwards_is_not_printed_as_what_was_stored() {
    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    versions.keep("one\n", 1, &ana(""), at(NOW)).unwrap();
    fs::write(versions.path(1), "another\n").unwrap();
    assert!(versions.text(1).unwrap_err().to_string().contains("its hash differs"));
}

#[test]
fn a_version_that_did_not_come_into_force_is_taken_back() {
    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    versions.keep("one\n", 1, &ana(""), at(NOW)).unwrap();
    versions.keep("two\n", 1, &ana(""), at(NOW)).unwrap();
    versions.take_back(1).unwrap();
    assert_eq!(versions.list().unwrap().len(), 2, "only the newest can be taken back");
    versions.take_back(2).unwrap();
    assert_eq!(versions.list().unwrap().len(), 1);
    assert!(!versions.path(2).exists());
}

#[test]
fn what_the_disk_does_not_take_leaves_what_was_stored() {
    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    versions.keep("one\n", 1, &ana(""), at(NOW)).unwrap();
    // A folder where the file is to be written: no disk takes that, whichever user asks.
    fs::create_dir(versions.folder.join("index.jsonl.part")).unwrap();
    assert!(versions.keep("two\n", 1, &ana(""), at(NOW)).is_err());
    assert_eq!(versions.list().unwrap().len(), 1);
    assert!(!versions.path(2).exists());
    fs::remove_dir(versions.folder.join("index.jsonl.part")).unwrap();
    assert_eq!(versions.keep("two\n", 1, &ana(""), at(NOW)).unwrap(), (2, true));
}

#[test]
fn old_versions_are_forgotten_by_number_and_by_bytes_but_never_the_newest() {
    let version = |version, bytes| Version {
        version,
        at_utc: at(NOW),
        author: "file".to_owned(),
        reason: String::new(),
        rows: 1,
        bytes,
        sha256: String::new(),
    };
    let many: Vec<Version> = (1..=1003).map(|number| version(number, 10)).collect();
    let stored = bounded(&many);
    assert_eq!((stored.len(), stored[0].version, stored[999].version), (1000, 4, 1003));
    let large: Vec<Version> = (1..=4).map(|number| version(number, 40_000_000)).collect();
    assert_eq!(bounded(&large).iter().map(|v| v.version).collect::<Vec<_>>(), [3, 4]);
    assert_eq!(bounded(&[version(1, 200_000_000)]).len(), 1);
    assert_eq!(bounded(&[]).len(), 0);

    let folder = tempfile::tempdir().unwrap();
    let versions = versions(folder.path());
    versions.keep("one\n", 1, &ana(""), at(NOW)).unwrap();
    fs::write(versions.path(900), "forgotten").unwrap();
    versions.keep("two\n", 1, &ana(""), at(NOW)).unwrap();
    assert!(!versions.path(900).exists() && versions.path(1).exists());
}
