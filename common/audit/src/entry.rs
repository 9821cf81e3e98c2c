//! The entries of the audit, and the fields that every record of a node has.

use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Duration;

use bus::{Clock, MachineTime};
use contract::audit::{AuditOutcome, AuditRecord};
use contract::observatory::AlertKind;
use contract::{BootId, CommandId};
use node::NodeAlerts;

use crate::whereabouts::Whereabouts;

/// The name in a record when the node acts by itself.
pub const GUARD: &str = "guard";
/// Long texts are cut here, characters; the purpose of an exposure fits.
const LONGEST: usize = 2000;

/// A command and its outcome.
#[derive(Debug, Clone)]
pub struct Entry {
    /// The person or node that asked; [`GUARD`] for the node itself.
    pub from: String,
    /// The command or order.
    pub id: CommandId,
    /// The device, such as `dome/roof`; empty for an order.
    pub device: String,
    /// The command or order.
    pub verb: String,
    /// Its parameters.
    pub parameters: String,
    /// The fencing token.
    pub token: Option<u64>,
    /// The reason.
    pub reason: String,
    /// The outcome.
    pub outcome: AuditOutcome,
}

/// The word of a command and its parameters, as they are in JSON.
pub fn verb_and_parameters<C: serde::Serialize>(command: &C) -> (String, String) {
    match serde_json::to_value(command) {
        Ok(serde_json::Value::String(word)) => (word, String::new()),
        Ok(serde_json::Value::Object(object)) => {
            object.into_iter().next().map_or_else(Default::default, |(word, parameters)| (word, parameters.to_string()))
        }
        _ => Default::default(),
    }
}

/// The fields that every record of this node has, and the state that the queue and its writer share.
pub(crate) struct Signs {
    pub clock: Clock,
    pub boot_id: BootId,
    pub node: String,
    pub host: String,
    pub whereabouts: Whereabouts,
    pub alerts: NodeAlerts,
    /// Entries that found no room since the last one that did.
    pub lost: AtomicU64,
    pub ending: AtomicBool,
}

impl Signs {
    /// A record that has no place in the chain yet.
    pub fn record(&self, entry: Entry) -> AuditRecord {
        let Entry { from, id, device, verb, parameters, token, reason, outcome } = entry;
        let boot_time = self.clock.machine().since(MachineTime::from_boot(Duration::ZERO));
        AuditRecord {
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

    /// A record about the audit itself.
    pub fn about_itself(&self, verb: &str, outcome: AuditOutcome) -> AuditRecord {
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

    /// Raises the alert that records were lost; it stays active until the node ends.
    pub fn report_lost(&self, missing: u64) {
        let cause = format!("{missing} records of what was ordered and moved are lost");
        self.alerts.raise(AlertKind::AuditLost, "", &cause);
    }

    /// Raises the alert that a chain is broken; it stays active until the node ends.
    pub fn report_broken(&self, detail: &str) {
        self.alerts.raise(AlertKind::AuditBroken, "", detail);
    }
}

fn cut(text: String) -> String {
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}
