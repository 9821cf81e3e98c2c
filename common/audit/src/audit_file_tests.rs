use std::sync::atomic::{AtomicI64, Ordering};

use contract::BootId;
use contract::audit::{AuditOutcome, AuditRecord};
use units::Utc;

use super::*;
use crate::chain::seal;
use crate::past::Past;

fn record(verb: &str) -> AuditRecord {
    AuditRecord {
        chain: String::new(),
        number: 0,
        at_utc: Utc::from_seconds(1_795_228_200.25),
        boot_time_ms: 12_345,
        boot_id: BootId::fresh(),
        node: "device/alpha/main".to_owned(),
        host: "dome-pc".to_owned(),
        from: "observatory/alpha/main".to_owned(),
        from_host: String::new(),
        id: CommandId::fresh(),
        device: "dome/roof".to_owned(),
        verb: verb.to_owned(),
        parameters: String::new(),
        token: None,
        reason: String::new(),
        outcome: AuditOutcome::Accepted,
        previous: String::new(),
        sha256: String::new(),
    }
}

/// Opens if need be, and writes one line for each note and each verb.
fn write(file: &mut AuditFile, verbs: &[&str]) -> io::Result<Vec<&'static str>> {
    let notes = if file.is_open() { Vec::new() } else { file.open()? };
    let noted: Vec<&str> = notes.iter().map(|(verb, _)| *verb).collect();
    let mut last = file.last().unwrap().clone();
    let mut lines = Vec::new();
    for verb in noted.iter().chain(verbs) {
        let sealed = seal(record(verb), &last).unwrap();
        last = sealed.link();
        lines.push(sealed);
    }
    file.append(&lines)?;
    Ok(noted)
}

fn text(folder: &Path) -> Vec<u8> {
    fs::read(folder.join("audit-x.jsonl")).unwrap()
}

/// Verbs of all files in their order; the chain must hold from the first to the last.
fn verbs(folder: &Path) -> Vec<String> {
    let (mut last, mut all) = (None, Vec::new());
    for file in pages(folder, "audit-x").unwrap() {
        let found = examine(&fs::read(&file).unwrap(), last.as_ref());
        assert!(found.broken.is_none() && found.half.is_empty(), "{}: {:?}", file.display(), found.broken);
        last = found.last().or(last);
        all.extend(found.good.into_iter().map(|proven| proven.record.verb));
    }
    all
}

#[test]
fn a_chain_goes_on_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(write(&mut AuditFile::new(folder.path(), "audit-x"), &["a", "b"]).unwrap(), ["chain_begins"]);
    assert!(write(&mut AuditFile::new(folder.path(), "audit-x"), &["c"]).unwrap().is_empty());
    assert_eq!(verbs(folder.path()), ["chain_begins", "a", "b", "c"]);
}

#[test]
fn a_kill_at_any_byte_loses_no_whole_line_and_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    write(&mut AuditFile::new(folder.path(), "audit-x"), &["a", "b"]).unwrap();
    let whole = text(folder.path());
    for length in 0..=whole.len() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("audit-x.jsonl"), &whole[..length]).unwrap();
        let noted = write(&mut AuditFile::new(folder.path(), "audit-x"), &["after"]).unwrap();
        let found = verbs(folder.path());
        // A line that lacks but its end is a whole one.
        let lines = whole[..length].iter().filter(|byte| **byte == b'\n').count();
        let complete = whole.get(length) == Some(&b'\n');
        let half = length > 0 && whole[length - 1] != b'\n' && !complete;
        let mut expected: Vec<&str> = ["chain_begins", "a", "b"][..lines + usize::from(complete)].to_vec();
        expected.extend(&noted);
        expected.push("after");
        assert_eq!(found, expected, "killed after {length} bytes");
        assert_eq!(noted.contains(&"half_line_moved"), half, "killed after {length} bytes");
        let moved = folder.path().join("audit-x.half-1.txt");
        assert_eq!(moved.exists(), half);
        if half {
            let begin = whole[..length].iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
            assert_eq!(fs::read(moved).unwrap(), &whole[begin..length]);
        }
    }
}

