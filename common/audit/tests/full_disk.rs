//! A disk that is really full: a small tmpfs in a mount namespace of this test's own.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test ends by panicking")]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use audit::audit_file::examine;
use audit::{Audit, Entry};
use bus::Clock;
use contract::audit::{AuditOutcome, AuditRecord};
use contract::{CommandId, Role};
use node::Node;
use test_support::{ALPHA, LIMIT, block, private_bus, until};

const INSIDE: &str = "STARMESH_TEST_SMALL_DISK";

#[test]
fn a_full_disk_stops_nobody_and_the_chain_goes_on_when_there_is_room() {
    on_a_small_disk("a_full_disk_stops_nobody_and_the_chain_goes_on_when_there_is_room");
}

/// Runs the test of this name, which calls this, with a small disk of its own. How long it took to note what found no
/// room, if this is the process with that disk.
fn on_a_small_disk(name: &str) -> Option<Duration> {
    if let Some(inside) = std::env::var_os(INSIDE) {
        let runtime = tokio::runtime::Runtime::new().unwrap();
        return Some(runtime.block_on(fill(Path::new(&inside))));
    }
    let folder = tempfile::tempdir().unwrap();
    let test = std::env::current_exe().unwrap();
    let script = "mount -t tmpfs -o size=256k none \"$1\" && exec \"$2\" --exact \"$3\" --nocapture";
    let output = Command::new("unshare")
        .args(["-Urm", "sh", "-c", script, "sh"])
        .args([folder.path(), &test])
        .arg(name)
        .env(INSIDE, folder.path())
        .output()
        .expect("unshare is part of util-linux");
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && out.contains("1 passed"), "{out}{err}");
    None
}

fn entry(verb: String) -> Entry {
    Entry {
        from: "observatory/alpha/main".to_owned(),
        id: CommandId::fresh(),
        device: "dome/roof".to_owned(),
        verb,
        parameters: String::new(),
        token: Some(1),
        reason: String::new(),
        outcome: AuditOutcome::Accepted,
    }
}

fn records(folder: &Path) -> Vec<AuditRecord> {
    let found = examine(&fs::read(folder.join("data/audit-device-alpha-main.jsonl")).unwrap(), None);
    assert!(found.broken.is_none(), "{:?}", found.broken);
    found.good.into_iter().map(|proven| proven.record).collect()
}

async fn fill(folder: &Path) -> Duration {
    let config = config::parse(&(ALPHA.to_owned() + &block("camera", "cam", "localhost:1", "")), folder).unwrap();
    let bus = private_bus(Clock::machine_clock()).await;
    let node = Node::new(Role::Device, "main".parse().unwrap(), config, Default::default(), bus);
    let audit = Audit::start(&node).await.unwrap();
    let stands = |id: &str| node.alerts.watch().borrow().alerts.iter().any(|alert| alert.id == id);
    audit.note(entry("before".to_owned()));
    until("a first record is written", || {
        fs::read_to_string(folder.join("data/audit-device-alpha-main.jsonl"))
            .is_ok_and(|text| text.contains("\"verb\":\"before\""))
    })
    .await;
    // Somebody fills the disk to its last page.
    let filler = folder.join("filler");
    for size in [65_536, 4096, 1] {
        let mut bytes = fs::read(&filler).unwrap_or_default();
        loop {
            bytes.resize(bytes.len() + size, 1);
            if fs::write(&filler, &bytes).is_err() || bytes.len() > 1 << 20 {
                break;
            }
        }
        bytes.truncate(bytes.len() - size);
        // The rest that did not fit is given back.
        fs::write(&filler, &bytes).unwrap();
        if size == 4096 {
            break;
        }
    }
    // The disk stays full: to wait for room would be to wait for ever.
    let noting = audit.clone();
    let noted = tokio::task::spawn_blocking(move || {
        let began = Instant::now();
        for n in 0..6000 {
            noting.note(entry(format!("v{n}")));
        }
        began.elapsed()
    });
    let took = tokio::time::timeout(LIMIT, noted).await.unwrap().unwrap();
    until("the full disk is reported", || stands("audit")).await;
    assert!(records(folder).iter().any(|record| record.verb == "before"), "what was written stays proven");

    // 6000 records would not fit even now; the disk grows, as when a person adds room.
    fs::remove_file(&filler).unwrap();
    let grown = Command::new("mount").args(["-o", "remount,size=16m"]).arg(folder).status().unwrap();
    assert!(grown.success());
    until("the alert is cleared", || !stands("audit")).await;
    audit.note(entry("after".to_owned()));
    audit.end().await;
    // The end of an audit waits no longer than 3 s.
    until("the last record is written", || {
        let is_last =
            |text: String| text.ends_with('\n') && text.lines().last().unwrap_or("").contains("\"verb\":\"after\"");
        fs::read_to_string(folder.join("data/audit-device-alpha-main.jsonl")).is_ok_and(is_last)
    })
    .await;
    let all = records(folder);
    let written = all.iter().filter(|record| record.verb.starts_with('v')).count() as u64;
    let missing: u64 =
        all.iter().map(|record| if let AuditOutcome::Lost { missing } = record.outcome { missing } else { 0 }).sum();
    assert_eq!(written + missing, 6000, "{written} written, {missing} reported as missing");
    assert!(missing > 0 && stands("audit-lost"));
    assert_eq!(all.last().unwrap().verb, "after");
    took
}

mod proof {
    use super::*;

    /// A bound in seconds on a real clock.
    #[test]
    fn a_full_disk_delays_nothing() {
        if let Some(took) = on_a_small_disk("proof::a_full_disk_delays_nothing") {
            assert!(took < Duration::from_secs(2), "{took:?}");
        }
    }
}
