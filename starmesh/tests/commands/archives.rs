//! `starmesh archive`, as docs/operator/archive.md has it: a copy of a running node's database, and a copy that is put back.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rusqlite::Connection;

use crate::command::{Output, starmesh};

/// The archive node of a site whose nodes meet nobody, until it is dropped.
struct Archive(Child);

impl Archive {
    fn start(folder: &Path) -> Self {
        let log = fs::File::create(folder.join("archive.log")).unwrap();
        let node = Command::new(env!("CARGO_BIN_EXE_starmesh"))
            .args(["node", "archive", "--config", "observatory.toml"])
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(log.try_clone().unwrap())
            .stderr(log)
            .spawn()
            .unwrap();
        let this = Self(node);
        this.until(folder, "the archive's tables", || lines(folder).is_some_and(|count| count > 0));
        this
    }

    fn until(&self, folder: &Path, what: &str, holds: impl Fn() -> bool) {
        let began = Instant::now();
        while !holds() {
            let log = || fs::read_to_string(folder.join("archive.log")).unwrap_or_default();
            assert!(began.elapsed() < Duration::from_secs(120), "not {what} in time:\n{}", log());
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

impl Drop for Archive {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Rows of the archive's log; none while there is no such table.
fn lines(folder: &Path) -> Option<i64> {
    let database = Connection::open(folder.join("data/archive.db")).ok()?;
    database.query_row("SELECT count(*) FROM log", [], |row| row.get(0)).ok()
}

fn site(folder: &Path) {
    let text = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6157\n\
                longitude_deg = -70.3976\nelevation_m = 2518\n[bus]\nmulticast = false\n[[camera]]\nname = \"main\"\n\
                server = \"127.0.0.1:9\"\n";
    fs::write(folder.join("observatory.toml"), text).unwrap();
}

fn archive(folder: &Path, verb: &str, copy: &str) -> Output {
    let config = folder.join("observatory.toml");
    starmesh([
        "archive".as_ref(),
        verb.as_ref(),
        folder.join(copy).as_os_str(),
        "--config".as_ref(),
        config.as_os_str(),
    ])
}

#[test]
fn a_copy_is_made_while_the_node_runs_and_put_back_only_when_it_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    site(folder);
    let node = Archive::start(folder);
    // The node itself makes one for the night.
    let copies = || fs::read_dir(folder.join("data/backups")).map_or(0, Iterator::count);
    node.until(folder, "the night's copy", || copies() == 1);
    let made = archive(folder, "backup", "mine.db");
    assert!(made.success && made.out.contains("was copied to"), "{}{}", made.out, made.err);
    let again = archive(folder, "backup", "mine.db");
    assert!(!again.success && again.err.contains("is there already; a copy replaces nothing"), "{}", again.err);
    let held = archive(folder, "restore", "mine.db");
    assert!(!held.success && held.err.contains("is in use by archive node"), "{}", held.err);
    drop(node);
    let database = Connection::open(folder.join("data/archive.db")).unwrap();
    database.execute("DELETE FROM log", []).unwrap();
    drop(database);
    let put_back = archive(folder, "restore", "mine.db");
    assert!(put_back.success && put_back.out.contains("archive.db.before-1"), "{}{}", put_back.out, put_back.err);
    assert!(lines(folder).unwrap() > 0);
    let before = Connection::open(folder.join("data/archive.db.before-1")).unwrap();
    assert_eq!(before.query_row("SELECT count(*) FROM log", [], |row| row.get::<_, i64>(0)).unwrap(), 0);
    // And the node goes on with it.
    let had = lines(folder).unwrap();
    let node = Archive::start(folder);
    node.until(folder, "more lines", || lines(folder).is_some_and(|now| now > had));
}

#[test]
fn what_is_no_copy_of_an_archive_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    site(folder);
    fs::write(folder.join("notes.txt"), "a text that is long enough to be read as something, and is no database")
        .unwrap();
    Connection::open(folder.join("other.db")).unwrap().execute_batch("CREATE TABLE mine (a)").unwrap();
    for (copy, words) in [
        ("none.db", "is not there; the copies are in the folder that [archive] backups names"),
        ("notes.txt", "cannot be read as a database"),
        ("other.db", "has no tables of Starmesh's archive"),
    ] {
        let refused = archive(folder, "restore", copy);
        assert!(!refused.success && refused.err.contains(words), "{copy}: {}", refused.err);
        assert!(!folder.join("data/archive.db").exists(), "{copy}: nothing is put in its place");
    }
    let nothing = archive(folder, "backup", "mine.db");
    assert!(!nothing.success && nothing.err.contains("cannot open the database"), "{}", nothing.err);
}
