//! Copies that are made while rows come, and what is put back.

use bus::Clock;
use contract::CommandId;
use node::NodeAlerts;

use super::*;
use crate::database::{Database, Write};
use crate::reader::Reader;

async fn write(path: &Path, frame: &str) {
    let (database, writer) = Database::open(path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let named = Write::Writing { frame: CommandId(frame.to_owned()), file: format!("{frame}.fits") };
    database.commit(vec![named]).await.unwrap();
    drop(database);
    writer.end().await;
}

fn has(path: &Path, frame: &str) -> bool {
    Reader::open(path, "callisto").unwrap().writing(&CommandId(frame.to_owned())).unwrap().is_some()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_of_a_database_that_is_being_written_is_whole_and_each_night_has_one() {
    let folder = tempfile::tempdir().unwrap();
    let (path, copies) = (folder.path().join("archive.db"), folder.path().join("deep/backups"));
    let (database, writer) = Database::open(&path, "callisto", NodeAlerts::new(Clock::machine_clock())).unwrap();
    let writing = tokio::spawn(async move {
        for number in 0..3000 {
            let named = Write::Writing { frame: CommandId(number.to_string()), file: "f".to_owned() };
            database.commit(vec![named]).await.unwrap();
        }
    });
    let mut made = 0;
    while !writing.is_finished() || made < 5 {
        let (path, copies, night) = (path.clone(), copies.clone(), format!("202611{:02}", 1 + made % 28));
        made += 1;
        tokio::task::spawn_blocking(move || backup(&path, &copies, &night, 3)).await.unwrap().unwrap();
    }
    writing.await.unwrap();
    writer.end().await;
    let copies_left = super::copies(&copies).unwrap();
    assert_eq!(copies_left.len(), 3);
    for copy in &copies_left {
        assert_eq!(fault(copy).unwrap(), None);
    }
    assert_eq!(backup(&path, &copies, "20261130", 3).unwrap(), Some(copies.join("20261130.db")));
    assert_eq!(backup(&path, &copies, "20261130", 3).unwrap(), None, "that night has its copy");
    // Other files of the folder are nobody's business.
    fs::write(copies.join("notes.db"), "mine").unwrap();
    backup(&path, &copies, "20261201", 1).unwrap();
    assert_eq!(super::copies(&copies).unwrap(), [copies.join("20261201.db")]);
    assert!(copies.join("notes.db").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_that_is_put_back_leaves_the_database_of_before_under_another_name() {
    let folder = tempfile::tempdir().unwrap();
    let (path, copy) = (folder.path().join("archive.db"), folder.path().join("copy.db"));
    write(&path, "first").await;
    copy_now(&path, &copy).unwrap();
    assert!(copy_now(&path, &copy).unwrap_err().to_string().contains("is there already"));
    write(&path, "second").await;
    #[cfg(unix)]
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o640)).unwrap();
    let permissions = fs::metadata(&path).unwrap().permissions();
    let aside = restore(&copy, &path).unwrap().unwrap();
    assert_eq!(fs::metadata(&path).unwrap().permissions(), permissions, "the archive node may still open it");
    assert!(has(&path, "first") && !has(&path, "second"));
    assert!(has(&aside, "first") && has(&aside, "second"));
    // A new file where none is.
    fs::remove_file(&path).unwrap();
    assert_eq!(restore(&copy, &path).unwrap(), None);
    write(&path, "third").await;
    assert!(has(&path, "first") && has(&path, "third"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_sound_copy_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (path, copy) = (folder.path().join("archive.db"), folder.path().join("copy.db"));
    for number in 0..200 {
        write(&path, &format!("frame-{number}-{}", "x".repeat(300))).await;
    }
    let refused = |bytes: &[u8]| {
        fs::write(&copy, bytes).unwrap();
        let before = fs::read(&path).unwrap();
        let why = format!("{:#}", restore(&copy, &path).unwrap_err());
        assert_eq!(fs::read(&path).unwrap(), before, "{why}");
        why
    };
    let whole = fs::read(&path).unwrap();
    let mut holes = whole.clone();
    holes[8192..].fill(0x55);
    let why = refused(&holes);
    assert!(why.contains("damaged"), "{why}");
    assert!(
        refused(b"no database at all, but a text that is long enough for a header of SQLite")
            .contains("cannot be read")
    );
    assert!(refused(b"").contains("no tables of Starmesh"));
    let newer = folder.path().join("newer.db");
    fs::write(&newer, &whole).unwrap();
    Connection::open(&newer).unwrap().pragma_update(None, "user_version", migrations::VERSION + 1).unwrap();
    assert!(refused(&fs::read(&newer).unwrap()).contains("newer Starmesh"));
    fs::remove_file(&copy).unwrap();
    assert!(format!("{:#}", restore(&copy, &path).unwrap_err()).contains("is not there"));
}
