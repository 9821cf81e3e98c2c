//! The archive's copy of a node's audit, with a real node's audit and real sessions: nothing is missing after an
//! absence, and nothing that was changed passes.

use std::path::{Path, PathBuf};
use std::time::Duration;

use audit::{Audit, Entry};
use bus::{Bus, Clock};
use contract::archive::{ArchiveAnswer, ArchiveQuestion, ArchiveRow, Ask};
use contract::audit::{AuditOutcome, AuditRecord, PublishedRecord};
use contract::{CommandId, Key, NodeTopic, Role};
use node::Node;
use node_archive::reader::Reader;
use test_support::{ALPHA, RunningNode, block, join, private_bus, until};

async fn node(role: Role, folder: &Path, meet: Option<&Bus>) -> Node {
    let config = config::parse(&(ALPHA.to_owned() + &block("camera", "cam", "localhost:1", "")), folder).unwrap();
    let bus = match meet {
        Some(bus) => join(bus).await,
        None => private_bus(Clock::machine_clock()).await,
    };
    Node::new(role, "main".parse().unwrap(), config, Default::default(), bus)
}

/// A node that only publishes that it is alive, and writes records into its audit.
struct Noter {
    running: RunningNode,
    audit: Audit,
}

impl Noter {
    async fn start(folder: &Path, meet: Option<&Bus>) -> Self {
        Self::of(Role::Device, folder, meet).await
    }

    async fn of(role: Role, folder: &Path, meet: Option<&Bus>) -> Self {
        let node = node(role, folder, meet).await;
        let audit = Audit::start(&node).await.unwrap();
        Self { running: RunningNode::live(node, |_| std::future::pending()), audit }
    }

    fn bus(&self) -> &Bus {
        &self.running.node.bus
    }

    fn note(&self, count: usize) {
        for _ in 0..count {
            self.audit.note(Entry {
                from: "observatory/alpha/main".to_owned(),
                id: CommandId::fresh(),
                device: "dome/roof".to_owned(),
                verb: "close_shutter".to_owned(),
                parameters: "{\"x\":1.5}".to_owned(),
                token: Some(7),
                reason: String::new(),
                outcome: AuditOutcome::Accepted,
            });
        }
    }

    async fn end(self) {
        self.audit.end().await;
        self.running.kill().await;
    }
}

struct Archive(RunningNode);

impl Archive {
    async fn start(folder: &Path, meet: &Bus) -> Self {
        Self(RunningNode::work(node(Role::Archive, folder, Some(meet)).await, node_archive::run))
    }

    async fn end(self) {
        self.0.stop().await;
    }

    fn alerts(&self) -> Vec<String> {
        self.0
            .node
            .alerts
            .watch()
            .borrow()
            .alerts
            .iter()
            .map(|alert| format!("{}: {}", alert.id, alert.cause))
            .collect()
    }
}

fn file(folder: &Path) -> PathBuf {
    folder.join("data/audit-device-alpha-main.jsonl")
}

fn lines(folder: &Path) -> Vec<String> {
    std::fs::read_to_string(file(folder)).unwrap_or_default().lines().map(str::to_owned).collect()
}

fn stored(folder: &Path) -> Vec<String> {
    let reader = Reader::open(&folder.join("data/archive.db"), "callisto");
    let rows = reader.and_then(|reader| reader.audit_lines()).unwrap_or_default();
    rows.into_iter().map(|(_, line)| line).collect()
}

