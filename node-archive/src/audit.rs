//! The archive's copy of the audit of all nodes of this telescope: each record is checked when it arrives, and missing
//! records are fetched.
//!
//! A record that follows the last one of its node is stored. After anything else (a gap, a new chain, a new
//! incarnation, a node's first record) the archive asks that node for all records after the last one stored here,
//! however long ago that was.

use std::collections::HashMap;
use std::time::Duration;

use anyhow::Context as _;
use audit::chain::prove_value;
use audit::{Broken, Link, Proven};
use bus::{Bus, Catch, MachineTime, Subscriber};
use contract::audit::{AuditAnswer, AuditQuestion, PublishedRecord};
use contract::node::NodeState;
use contract::observatory::AlertKind;
use contract::{Address, BootId, Key, Name, NodeTopic, Role, Topic};
use node::Node;
use serde_json::Value;

use crate::database::{Database, StoredRecord, Write};
use crate::reader::Reader;
use crate::telemetry::{first, watch_keys};

/// Records that wait here; those that are dropped are asked for.
const WAITING: usize = 4096;
/// A node from which samples arrive is asked so often whether there are more records, in case one was lost on the way.
const ASK_AGAIN: Duration = Duration::from_secs(60);
/// A node that did not answer is asked again after so long.
const RETRY: Duration = Duration::from_secs(10);
/// After so many fetches in vain an alert is raised.
const FETCHES: u32 = 3;
const ANSWER: Duration = Duration::from_secs(5);

/// Which node: its telescope, role and id.
type Who = (Address, Role, Name);

/// The last record of a node that is stored.
#[derive(Default)]
struct Follow {
    last: Option<Link>,
    boot_id: Option<BootId>,
    asked: Option<MachineTime>,
    /// The node is known to have more records than were fetched.
    lacks: bool,
    /// Fetches in a row that did not bring all records.
    failures: u32,
}

struct Keeper {
    node: Node,
    bus: Bus,
    database: Database,
    nodes: HashMap<Who, Follow>,
}

/// Nodes whose audit is followed; a telescope has some ten.
const MOST_NODES: usize = 256;

impl Keeper {
    /// Is this node followed, or is there room for one more?
    fn has_room(&self, who: &Who) -> bool {
        self.nodes.len() < MOST_NODES || self.nodes.contains_key(who)
    }
}

/// Stores the audit of all nodes.
pub async fn keep(node: Node, database: Database) -> anyhow::Result<()> {
    let (mut records, mut states): (Vec<Subscriber<PublishedRecord<Value>>>, Vec<Subscriber<NodeState>>) =
        (Vec::new(), Vec::new());
    for keys in watch_keys(&node.config, Topic::Node(NodeTopic::Audit)) {
        records.push(node.bus.subscribe(&keys, Catch::Newest, WAITING).await?);
    }
    for keys in watch_keys(&node.config, Topic::Node(NodeTopic::State)) {
        states.push(node.bus.subscribe(&keys, Catch::Newest, 256).await?);
    }
    let mut keeper = Keeper { bus: node.bus.clone(), node, database, nodes: HashMap::new() };
    loop {
        tokio::select! {
            received = first(&records) => {
                if let Key::Node(address, role, id, NodeTopic::Audit) = received.key
                    && keeper.has_room(&(address.clone(), role, id.clone()))
                {
                    keeper.receive((address, role, id), &received.sample.body.record).await?;
                }
            }
            received = first(&states) => {
                if let Key::Node(address, role @ (Role::Device | Role::Observatory | Role::Web), id, NodeTopic::State) = received.key
                    && keeper.has_room(&(address.clone(), role, id.clone()))
                {
                    keeper.look((address, role, id), received.sample.boot_id).await?;
                }
            }
        }
    }
}

impl Keeper {
    /// The state of a node, the first time from the database.
    async fn follow(&mut self, who: &Who) -> anyhow::Result<&mut Follow> {
        if !self.nodes.contains_key(who) {
            let (path, name) = (self.database.path().to_owned(), signature(who));
            let telescope = who.0.telescope.clone();
            let look = move || Reader::open(&path, telescope.as_str())?.audit_end(&name);
            let last = tokio::task::spawn_blocking(look).await??;
            self.nodes.insert(who.clone(), Follow { last, ..Follow::default() });
        }
        self.nodes.get_mut(who).context("a node was forgotten")
    }

    /// Takes a record that was received.
    async fn receive(&mut self, who: Who, record: &Value) -> anyhow::Result<()> {
        let follow = self.follow(&who).await?;
        let last = follow.last.clone();
        match prove_value(record) {
            Ok(proven) if last.as_ref() == Some(&proven.link()) => Ok(()),
            Ok(proven) if last.is_some() && proven.follows(last.as_ref()).is_ok() => {
                follow.last = Some(proven.link());
                let write = Write::Audit(Box::new(StoredRecord::of(signature(&who), &proven)));
                Ok(self.database.put(write).await?)
            }
            // The node's own file decides what is true.
            Ok(_) | Err(_) => {
                follow.lacks = true;
                self.fetch(&who).await
            }
        }
    }

    /// Takes a sign that a node is alive.
    async fn look(&mut self, who: Who, boot_id: BootId) -> anyhow::Result<()> {
        let now = self.bus.clock().machine();
        let follow = self.follow(&who).await?;
        let pause = if follow.lacks { RETRY } else { ASK_AGAIN };
        let due = follow.asked.is_none_or(|asked| now.since(asked) >= pause);
        if !due && follow.boot_id.as_ref() == Some(&boot_id) {
            return Ok(());
        }
        follow.boot_id = Some(boot_id);
        self.fetch(&who).await
    }