#[test]
fn any_byte_that_is_changed_in_the_file_is_found_and_a_new_chain_names_it() {
    let folder = tempfile::tempdir().unwrap();
    write(&mut AuditFile::new(folder.path(), "audit-x"), &["a", "b"]).unwrap();
    let whole = text(folder.path());
    for at in 0..whole.len() {
        let mut changed = whole.clone();
        changed[at] ^= 0x01;
        let found = examine(&changed, None);
        let line = whole[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
        let last_end = at == whole.len() - 1;
        match found.broken {
            Some((broken, _)) => assert_eq!(broken, line, "byte {at}"),
            None => assert!(last_end && !found.half.is_empty(), "byte {at} was changed and nobody noticed"),
        }
    }
    for at in [0, whole.len() / 2, whole.len() - 10] {
        let folder = tempfile::tempdir().unwrap();
        let mut changed = whole.clone();
        changed[at] ^= 0x01;
        fs::write(folder.path().join("audit-x.jsonl"), &changed).unwrap();
        assert_eq!(write(&mut AuditFile::new(folder.path(), "audit-x"), &["c"]).unwrap(), [BROKEN]);
        assert_eq!(fs::read(folder.path().join("audit-x.0001.jsonl")).unwrap(), changed, "kept as it was found");
        let new = examine(&text(folder.path()), None);
        assert_eq!(new.good.len(), 2);
        assert_eq!(new.good[0].record.number, 0);
        // The new chain is a good one from then on.
        assert!(write(&mut AuditFile::new(folder.path(), "audit-x"), &["d"]).unwrap().is_empty());
    }
}

#[test]
fn a_kill_between_the_break_and_the_new_chain_forgets_neither() {
    let folder = tempfile::tempdir().unwrap();
    write(&mut AuditFile::new(folder.path(), "audit-x"), &["a", "b"]).unwrap();
    let mut changed = text(folder.path());
    changed[20] ^= 0x01;
    fs::write(folder.path().join("audit-x.jsonl"), &changed).unwrap();
    AuditFile::new(folder.path(), "audit-x").open().unwrap();
    let mut audit_file = AuditFile::new(folder.path(), "audit-x");
    let notes = audit_file.open().unwrap();
    assert!(matches!(&notes[..], [(BROKEN, why)] if why.contains("audit-x.0001.jsonl")), "{notes:?}");
}

#[test]
fn a_full_file_is_turned_over_and_the_chain_runs_through() {
    let folder = tempfile::tempdir().unwrap();
    for run in 0..3 {
        let mut audit_file = AuditFile::new(folder.path(), "audit-x");
        audit_file.full_bytes = 1500;
        for n in 0..5 {
            write(&mut audit_file, &[&format!("{run}.{n}")]).unwrap();
        }
    }
    let files = pages(folder.path(), "audit-x").unwrap();
    assert!(files.len() > 3, "{files:?}");
    let expected = (0..3).flat_map(|run| (0..5).map(move |n| format!("{run}.{n}")));
    assert_eq!(verbs(folder.path())[1..], expected.collect::<Vec<_>>());
    // A kill right after the old file was put away.
    fs::rename(folder.path().join("audit-x.jsonl"), folder.path().join("audit-x.0099.jsonl")).unwrap();
    assert!(write(&mut AuditFile::new(folder.path(), "audit-x"), &["last"]).unwrap().is_empty());
    assert_eq!(verbs(folder.path()).last().unwrap(), "last");
}

#[test]
fn a_file_that_is_cut_replaced_or_removed_while_the_node_runs_is_found() {
    for spoil in 0..3 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit-x.jsonl");
        let mut audit_file = AuditFile::new(folder.path(), "audit-x");
        write(&mut audit_file, &["a", "b"]).unwrap();
        let whole = text(folder.path());
        match spoil {
            0 => fs::remove_file(&path).unwrap(),
            1 => fs::write(&path, "").unwrap(),
            // The last record, cleanly.
            _ => {
                let end = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').unwrap();
                fs::write(&path, &whole[..=end]).unwrap();
            }
        }
        assert!(write(&mut audit_file, &["c"]).is_err());
        assert_eq!(write(&mut audit_file, &["c"]).unwrap(), [BROKEN], "{spoil}");
        assert_eq!(verbs(folder.path()).last().unwrap(), "c");
    }
}

#[test]
fn two_processes_never_write_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = AuditFile::new(folder.path(), "audit-x");
    write(&mut first, &["a"]).unwrap();
    let refused = AuditFile::new(folder.path(), "audit-x").open().unwrap_err().to_string();
    assert!(refused.contains("another process"), "{refused}");
    drop(first);
    write(&mut AuditFile::new(folder.path(), "audit-x"), &["b"]).unwrap();
}

/// Bytes that the disk of the test below still takes.
static ROOM: AtomicI64 = AtomicI64::new(0);

struct Tight(File);

impl Page for Tight {
    fn append(&mut self, text: &[u8]) -> io::Result<()> {
        let room = usize::try_from(ROOM.load(Ordering::SeqCst)).unwrap();
        self.0.write_all(&text[..text.len().min(room)])?;
        if text.len() > room { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }

    fn sync(&mut self) -> io::Result<()> {
        self.0.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }
}

#[test]
fn what_a_full_disk_took_half_is_written_once_when_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let mut audit_file = AuditFile::new(folder.path(), "audit-x");
    audit_file.page_of = |file| Box::new(Tight(file));
    ROOM.store(100_000, Ordering::SeqCst);
    write(&mut audit_file, &["a"]).unwrap();
    // From nothing at all to all but the last byte of two lines.
    for room in (0..950).step_by(37) {
        ROOM.store(room, Ordering::SeqCst);
        assert!(write(&mut audit_file, &["b", "c"]).is_err(), "{room}");
    }
    ROOM.store(100_000, Ordering::SeqCst);
    assert!(write(&mut audit_file, &["b", "c"]).unwrap().is_empty());
    assert_eq!(verbs(folder.path()), ["chain_begins", "a", "b", "c"]);
}

#[test]
fn whoever_was_away_gets_all_in_portions_across_files_and_breaks() {
    let folder = tempfile::tempdir().unwrap();
    let mut audit_file = AuditFile::new(folder.path(), "audit-x");
    audit_file.full_bytes = 4000;
    for n in 0..40 {
        write(&mut audit_file, &[&format!("v{n}")]).unwrap();
    }
    let mut past = Past::of(&audit_file);
    for limit in [1, 7, 500] {
        let (mut after, mut all) = (None::<String>, Vec::new());
        loop {
            let answer = past.after(after.as_deref(), limit).unwrap();
            assert!(answer.known && answer.records.len() <= limit);
            for record in &answer.records {
                all.push(crate::chain::prove_value(record).unwrap().record.verb);
            }
            after = answer.records.last().and_then(|record| record["sha256"].as_str()).map(str::to_owned).or(after);
            if !answer.more {
                break;
            }
        }
        assert_eq!(all, verbs(folder.path()), "in portions of {limit}");
        // The records that are written after that.
        write(&mut audit_file, &["more"]).unwrap();
        let answer = past.after(after.as_deref(), limit).unwrap();
        assert_eq!(answer.records.len(), 1);
        assert_eq!(answer.records[0]["verb"], "more");
    }
    assert!(!past.after(Some("never written"), 5).unwrap().known);
}