async fn until_the_same(node: &Path, archive: &Path, count: usize) {
    until(&format!("{count} lines, all of them stored"), || {
        let written = lines(node);
        written.len() >= count && written == stored(archive)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_web_node_is_asked_for_its_records_too() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let noter = Noter::of(Role::Web, here.path(), None).await;
    noter.note(3);
    let archive = Archive::start(there.path(), noter.bus()).await;
    let written = || std::fs::read_to_string(here.path().join("data/audit-web-alpha-main.jsonl")).unwrap_or_default();
    until("five lines, all of them stored", || {
        let written: Vec<_> = written().lines().map(str::to_owned).collect();
        written.len() == 5 && written == stored(there.path())
    })
    .await;
    assert!(archive.alerts().is_empty(), "{:?}", archive.alerts());
    archive.end().await;
    noter.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_that_was_away_has_every_record_in_its_order_afterwards() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let noter = Noter::start(here.path(), None).await;
    // More than two portions, before any archive was there.
    noter.note(1200);
    let archive = Archive::start(there.path(), noter.bus()).await;
    until_the_same(here.path(), there.path(), 1202).await;
    noter.note(3);
    until_the_same(here.path(), there.path(), 1205).await;
    archive.end().await;

    // More than any publisher's cache holds.
    noter.note(1500);
    let archive = Archive::start(there.path(), noter.bus()).await;
    until_the_same(here.path(), there.path(), 2705).await;
    assert!(archive.alerts().is_empty(), "{:?}", archive.alerts());

    // A new incarnation of the node continues the chain.
    noter.end().await;
    let noter = Noter::start(here.path(), Some(&archive.0.node.bus)).await;
    noter.note(5);
    until_the_same(here.path(), there.path(), 2711).await;
    assert!(archive.alerts().is_empty(), "{:?}", archive.alerts());

    let question = ArchiveQuestion { ask: Ask::Audit, from_utc: None, to_utc: None, limit: Some(4) };
    let key = Key::History(noter.running.node.config.address());
    let answer: ArchiveAnswer = super::keeps_a_night::until_answered(noter.bus(), &key, &question).await;
    assert!(answer.truncated && answer.rows.len() == 4);
    assert!(answer.rows.iter().all(|row| matches!(row, ArchiveRow::Audit(record) if record.verb == "close_shutter")));
    archive.end().await;
    noter.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_record_that_was_cut_off_changed_or_forged_is_reported() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let noter = Noter::start(here.path(), None).await;
    noter.note(10);
    let archive = Archive::start(there.path(), noter.bus()).await;
    until_the_same(here.path(), there.path(), 12).await;

    // Another program publishes a record in the node's name: the node's own file does not have it.
    let liar = join(noter.bus()).await;
    let sender = liar.publisher(&noter.running.node.key(NodeTopic::Audit)).await.unwrap();
    let last: AuditRecord = serde_json::from_str(lines(here.path()).last().unwrap()).unwrap();
    let forged = AuditRecord { number: last.number + 2, verb: "open_shutter".to_owned(), ..last };
    tokio::time::sleep(Duration::from_millis(500)).await;
    sender.put(PublishedRecord { record: forged }).await.unwrap();
    noter.note(1);
    until_the_same(here.path(), there.path(), 13).await;
    assert!(stored(there.path()).iter().all(|line| !line.contains("open_shutter")));

    // The last record is cut off cleanly while the node is down: its file alone cannot show that.
    noter.end().await;
    let before = stored(there.path());
    let all = lines(here.path());
    std::fs::write(file(here.path()), all[..all.len() - 1].join("\n") + "\n").unwrap();
    let noter = Noter::start(here.path(), Some(&archive.0.node.bus)).await;
    noter.note(2);
    until("what was stored stays, and what the node writes now is stored too", || {
        let retained = stored(there.path());
        retained.len() == before.len() + 3 && retained.starts_with(&before)
    })
    .await;
    let alerts = archive.alerts();
    let is_raised = |word: &str| {
        alerts.iter().any(|alert| alert.contains("audit-broken/device/alpha/main") && alert.contains(word))
    };
    assert!(is_raised("not in its own file"), "{alerts:?}");
    archive.end().await;

    // A record is changed where the archive has not been yet.
    noter.end().await;
    let mut all = lines(here.path());
    let changed = all.len() - 1;
    all[changed] = all[changed].replace("close_shutter", "open_shutter!");
    std::fs::write(file(here.path()), all.join("\n") + "\n").unwrap();
    std::fs::remove_dir_all(there.path().join("data")).unwrap();
    let noter = Noter::start(here.path(), None).await;
    let archive = Archive::start(there.path(), noter.bus()).await;
    // The alert may come before the database has the record, which is stored as evidence.
    until("the changed record is reported and stored", || {
        archive.alerts().iter().any(|alert| alert.contains("expected sha256"))
            && stored(there.path()).iter().any(|line| line.contains("open_shutter!"))
    })
    .await;
    archive.end().await;
    noter.end().await;
}