    /// Asks a node for all records after the last one stored here.
    async fn fetch(&mut self, who: &Who) -> anyhow::Result<()> {
        let now = self.bus.clock().machine();
        let follow = self.follow(who).await?;
        if follow.lacks && follow.asked.is_some_and(|asked| now.since(asked) < Duration::from_secs(1)) {
            // The node does not answer now: `look` tries again.
            return Ok(());
        }
        follow.asked = Some(now);
        let mut last = follow.last.clone();
        let key = Key::Node(who.0.clone(), who.1, who.2.clone(), NodeTopic::AuditSince);
        loop {
            let question = AuditQuestion { after_sha256: last.as_ref().map(|last| last.sha256.clone()), limit: None };
            let answer: AuditAnswer<Value> = match self.bus.ask(&key, &question, ANSWER).await {
                Ok(answer) => answer,
                Err(error) => {
                    tracing::debug!(%error, "a node does not send its audit log; it is asked again");
                    self.lack(who, true).await?;
                    return Ok(());
                }
            };
            if let (false, Some(end)) = (answer.known, &last) {
                let gone =
                    format!("number {} of chain {} is stored here and not in its own file", end.number, end.chain);
                self.report(who, &gone);
                // From the beginning: the database counts a record that it has only once.
                last = None;
                continue;
            }
            let stored = !answer.records.is_empty();
            last = self.store(who, &answer.records, last).await?;
            self.follow(who).await?.last.clone_from(&last);
            if !answer.more || !stored {
                return self.lack(who, answer.more).await;
            }
        }
    }

    /// Stores records of a node after the one that is `last`; returns which is the last now.
    async fn store(&self, who: &Who, records: &[Value], mut last: Option<Link>) -> anyhow::Result<Option<Link>> {
        let name = signature(who);
        let mut writes = Vec::new();
        for record in records {
            let proven = prove_value(record);
            let fault = match &proven {
                Ok(proven) => proven.follows(last.as_ref()).err(),
                Err(broken) => Some(broken.clone()),
            };
            let stored = StoredRecord::received(name.clone(), record, proven.as_ref().ok(), fault.as_ref());
            if let Some(fault) = &fault {
                self.report(who, &format!("number {} of chain {}: {fault}", stored.number, stored.chain));
            }
            last = Some(stored.link());
            writes.push(Write::Audit(Box::new(stored)));
        }
        self.database.commit(writes).await?;
        Ok(last)
    }

    async fn lack(&mut self, who: &Who, lacks: bool) -> anyhow::Result<()> {
        let follow = self.follow(who).await?;
        follow.lacks = lacks;
        follow.failures = if lacks { follow.failures.saturating_add(1) } else { 0 };
        let (failures, last) = (follow.failures, follow.last.clone());
        // A web node of an earlier version keeps no audit.
        if failures >= FETCHES && (who.1 != Role::Web || last.is_some()) {
            let from = last.map_or("all of it".to_owned(), |last| format!("what follows number {}", last.number));
            let cause = format!("{} does not send its audit log; the archive lacks {from}", signature(who));
            self.node.alerts.raise(AlertKind::AuditLacking, signature(who), &cause);
        } else if failures == 0 {
            self.node.alerts.clear(AlertKind::AuditLacking, signature(who));
        }
        Ok(())
    }

    /// Raises an alert for a broken chain: a person should look. It stays active until this node ends.
    fn report(&self, who: &Who, what: &str) {
        let cause = format!("the audit of {} is broken: {what}", signature(who));
        self.node.alerts.raise(AlertKind::AuditBroken, signature(who), &cause);
    }
}

/// How a node signs its records.
fn signature((address, role, id): &Who) -> String {
    format!("{role}/{}/{id}", address.telescope)
}

impl StoredRecord {
    /// A good record.
    fn of(node: String, proven: &Proven) -> Self {
        let record = &proven.record;
        Self {
            node,
            chain: record.chain.clone(),
            number: i64::try_from(record.number).unwrap_or(i64::MAX),
            at: Some(record.at_utc),
            from: record.from.clone(),
            device: record.device.clone(),
            verb: record.verb.clone(),
            token: record.token.and_then(|token| i64::try_from(token).ok()),
            outcome: record.outcome.word().to_owned(),
            line: proven.line.clone(),
            sha256: record.sha256.clone(),
            fault: None,
        }
    }

    /// A record as it was received, with what is wrong with it.
    fn received(node: String, record: &Value, proven: Option<&Proven>, fault: Option<&Broken>) -> Self {
        let fault = fault.map(ToString::to_string);
        if let Some(proven) = proven {
            return Self { fault, ..Self::of(node, proven) };
        }
        let text = |name: &str| record.get(name).and_then(Value::as_str).unwrap_or_default().to_owned();
        Self {
            node,
            chain: text("chain"),
            number: record.get("number").and_then(Value::as_i64).unwrap_or(-1),
            at: text("at_utc").parse().ok(),
            from: text("from"),
            device: text("device"),
            verb: text("verb"),
            token: record.get("token").and_then(Value::as_i64),
            outcome: record.pointer("/outcome/is").and_then(Value::as_str).unwrap_or_default().to_owned(),
            line: record.to_string(),
            sha256: text("sha256"),
            fault,
        }
    }

    fn link(&self) -> Link {
        Link { chain: self.chain.clone(), number: self.number.unsigned_abs(), sha256: self.sha256.clone() }
    }
}
