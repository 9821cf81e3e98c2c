use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64};

use bus::Clock;
use contract::{BootId, CommandId};
use node::NodeAlerts;

use super::*;
use crate::audit_file::examine;
use crate::entry::Entry;
use crate::whereabouts::Whereabouts;
use crate::{Audit, GUARD};

/// What takes longer hangs, also on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

fn signs(alerts: &NodeAlerts) -> Signs {
    Signs {
        clock: Clock::machine_clock(),
        boot_id: BootId::fresh(),
        node: "device/alpha/main".to_owned(),
        host: "dome-pc".to_owned(),
        whereabouts: Whereabouts::default(),
        alerts: alerts.clone(),
        lost: AtomicU64::new(0),
        ending: AtomicBool::new(false),
    }
}

fn entry(verb: String) -> Entry {
    Entry {
        from: GUARD.to_owned(),
        id: CommandId::fresh(),
        device: "dome/roof".to_owned(),
        verb,
        parameters: String::new(),
        token: None,
        reason: String::new(),
        outcome: AuditOutcome::Accepted,
    }
}

fn records(folder: &Path) -> Vec<AuditRecord> {
    let found = examine(&fs::read(folder.join("audit-x.jsonl")).unwrap(), None);
    assert!(found.broken.is_none() && found.half.is_empty(), "{:?}", found.broken);
    found.good.into_iter().map(|proven| proven.record).collect()
}

/// Waits until this is the last record that is written: the end of an audit waits no longer than 3 s.
async fn until_last(folder: &Path, verb: &str) {
    let (end, verb) = (Instant::now() + LIMIT, format!("\"verb\":\"{verb}\""));
    let is_last = |text: String| text.ends_with('\n') && text.lines().last().is_some_and(|line| line.contains(&verb));
    while !fs::read_to_string(folder.join("audit-x.jsonl")).is_ok_and(is_last) {
        assert!(Instant::now() < end, "{verb} was not written");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test]
async fn what_is_noted_is_on_disk_and_then_published() {
    let folder = tempfile::tempdir().unwrap();
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (audit, mut published) = Audit::with_file(signs(&alerts), AuditFile::new(folder.path(), "audit-x"), 64);
    audit.note(entry("close_shutter".to_owned()));
    let mut received = Vec::new();
    while received.last() != Some(&"close_shutter".to_owned()) {
        let one = tokio::time::timeout(LIMIT, published.recv()).await.unwrap().unwrap();
        received.push(one.record.verb);
    }
    assert_eq!(received, ["chain_begins", "node_starts", "close_shutter"]);
    assert_eq!(records(folder.path()).len(), 3, "on disk before it is published");
    audit.note(entry("last".to_owned()));
    audit.end().await;
    until_last(folder.path(), "last").await;
}

#[tokio::test]
async fn a_queue_that_overflows_never_waits_and_the_chain_counts_the_missing_records() {
    let folder = tempfile::tempdir().unwrap();
    // The disk is away: a file stands where the folder should be.
    let place = folder.path().join("data");
    fs::write(&place, "").unwrap();
    let alerts = NodeAlerts::new(Clock::machine_clock());
    let (audit, _published) = Audit::with_file(signs(&alerts), AuditFile::new(&place, "audit-x"), 8);
    // Nothing empties the queue: to wait for room in it would be to wait for ever.
    note_a_hundred(&audit).await;
    let active = || -> Vec<String> { alerts.watch().borrow().alerts.iter().map(|alert| alert.id.clone()).collect() };
    assert!(active().contains(&"audit".to_owned()));

    fs::remove_file(&place).unwrap();
    let end = Instant::now() + LIMIT;
    while active().contains(&"audit".to_owned()) {
        assert!(Instant::now() < end, "the disk is back and the alert is active");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    audit.note(entry("after".to_owned()));
    audit.end().await;
    until_last(&place, "after").await;
    let all = records(&place);
    let written = all.iter().filter(|record| record.verb.starts_with('v')).count() as u64;
    let missing: u64 =
        all.iter().map(|record| if let AuditOutcome::Lost { missing } = record.outcome { missing } else { 0 }).sum();
    assert!(written >= 8 && missing > 0, "{written} written, {missing} missing");
    assert_eq!(written + missing, 100);
    assert_eq!(all.last().unwrap().verb, "after");
    let lost = all.iter().position(|record| record.verb == "records_lost").unwrap();
    assert!(all[..lost].iter().filter(|record| record.verb.starts_with('v')).count() >= 8, "in its place");
    assert!(active().contains(&"audit-lost".to_owned()), "{:?}", active());
}

/// Notes more than there is room for; how long it took.
async fn note_a_hundred(audit: &Audit) -> Duration {
    let audit = audit.clone();
    let noting = tokio::task::spawn_blocking(move || {
        let began = Instant::now();
        for n in 0..100 {
            audit.note(entry(format!("v{n}")));
        }
        began.elapsed()
    });
    tokio::time::timeout(LIMIT, noting).await.unwrap().unwrap()
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[tokio::test]
    async fn a_hundred_records_are_noted_in_half_a_second_while_the_disk_is_away() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("data");
        fs::write(&place, "").unwrap();
        let alerts = NodeAlerts::new(Clock::machine_clock());
        let (audit, _published) = Audit::with_file(signs(&alerts), AuditFile::new(&place, "audit-x"), 8);
        let took = note_a_hundred(&audit).await;
        assert!(took < Duration::from_millis(500), "{took:?}");
        audit.end().await;
    }
}
