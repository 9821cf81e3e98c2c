//! What is noted, and the queue that it goes through: noting never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use bus::{AlertBoard, BusError, Clock, MachineTime, Node};
use contract::audit::{Outcome, Record};
use contract::observatory::AlertKind;
use contract::{BootId, CommandId};
use tokio::sync::{mpsc, watch};

use crate::book::Book;
use crate::past::Past;
use crate::whereabouts::Whereabouts;
use crate::writer::{Item, Writer};
use crate::{Proven, voice};

/// Who is named for what a node does by itself.
pub const GUARD: &str = "guard";
/// Entries that wait for the disk: an hour of a busy night, 4 MB.
const WAITING: usize = 4096;
/// Lines that wait for the bus; those that find no room are asked for later.
const LINES: usize = 1024;
/// Long texts are cut here, characters; the purpose of an exposure fits.
const LONGEST: usize = 2000;

/// What became of whose command.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Who asked; [`GUARD`] for the node itself.
    pub from: String,
    /// The command or order.
    pub id: CommandId,
    /// The device, such as `dome/roof`; empty for an order.
    pub device: String,
    /// What was asked.
    pub verb: String,
    /// With which parameters.
    pub parameters: String,
    /// With which token.
    pub token: Option<u64>,
    /// Why.
    pub reason: String,
    /// What became of it.
    pub outcome: Outcome,
}

/// The word of a command and its parameters, as they stand in JSON.
pub fn verb_and_parameters<C: serde::Serialize>(command: &C) -> (String, String) {
    match serde_json::to_value(command) {
        Ok(serde_json::Value::String(word)) => (word, String::new()),
        Ok(serde_json::Value::Object(object)) => {
            object.into_iter().next().map_or_else(Default::default, |(word, parameters)| (word, parameters.to_string()))
        }
        _ => Default::default(),
    }
}

/// Where a node notes what is ordered and moved. Cheap to clone.
#[derive(Clone)]
pub struct Audit {
    items: SyncSender<Item>,
    signs: Arc<Signs>,
    ended: watch::Receiver<bool>,
}

/// What every record of this node carries, and what the queue and its writer share.
pub(crate) struct Signs {
    pub clock: Clock,
    pub boot_id: BootId,
    pub node: String,
    pub host: String,
    pub whereabouts: Whereabouts,
    pub alerts: AlertBoard,
    /// Entries that found no room since the last one that did.
    pub lost: AtomicU64,
    pub ending: AtomicBool,
}

impl Audit {
    /// Starts a node's audit in its data folder. A disk that fails is an alert, and no reason not to start.
    pub async fn start(node: &Node) -> Result<Self, BusError> {
        let name = format!("audit-{}-{}-{}", node.role, node.config.place.telescope, node.id);
        let book = Book::new(&node.config.folders.data, &name);
        let past = Past::of(&book);
        let signs = Signs {
            clock: node.bus.clock().clone(),
            boot_id: node.bus.boot_id().clone(),
            node: node.signature(),
            host: bus::node::host_name(),
            whereabouts: Whereabouts::listen(node).await?,
            alerts: node.alerts.clone(),
            lost: AtomicU64::new(0),
            ending: AtomicBool::new(false),
        };
        let (audit, written) = Self::with_book(signs, book, WAITING);
        voice::start(node, past, written).await?;
        Ok(audit)
    }

    pub(crate) fn with_book(signs: Signs, book: Book, waiting: usize) -> (Self, mpsc::Receiver<Proven>) {
        let (items, taken) = sync_channel(waiting);
        let (lines, written) = mpsc::channel(LINES);
        let (end, ended) = watch::channel(false);
        let signs = Arc::new(signs);
        let writer = Writer::new(signs.clone(), book, lines);
        let work = move || {
            writer.run(&taken);
            // whoever waited may have gone
            let _ = end.send(true);
        };
        if let Err(error) = std::thread::Builder::new().name("audit".to_owned()).spawn(work) {
            signs.complain(&format!("the audit's thread cannot start: {error}"));
        }
        (Self { items, signs, ended }, written)
    }

    /// Notes something. Never waits: what finds no room is counted, and the chain will say how much is missing.
    pub fn note(&self, entry: Entry) {
        let lost_before = self.signs.lost.swap(0, Ordering::AcqRel);
        let record = Box::new(self.signs.record(entry));
        if self.items.try_send(Item::Note { record, lost_before }).is_err() {
            self.signs.lost.fetch_add(lost_before + 1, Ordering::AcqRel);
            self.signs.complain("records are lost: the audit's queue is full, its disk is too slow or fails");
        }
    }

    /// Writes what waits and ends, after 3 s at most.
    pub async fn end(&self) {
        self.signs.ending.store(true, Ordering::Release);
        // a full queue needs no waking
        let _ = self.items.try_send(Item::Wake);
        let mut ended = self.ended.clone();
        let waited = tokio::time::timeout(Duration::from_secs(3), ended.wait_for(|ended| *ended)).await;
        if waited.is_err() {
            tracing::error!("the audit's disk did not take its last records");
        }
    }
}

impl Signs {
    /// A record that has no place in the chain yet.
    pub fn record(&self, entry: Entry) -> Record {
        let Entry { from, id, device, verb, parameters, token, reason, outcome } = entry;
        let boot_time = self.clock.machine().since(MachineTime::from_boot(Duration::ZERO));
        Record {
            chain: String::new(),
            number: 0,
            at_utc: self.clock.utc(),
            boot_time_ms: u64::try_from(boot_time.as_millis()).unwrap_or(u64::MAX),
            boot_id: self.boot_id.clone(),
            node: self.node.clone(),
            host: self.host.clone(),
            from_host: self.whereabouts.host(&from),
            from: cut(from),
            id: CommandId(cut(id.0)),
            device,
            verb: cut(verb),
            parameters: cut(parameters),
            token,
            reason: cut(reason),
            outcome,
            previous: String::new(),
            sha256: String::new(),
        }
    }

    /// The audit tells of itself.
    pub fn about_itself(&self, verb: &str, outcome: Outcome) -> Record {
        self.record(Entry {
            from: "audit".to_owned(),
            id: CommandId::default(),
            device: String::new(),
            verb: verb.to_owned(),
            parameters: String::new(),
            token: None,
            reason: String::new(),
            outcome,
        })
    }

    pub fn complain(&self, cause: &str) {
        self.alerts.raise(AlertKind::Audit, "", cause);
    }

    /// Stands until the node ends.
    pub fn tell_lost(&self, missing: u64) {
        let cause = format!("{missing} records of what was ordered and moved are lost");
        self.alerts.raise(AlertKind::AuditLost, "", &cause);
    }

    /// Stands until the node ends.
    pub fn tell_broken(&self, detail: &str) {
        self.alerts.raise(AlertKind::AuditBroken, "", detail);
    }
}

fn cut(text: String) -> String {
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}
