//! The queue between the parts that note something and the disk: noting never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use bus::BusError;
use node::Node;
use tokio::sync::{mpsc, watch};

use crate::audit_file::AuditFile;
use crate::entry::{Entry, Signs};
use crate::past::Past;
use crate::whereabouts::Whereabouts;
use crate::writer::{Item, Writer};
use crate::{Proven, publisher};

/// Entries that wait for the disk: an hour of a busy night, 4 MB.
const WAITING: usize = 4096;
/// Lines that wait for the bus; a subscriber asks later for those that find no room.
const LINES: usize = 1024;

/// The interface through which a node notes orders and movements. Cheap to clone.
#[derive(Clone)]
pub struct Audit {
    items: SyncSender<Item>,
    signs: Arc<Signs>,
    ended: watch::Receiver<bool>,
}

impl Audit {
    /// Starts a node's audit in its data folder. A disk that fails raises an alert, and the node starts all the same.
    pub async fn start(node: &Node) -> Result<Self, BusError> {
        let name = format!("audit-{}-{}-{}", node.role, node.config.place.telescope, node.id);
        let audit_file = AuditFile::new(&node.config.folders.data, &name);
        let past = Past::of(&audit_file);
        let signs = Signs {
            clock: node.bus.clock().clone(),
            boot_id: node.bus.boot_id().clone(),
            node: node.signature(),
            host: node::host_name(),
            whereabouts: Whereabouts::listen(node).await?,
            alerts: node.alerts.clone(),
            lost: AtomicU64::new(0),
            ending: AtomicBool::new(false),
        };
        let (audit, written) = Self::with_file(signs, audit_file, WAITING);
        publisher::start(node, past, written).await?;
        Ok(audit)
    }

    pub(crate) fn with_file(signs: Signs, file: AuditFile, waiting: usize) -> (Self, mpsc::Receiver<Proven>) {
        let (items, taken) = sync_channel(waiting);
        let (lines, written) = mpsc::channel(LINES);
        let (end, ended) = watch::channel(false);
        let signs = Arc::new(signs);
        let writer = Writer::new(signs.clone(), file, lines);
        let work = move || {
            writer.run(&taken);
            // The caller that waited may have ended.
            let _ = end.send(true);
        };
        if let Err(error) = std::thread::Builder::new().name("audit".to_owned()).spawn(work) {
            signs.complain(&format!("the audit's thread cannot start: {error}"));
        }
        (Self { items, signs, ended }, written)
    }

    /// Notes something. Never waits: an entry that finds no room is counted, and the chain will contain the number of
    /// missing entries.
    pub fn note(&self, entry: Entry) {
        let lost_before = self.signs.lost.swap(0, Ordering::AcqRel);
        let record = Box::new(self.signs.record(entry));
        if self.items.try_send(Item::Note { record, lost_before }).is_err() {
            self.signs.lost.fetch_add(lost_before + 1, Ordering::AcqRel);
            self.signs.complain("records are lost: the audit's queue is full, its disk is too slow or fails");
        }
    }

    /// Writes the entries that wait and ends, after 3 s at most.
    pub async fn end(&self) {
        self.signs.ending.store(true, Ordering::Release);
        // A full queue needs no waking.
        let _ = self.items.try_send(Item::Wake);
        let mut ended = self.ended.clone();
        let waited = tokio::time::timeout(Duration::from_secs(3), ended.wait_for(|ended| *ended)).await;
        if waited.is_err() {
            tracing::error!("the audit's disk did not take its last records");
        }
    }
}
